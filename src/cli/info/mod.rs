//! `info`: shows what is in takes and motion files.

mod contents;
mod text;

use std::{
    io::BufReader,
    path::{Path, PathBuf},
    time::Duration,
};

use anyhow::Context;
use mocapd::outcome::Outcome;
use mocapd_acquire::{
    files::CountingFile,
    inspect::{Summary, size_ratio},
    ledger::{LedgerDocument, SampleLedgerDocument, TakeHealth},
};
use mocapd_store::{ObjectUrl, Store, StoredTake};
use mocapd_take::{
    interchange::ReadOptions,
    motion::frame_at,
    reader::TakeBytes,
    record::{Device, Header, ImportSource},
    recovery::RECOVERED,
    sampled::is_recorded,
    traversal::Decode,
};
use serde::Serialize;

use self::{
    contents::{PosesReport, SampledGroupReport, SubjectReport},
    text::{line, text},
};
use super::{
    batch::{self, Batch, Figures, FileKinds, FileReport, InputArgs, Job},
    ledger, motion_file_reports,
    paths::{InputFormat, InputFormatName},
    remote,
};
use crate::cli::ledger::{ClockReport, DamageReport, OutagesReport};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Takes, or .c3d, .trc, .tsv or .csv files, or folders with such files; `-` reads standard input, with --format
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    input: InputArgs,
    /// Format of standard input, and of files whose extension does not show it
    #[arg(long, value_name = "FORMAT")]
    format: Option<InputFormatName>,
    /// List the markers: samples, gaps, kept samples and the largest error of each; the sampled channels, and the rigid
    /// bodies with the frames in which each was tracked, for which their poses are decoded; --json always lists the rest
    #[arg(long)]
    markers: bool,
    /// Print one JSON document, or one per line for several files
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let format = args.format.map(Into::into);
    let inputs = batch::inputs::find(&args.files, &args.input, FileKinds::Both, format)?;
    let batch = Batch::of_reports(&inputs, args.json, ["reading", "read"]);
    batch::run(&batch, |job| match job.input.format()? {
        InputFormat::Take => take_info(job, args.markers),
        InputFormat::MotionFile(_) => motion_file_reports::info(job),
    })
}

/// Reads a take. Its samples are decoded only if it does not state their statistics, or if anything in it is damaged; poses
/// of rigid bodies, whose states no statistics tell, if they are few, or the user wants a list.
///
/// # Errors
/// When it cannot be read, or is not a take.
fn take_info(job: &Job<'_>, all_markers: bool) -> anyhow::Result<FileReport> {
    let reading = || format!("cannot read {}", job.input.name.display());
    let file = remote::open(&job.input.path)?;
    let file_bytes = file.len_bytes().with_context(reading)?;
    let phase = job.phase("reading", file_bytes);
    let file = BufReader::new(CountingFile::new(file, &phase.counter));
    let summary = Summary::read_stated(file).with_context(reading)?;
    drop(phase);
    let mut report = InfoReport::new(&job.input.name, &summary, file_bytes);
    report.store = StoreReport::of(&job.input.path, &summary)?;
    if let Some(poses) = report.poses.as_mut().filter(|poses| all_markers || poses.are_few()) {
        let mut file = BufReader::new(remote::open(&job.input.path)?);
        poses.count_tracked(&summary.take, &mut file).with_context(reading)?;
    }
    if !job.is_json {
        report.problems.iter().for_each(|problem| job.notify(problem));
    }
    for message in ledger::missing_messages(&job.input.name, &summary, !job.is_json) {
        job.notify(&message);
    }
    Ok(FileReport {
        data_lost: report.health != TakeHealth::Complete || !report.problems.is_empty(),
        text: text(&report, all_markers),
        line: line(&report),
        json: job.json(&report)?,
        figures: Figures {
            frames: report.frames,
            seconds: report.seconds,
            bytes_read: file_bytes,
            ..Figures::default()
        },
        ..FileReport::default()
    })
}

#[derive(Debug, Serialize)]
struct InfoReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    finished: bool,
    problems: Vec<String>,
    damage: Vec<DamageReport>,
    recovered: Option<String>,
    health: TakeHealth,
    ending: Option<&'static str>,
    ending_detail: Option<String>,
    software: String,
    created: Option<String>,
    #[serde(skip)]
    created_unix_ms: Option<i64>,
    resampler: String,
    tolerance_mm: f64,
    format_version: u16,
    keys: Option<String>,
    up_axis: Option<&'static str>,
    device: Option<Device>,
    source: Option<ImportSourceReport>,
    subject: Option<SubjectReport>,
    foreign_parts: Vec<ForeignReport>,
    sampled_groups: Vec<SampledGroupReport>,
    poses: Option<PosesReport>,
    frames: u64,
    seconds: f64,
    markers: usize,
    rate_hz: f64,
    samples: u64,
    raw_bytes: u64,
    file_bytes: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    store: Option<StoreReport>,
    bytes: TakeBytes,
    ratio: f64,
    max_error_mm: f64,
    stretches: u64,
    sr1: Option<f64>,
    sr2: Option<f64>,
    ledger: Option<LedgerDocument>,
    sample_ledger: Option<SampleLedgerDocument>,
    outages: OutagesReport,
    clock: Option<ClockReport>,
    events: Vec<EventReport>,
    channels: Vec<ChannelReport>,
}

#[derive(Debug, Serialize)]
struct ImportSourceReport {
    #[serde(flatten)]
    file: ImportSource,
    /// Size of the file.
    bytes: Option<u64>,
    /// The value of `import --unit`, if given.
    unit_given: Option<String>,
    /// The value of `import --up`, if given.
    up_given: Option<String>,
}

/// What it takes to read a take from object storage.
#[derive(Debug, Serialize)]
struct StoreReport {
    /// Requests for the whole take.
    requests: u64,
    /// Bytes received with them.
    received_bytes: u64,
    /// Requests for a second of the take, with those that open it.
    window_requests: u64,
}

impl StoreReport {
    /// `None` for a file.
    fn of(path: &Path, summary: &Summary) -> anyhow::Result<Option<Self>> {
        let Some(traffic) = remote::traffic(path) else { return Ok(None) };
        let local = ObjectUrl::parse(&format!("file://{}", remote::local(path)?.display()))?;
        // A second in the middle of the copy, read as it would be from the store.
        let mut take = StoredTake::open(&Store::of(&local)?.counted_anew(), &local)?;
        let n_rows = take.map().n_rows;
        let end = frame_at(Duration::from_secs(1), summary.take.header.rate_hz);
        let start = (n_rows / 2).min(n_rows.saturating_sub(end));
        take.read_rows(
            &(start..start.saturating_add(end).min(n_rows)),
            Decode::Nothing,
            |_, _, _| Ok(()),
        )?;
        Ok(Some(Self {
            requests: traffic.requests,
            received_bytes: traffic.received_bytes,
            window_requests: take.reader().store().traffic().requests,
        }))
    }
}

#[derive(Debug, Serialize)]
struct ForeignReport {
    kind: String,
    bytes: u64,
    stored_bytes: u64,
}

#[derive(Debug, Serialize)]
struct EventReport {
    kind: &'static str,
    frame: u64,
    device_ticks: u64,
    input: u8,
    text: String,
}

#[derive(Debug, Serialize)]
struct ChannelReport {
    label: String,
    labelled: bool,
    samples: u64,
    gaps: u64,
    knots: u64,
    max_error_mm: f64,
    frames_damaged: u64,
}

impl InfoReport {
    fn new(take: &Path, summary: &Summary, file_bytes: u64) -> Self {
        let header = &summary.take.header;
        let channels = summary.take.channels.iter().zip(&summary.per_channel);
        let channels = channels.map(|(channel, found)| ChannelReport {
            label: channel.label.clone(),
            labelled: channel.labelled,
            samples: found.samples,
            gaps: found.gaps,
            knots: found.knots,
            max_error_mm: found.max_error_mm,
            frames_damaged: found.rows_damaged,
        });
        let bytes = summary.bytes;
        let events = summary.take.events.iter().map(|event| EventReport {
            kind: event.kind.name(),
            frame: event.row,
            device_ticks: event.device_ticks,
            input: event.input,
            text: event.text.clone(),
        });
        let parts = summary.take.foreign.iter();
        // Channels of a recording are no part of a file.
        let parts = parts.filter(|part| !is_recorded(&part.kind));
        let foreign_parts = parts.map(|part| ForeignReport {
            kind: part.kind.clone(),
            bytes: part.data_bytes(),
            stored_bytes: part.stored_bytes(),
        });
        let options = ReadOptions::from_settings(&header.settings);
        Self {
            take: take.to_owned(),
            finished: summary.take.finished,
            problems: summary.take.problems.iter().map(ToString::to_string).collect(),
            damage: DamageReport::all(&summary.take.damage),
            recovered: recovered(header),
            health: summary.health(),
            ending: summary.take.ending.as_ref().map(|ending| ending.kind.name()),
            ending_detail: detail(summary),
            software: header.software.clone(),
            created: created_unix_ms(header).and_then(utc),
            created_unix_ms: created_unix_ms(header),
            resampler: header.resampler.clone(),
            tolerance_mm: header.tolerance_mm,
            format_version: header.codec_version,
            keys: header.key_distance().map(str::to_owned),
            up_axis: header.up_axis.name(),
            device: header.device.clone(),
            source: header.source.clone().map(|file| ImportSourceReport {
                file,
                bytes: header.source_bytes(),
                unit_given: options.unit.map(|unit| unit.to_string()),
                up_given: options.up.map(|up| up.to_string()),
            }),
            subject: summary.take.subject.as_ref().map(SubjectReport::new),
            foreign_parts: foreign_parts.collect(),
            sampled_groups: SampledGroupReport::all(&summary.take.foreign),
            poses: PosesReport::new(&summary.take),
            frames: summary.take.n_rows,
            seconds: summary.take.n_rows as f64 / header.rate_hz,
            markers: summary.take.channels.len(),
            rate_hz: header.rate_hz,
            samples: summary.samples(),
            raw_bytes: summary.raw_bytes(),
            file_bytes,
            store: None,
            bytes: TakeBytes { framing: bytes.framing + bytes.lengths, ..bytes },
            ratio: size_ratio(summary.samples(), file_bytes),
            max_error_mm: summary.max_error_mm(),
            stretches: summary.stretches,
            sr1: summary.statistics.sr1(),
            sr2: summary.statistics.sr2(),
            ledger: summary.take.ledger.as_ref().map(LedgerDocument::from),
            sample_ledger: summary.take.sample_ledger.as_ref().map(SampleLedgerDocument::from),
            outages: OutagesReport::new(summary.outages.0, summary.outages.1, header.rate_hz),
            clock: ClockReport::new(&summary.clock, &summary.take.clock_lines),
            events: events.collect(),
            channels: channels.collect(),
        }
    }

    /// Recorded frames, by the final ledger; `None` for a take that was cut off, whose last ledger may count too few.
    fn frames_recorded(&self) -> Option<u64> {
        self.ledger.as_ref().filter(|_| self.finished).map(|ledger| ledger.recorded)
    }
}

/// Details of why the take ended, if it states any.
fn detail(summary: &Summary) -> Option<String> {
    let detail = &summary.take.ending.as_ref()?.detail;
    (!detail.is_empty()).then(|| detail.clone())
}

/// When the recording began; `None` for an import.
fn created_unix_ms(header: &Header) -> Option<i64> {
    Some(header.created_unix_ms).filter(|&unix_ms| unix_ms != 0)
}

fn utc(unix_ms: i64) -> Option<String> {
    Some(jiff::Timestamp::from_millisecond(unix_ms).ok()?.to_string())
}

/// The remarks of all recoveries of the take; `None` if it was never recovered.
fn recovered(header: &Header) -> Option<String> {
    let remarks = header.settings.iter().filter(|(key, _)| key == RECOVERED);
    remarks.map(|(_, text)| text.clone()).reduce(|all, next| format!("{all}; again {next}"))
}

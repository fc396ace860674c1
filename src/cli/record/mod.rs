//! `record`: records a device to a take, and reports one take or a divided recording, as JSON (docs/json.md) and as text.

mod watch;

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{
    files::{FileState, SettledFile},
    ledger::{LedgerDocument, SampleLedgerDocument},
    raw_log::RawLog,
    record::Recorded,
    rig::Rig,
    series::{RecordedSeries, SeriesOptions, SeriesTake},
};
use mocapd_codec::Settings;
use mocapd_drivers::{
    registry::OpenError,
    uri::{DeviceUri, Location},
};
use mocapd_service::{process, units};
use mocapd_take::{motion::UpAxis, record::EndingKind};
use serde::{Deserialize, Serialize};

pub(crate) use self::watch::{Limits, record_and_watch};
use self::watch::{RawLogReport, SplitValue, record_series_and_watch};
use super::{
    output::{notify, print, print_json},
    paths, remote,
    stop::stop_on_signal,
    subject::SubjectArgs,
    values::{self, CodecArgs},
};
use crate::cli::{
    ledger::{self, ClockReport, OutagesReport},
    output::plain_path,
    values::{SizeReport, bytes, count, frames_of, rate, thousands},
};

/// Default disk space to keep free: a system with a full disk cannot even log what went wrong.
pub(crate) const KEEP_FREE: &str = "256MiB";

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Device to record: serial:PATH[@BAUD], usb:VID:PID[:SERIAL], qtm:HOST[:PORT], natnet:HOST[:PORT] or lsl:NAME, with ?driver=NAME to choose a driver
    #[arg(short, long, value_name = "URI")]
    device: String,
    /// The take to write; it must not exist
    #[arg(short, long, value_name = "TAKE")]
    output: PathBuf,
    /// Stop after this time: 10s, 500ms, 2min [default: at the end of a replay, or on Ctrl-C]
    #[arg(long, value_name = "TIME", value_parser = values::length, allow_hyphen_values = true)]
    seconds: Option<Duration>,
    /// Begin a new take whenever the current one has this length or size, without losing a frame: 10s, 30min, 500MB,
    /// 2GiB, at least 1s or 1MB; -o run.take writes run-001.take, run-002.take and so on
    #[arg(long, value_name = "TIME|SIZE", value_parser = watch::parse_split, allow_hyphen_values = true)]
    split: Option<SplitValue>,
    /// Set the device to this frame rate: 240, 240Hz, 1kHz; it keeps the rate afterwards
    #[arg(long, value_name = "HZ", value_parser = units::rate_hz, allow_hyphen_values = true)]
    rate: Option<f64>,
    /// Wait this long for a disconnected device to come back before ending the take; 0s ends it at once
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = units::duration, allow_hyphen_values = true)]
    reconnect: Duration,
    /// Write to the file at this interval, 50ms to 10s: a killed process loses no more than this; shorter intervals
    /// make larger files
    #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = values::stretch, allow_hyphen_values = true)]
    stretch: Duration,
    /// Sync the file to disk at this interval: a power cut loses no more than this plus a stretch
    #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = values::sync, allow_hyphen_values = true)]
    sync: Duration,
    /// End the take when no more than this is free on the disk: 256MiB, 2GB; 0 uses the whole disk
    #[arg(long, value_name = "SIZE", default_value = KEEP_FREE, value_parser = units::size_bytes, allow_hyphen_values = true)]
    keep_free: u64,
    /// Also log every byte to and from the device to this file; `mocapd-sim serve` replays it as the device, if that speaks the link protocol (dvmc)
    #[arg(long, value_name = "LOG")]
    raw: Option<PathBuf>,
    /// Largest error of the rotations of rigid bodies: 0.05deg, 0.0001 to 10 degrees [default: the angle by which a point
    /// 200 mm away moves by the tolerance]
    #[arg(long, value_name = "ANGLE", value_parser = units::angle_degrees, conflicts_with = "lossless", allow_hyphen_values = true)]
    angle_tolerance: Option<f64>,
    /// Record the residuals that the device reports with its markers, as sampled channels; takes become several times as
    /// large
    #[arg(long)]
    residuals: bool,
    /// State in the take that this axis points up, x, y or z, if the device does not state one; nothing is rotated
    #[arg(long, value_name = "AXIS", value_parser = values::up_axis)]
    up: Option<UpAxis>,
    #[command(flatten)]
    codec: CodecArgs,
    #[command(flatten)]
    subject: SubjectArgs,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Parses the device. Unlike the service, `record` has no default: the user names the device.
fn device(text: &str) -> anyhow::Result<DeviceUri> {
    if text == "auto" {
        let message = "--device auto: only the service selects a device (device.uri = \"auto\"): \
                       give the one to record, as `mocapd devices` lists it, such as serial:/dev/ttyUSB0";
        return Err(UsageError(message.to_owned()).into());
    }
    Ok(text.parse().map_err(|error| UsageError(format!("{error}")))?)
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let uri = device(&args.device)?;
    let codec = args.codec.live_settings()?;
    let options = |split: &SplitValue| split.options(&args.output, args.seconds, args.stretch);
    let series = args.split.as_ref().map(options).transpose()?;
    let first = series.as_ref().map_or_else(|| args.output.clone(), |series| series.names.path(1));
    remote::refuse_recording(&args.output)?;
    paths::check_take_output(&first)?;
    if let Some(raw) = &args.raw {
        if paths::are_one(raw, &first) {
            return Err(UsageError("--raw and --output name the same file".to_owned()).into());
        }
        remote::refuse_recording(raw)?;
        paths::check_output(raw)?;
        let is_stream = match &uri.location {
            Location::Network(at) => !at.datagrams,
            Location::Streams(_) => true,
            Location::Serial { .. } | Location::Usb { .. } => false,
        };
        if is_stream {
            notify(
                "a raw log of a device on the network cannot be replayed: it shows what was sent",
            );
        }
    }
    let subject = args.subject.load()?;
    let stop = stop_on_signal()?;
    let raw = args.raw.as_deref();
    let has_take =
        || series.as_ref().map_or_else(|| first.exists(), |series| series.names.any_exists());
    let ((recorded, takes), log) = watch::with_raw_log(raw, has_take, args.sync, |log| {
        let opened = Rig::open_logged(&uri, log.map(RawLog::tap));
        let mut rig = opened.map_err(|error| match error.downcast_ref() {
            Some(OpenError::UnknownDriver { .. }) => UsageError(error.to_string()).into(),
            _ => error,
        })?;
        if let Some(rate_hz) = args.rate {
            rig.set_rate(rate_hz).map_err(watch::name_option)?;
        }
        rig.wait_for_replug(args.reconnect);
        rig.limit_loss(args.stretch, args.sync);
        rig.limit_angles(args.angle_tolerance);
        rig.record_residuals(args.residuals);
        if let Some(axis) = args.up {
            rig.state_up_axis(axis);
            let stated = rig.up_axis();
            if let (true, Some(name)) = (stated != axis, stated.name()) {
                notify(&format!("the device states that {name} points up: --up is not used"));
            }
        }
        let same_disk = log.filter(|log| paths::are_on_one_disk(log.path(), &first));
        let limits = Limits {
            length: args.seconds,
            keep_free_bytes: args.keep_free,
            raw_log_bytes: same_disk.map(RawLog::file_bytes),
            subject,
        };
        let Some(series) = &series else {
            let recorded = record_and_watch(rig, &args.output, codec, &limits, &stop)?;
            return Ok((recorded, Vec::new()));
        };
        let recorded = record_series_and_watch(rig, &args.output, series, codec, &limits, &stop)?;
        let RecordedSeries { takes, total } = recorded;
        Ok((total, takes))
    })?;
    let report = RecordReport::new(&args.output, &recorded, &codec).with_log(log);
    if let Some(series) = &series {
        let report = SeriesReport::new(&report, series, &takes);
        print_report(args.json, &report, || report.text())?;
    } else {
        print_report(args.json, &report, || report.text())?;
    }
    Ok(outcome(&recorded, &report, &takes))
}

fn print_report(
    json: bool,
    report: &impl Serialize,
    text: impl FnOnce() -> String,
) -> anyhow::Result<()> {
    if json { print_json(report) } else { print(&text()) }
}

/// Reports what went wrong on stderr. `takes`: those of a recording that was divided.
fn outcome(recorded: &Recorded, report: &RecordReport, takes: &[SeriesTake]) -> Outcome {
    let disconnected = recorded.recording.ending == EndingKind::DeviceGone;
    if disconnected {
        notify("the device was disconnected: the take ends there");
    }
    let is_full = recorded.recording.ending == EndingKind::DiskFull;
    if is_full {
        notify(&report.disk_full());
    }
    let files = std::iter::once(&recorded.file).chain(takes.iter().map(|take| &take.file));
    files.filter_map(SettledFile::message).for_each(|notice| notify(&notice));
    if let Some(outages) = report.outages.text() {
        notify(&outages);
    }
    if let Some(losses) = report.losses() {
        notify(&format!("not in the take: {losses}"));
    }
    let sample_losses = report.sample_losses();
    sample_losses.iter().for_each(|losses| notify(losses));
    if let Some(why) = report.not_closing() {
        notify(&why);
    }
    let ledger = &recorded.written.ledger;
    let had_outage = disconnected || recorded.recording.outages > 0;
    let is_displaced = recorded.file.state != FileState::InPlace;
    let lost_anything = ledger.lost_anything()
        || !sample_losses.is_empty()
        || !ledger.closes()
        || report.log_lost();
    Outcome::of(lost_anything || had_outage || is_full || is_displaced)
}

#[derive(Debug, Serialize)]
pub(crate) struct RecordReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    ending: &'static str,
    file_state: FileState,
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text_or_null")]
    file_path: Option<PathBuf>,
    frames: u64,
    seconds: f64,
    markers: usize,
    #[serde(skip)]
    markers_appeared: u64,
    rate_hz: f64,
    #[serde(flatten)]
    size: SizeReport,
    ring_latency_us: LatencyReport,
    process: ProcessReport,
    disk: DiskReport,
    raw_log: Option<RawLogReport>,
    outages: OutagesReport,
    clock: Option<ClockReport>,
    ledger: LedgerDocument,
    sample_ledger: Option<SampleLedgerDocument>,
}

#[derive(Debug, Serialize)]
struct DiskReport {
    free_bytes: Option<u64>,
    seconds_left: Option<f64>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct LatencyReport {
    pub(crate) p50: f64,
    pub(crate) p99: f64,
    pub(crate) max: f64,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct ProcessReport {
    pub(crate) cpu_s: f64,
    pub(crate) peak_memory_bytes: u64,
}

impl RecordReport {
    pub(crate) fn new(take: &Path, recorded: &Recorded, codec: &Settings) -> Self {
        let written = &recorded.written;
        let (latency, counts) = (&recorded.recording.ring_latency, &recorded.recording.counts);
        let (ledger, disk, rate_hz) = (&written.ledger, &written.disk, recorded.rate_hz);
        let us = |ns: u64| ns as f64 / 1e3;
        let process::Usage { cpu_s, peak_memory_bytes } = process::usage(None).unwrap_or_default();
        Self {
            take: take.to_owned(),
            ending: match recorded.recording.ending {
                EndingKind::DeviceEnded => "end of stream",
                EndingKind::DeviceGone => "disconnected",
                EndingKind::Length => "stopped",
                EndingKind::CutOff => "writer failed",
                ending => ending.name(),
            },
            file_state: recorded.file.state,
            file_path: recorded.file.path.clone(),
            frames: ledger.recorded,
            seconds: ledger.frames_sent as f64 / rate_hz,
            markers: recorded.markers,
            markers_appeared: counts.markers_appeared,
            rate_hz,
            size: SizeReport::new(written, codec),
            ring_latency_us: LatencyReport {
                p50: us(latency.quantile_ns(0.5)),
                p99: us(latency.quantile_ns(0.99)),
                max: us(latency.max_ns()),
            },
            process: ProcessReport { cpu_s, peak_memory_bytes },
            disk: DiskReport { free_bytes: disk.free_bytes, seconds_left: disk.left_s },
            raw_log: None,
            outages: OutagesReport::new(counts.outages, ledger.unknown_after_disconnect, rate_hz),
            clock: ClockReport::new(&written.clock, &written.clock_lines),
            ledger: LedgerDocument::from(ledger),
            sample_ledger: written.sample_ledger.as_ref().map(SampleLedgerDocument::from),
        }
    }

    /// Adds the report of the raw log.
    fn with_log(self, raw_log: Option<RawLogReport>) -> Self {
        Self { raw_log, ..self }
    }

    /// Whether the raw log lacks bytes of the line.
    fn log_lost(&self) -> bool {
        self.raw_log.as_ref().is_some_and(RawLogReport::lost)
    }

    /// What was lost, by cause and in one line.
    pub(crate) fn losses(&self) -> Option<String> {
        ledger::losses(&self.ledger)
    }

    /// The samples of sampled channels that were lost, one line per group.
    pub(crate) fn sample_losses(&self) -> Vec<String> {
        self.sample_ledger.as_ref().map(ledger::sample_losses).unwrap_or_default()
    }

    fn samples_text(&self) -> String {
        self.sample_ledger.as_ref().map(ledger::samples_text).unwrap_or_default()
    }

    /// Why the ledger does not close, in one line.
    pub(crate) fn not_closing(&self) -> Option<String> {
        ledger::not_closing(&self.ledger)
    }

    /// The warning that the take ended because the disk is full.
    fn disk_full(&self) -> String {
        let free = self.disk.free_bytes.map_or("little".to_owned(), bytes);
        format!(
            "the disk is nearly full ({free} left): the take was closed early and is intact; free some space before the next"
        )
    }

    /// The number of markers. Unlabelled markers are not announced: they appear during the recording, and the same one
    /// may reappear under another number.
    fn markers_text(&self) -> String {
        let announced = count(self.markers as u64, "marker");
        match self.markers_appeared {
            0 => announced,
            more => format!("{announced} announced and {} that appeared later", thousands(more)),
        }
    }

    pub(crate) fn text(&self) -> String {
        self.text_of(&plain_path(&self.take))
    }

    /// The text, with a name for what was recorded.
    fn text_of(&self, name: &str) -> String {
        format!(
            "{name}: {} of {} at {}, {}\n{}{}{}",
            frames_of(self.frames, self.ledger.frames_sent),
            self.markers_text(),
            rate(self.rate_hz),
            self.size.text(),
            self.raw_log.as_ref().map(RawLogReport::text).unwrap_or_default(),
            ledger::text(&self.ledger) + &self.samples_text(),
            self.clock.as_ref().map(ClockReport::text).unwrap_or_default()
        )
    }
}

/// The report of the recording as a whole, and of each take.
#[derive(Debug, Serialize)]
struct SeriesReport<'a> {
    #[serde(flatten)]
    total: &'a RecordReport,
    split: &'a str,
    parts: Vec<PartReport>,
}

/// One take of the series.
#[derive(Debug, Serialize)]
struct PartReport {
    part: u64,
    first_frame: u64,
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    ending: &'static str,
    file_state: FileState,
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text_or_null")]
    file_path: Option<PathBuf>,
    frames: u64,
    seconds: f64,
    samples: u64,
    file_bytes: u64,
    max_error_mm: f64,
    ledger: LedgerDocument,
    sample_ledger: Option<SampleLedgerDocument>,
}

impl PartReport {
    fn new(take: &SeriesTake, rate_hz: f64) -> Self {
        let SeriesTake { path, part, first_row, written, file } = take;
        let ledger = &written.ledger;
        Self {
            part: *part,
            first_frame: *first_row,
            take: path.clone(),
            ending: written.ending.kind.name(),
            file_state: file.state,
            file_path: file.path.clone(),
            frames: ledger.recorded,
            seconds: ledger.frames_sent as f64 / rate_hz,
            samples: written.samples,
            file_bytes: written.file_bytes,
            max_error_mm: written.max_error_mm,
            ledger: LedgerDocument::from(ledger),
            sample_ledger: written.sample_ledger.as_ref().map(SampleLedgerDocument::from),
        }
    }

    fn text(&self) -> String {
        let frames = frames_of(self.frames, self.ledger.frames_sent);
        let path = plain_path(&self.take);
        format!("{path}: {frames} from frame {}, {}\n", self.first_frame, bytes(self.file_bytes))
    }
}

impl<'a> SeriesReport<'a> {
    fn new(total: &'a RecordReport, options: &'a SeriesOptions, takes: &[SeriesTake]) -> Self {
        let parts = takes.iter().map(|take| PartReport::new(take, total.rate_hz));
        Self { total, split: &options.length_text, parts: parts.collect() }
    }

    fn text(&self) -> String {
        let parts: String = self.parts.iter().map(PartReport::text).collect();
        let all = count(self.parts.len() as u64, "take");
        format!("{parts}{}", self.total.text_of(&all))
    }
}

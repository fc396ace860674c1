//! `import`: converts motion files of other tools to takes.

use std::{
    io::{BufReader, BufWriter},
    path::{Path, PathBuf},
};

use anyhow::{Context, bail, ensure};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{
    inspect::Summary,
    ledger::TakeHealth,
    pipeline::{TakeAccount, offline},
};
use mocapd_codec::{Effort, Settings};
use mocapd_service::subject::unused_part_notes;
use mocapd_take::{
    TakeEnds,
    foreign::tolerance::{AnalogTolerance, ChannelTolerance},
    import::ImportSettings,
    interchange::{Direction, LengthUnit, ReadOptions},
    motion::{Ambiguity, MotionInfo},
    record::Header,
};
use serde::Serialize;

use super::{
    batch::{
        self, Batch, Destination, Figures, FileKinds, FileReport, Input, InputArgs, Job,
        outputs::{self, SeekWrite},
    },
    motion_files::Import,
    output::{plain, plain_path},
    paths::{self, InputFormatName},
    remote,
    subject::SubjectArgs,
    values::{CodecArgs, EffortArgs, SizeReport, count, rate, thousands, tolerance_mm},
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// .c3d, .trc, .tsv (QTM) or .csv files, or folders with such files; `-` reads standard input, with --format
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// The take to write, which must not exist, or the folder for the takes of several files; `-` writes one take to
    /// standard output. In a folder, or beside its file, a take that was already imported from the same file with the same
    /// settings is left unchanged [default: beside each file]
    #[arg(short, long, value_name = "TAKE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    input: InputArgs,
    /// Format of standard input, and of files whose extension does not show it
    #[arg(long, value_name = "FORMAT")]
    format: Option<InputFormatName>,
    #[command(flatten)]
    codec: CodecArgs,
    #[command(flatten)]
    effort: EffortArgs,
    /// Largest error of analog channels of C3D files, which are exact otherwise: in steps of the converter (1count), in
    /// the unit of the channel (0.5N, or 0.5 for whichever unit it has), or in % of the channel's range (0.1%); to limit
    /// it to some channels, put a pattern with * and ? before it (EMG*=0.1%, F?z*=0.5N). Can be repeated: the last match
    /// applies
    #[arg(long, value_name = "[PATTERN=]VALUE", value_parser = str::parse::<ChannelTolerance>, conflicts_with = "drop_foreign")]
    analog_tolerance: Vec<ChannelTolerance>,
    #[command(flatten)]
    subject: SubjectArgs,
    /// Unit of length of the files, if they state none or a wrong one: mm, cm, dm, m, um, in, ft
    #[arg(long, value_name = "UNIT")]
    unit: Option<LengthUnit>,
    /// Axis that points up in the files, if they state none or a wrong one: x, y, z; with -x, -y or -z the takes are
    /// rotated by 180 degrees, so that the positive axis points up
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    up: Option<Direction>,
    /// Import marker trajectories only, without analog channels, residuals, model outputs and parameters
    #[arg(long)]
    drop_foreign: bool,
    /// Compare each take with its source, sample by sample, after it is written
    #[arg(long)]
    verify: bool,
    /// Number of resampler threads for all files together; the takes are the same for any number [default: one per
    /// core, at most 8]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
    /// Print one JSON document, or one per line for several files
    #[arg(long)]
    json: bool,
}

/// The settings shared by all files.
struct ImportPlan<'a> {
    args: &'a Args,
    settings: ImportSettings,
    is_folder: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let codec = args.codec.settings()?;
    let format = args.format.map(Into::into);
    let inputs = batch::inputs::find(&args.files, &args.input, FileKinds::MotionFiles, format)?;
    let destination = Destination::of(args.output.as_deref(), &inputs)?;
    let paths_of_outputs = destination.take_paths(&inputs, args.json)?;
    let is_stream = destination == Destination::Stdout || inputs.files.iter().any(Input::is_stdin);
    if args.verify && is_stream {
        let message = "--verify reads the source and the take again: give both as files";
        bail!(UsageError(message.to_owned()));
    }
    let plan = ImportPlan {
        args,
        settings: ImportSettings {
            codec,
            effort: args.effort.effort(&codec)?,
            key_distance: args.effort.key_distance(&codec)?,
            analog: AnalogTolerance(args.analog_tolerance.clone()),
            options: ReadOptions { unit: args.unit, up: args.up },
            drops_foreign: args.drop_foreign,
            subject: args.subject.load()?,
        },
        is_folder: matches!(destination, Destination::Folder(_)),
    };
    let batch = Batch {
        inputs: &inputs,
        outputs: &paths_of_outputs,
        json: args.json,
        text_to_stderr: destination == Destination::Stdout,
        lines_to_stderr: false,
        threads: batch::thread_count(args.threads),
        doing: "importing",
        done: "imported",
        is_compression: true,
    };
    batch::run(&batch, |job| plan.import(job))
}

impl ImportPlan<'_> {
    fn import(&self, job: &Job<'_>) -> anyhow::Result<FileReport> {
        let args = self.args;
        let (codec, subject) = (self.settings.codec, self.settings.subject.as_ref());
        let name = &job.input.name;
        let bytes_read = remote::len_bytes(&job.input.path).unwrap_or_default();
        let reading = job.phase("reading", bytes_read);
        let mut import = Import::open(job.input, &self.settings, &reading.counter)?;
        let info = import.info();
        check_unit(info, name, tolerance_mm(&codec))?;
        info.source.warnings.iter().for_each(|warning| job.notify(warning));
        let foreign_dropped = import.foreign_dropped.clone();
        if !foreign_dropped.is_empty() {
            job.notify(&format!("left out (--drop-foreign): {}", foreign_dropped.join(", ")));
        }
        let unseen = unused_part_notes(subject, &info.labels());
        unseen.iter().for_each(|warning| job.notify(warning));
        let n_samples = offline::sample_count(info)?;
        let header = import.header()?;
        drop(reading);
        let output = job.output.context("no output name: please report this bug")?;
        let before = if paths::is_dash(output) { None } else { existing(output, &header)? };
        let is_unchanged = before.is_some();
        let (info, written) = match before {
            Some(before) => (import.into_info(), before),
            None => {
                let phase = job.phase("resampling", n_samples);
                let write = |out: &mut dyn SeekWrite| {
                    import.write(&header, job.threads, &phase.counter, BufWriter::new(out), output)
                };
                outputs::write_whole(output, self.is_folder, write)?.0
            }
        };
        if written.samples == 0 {
            job.notify("no samples: the take holds only gaps");
        }
        let mut report = ImportReport::new(output, &info, &codec, &written, foreign_dropped);
        report.analog_tolerance = self.settings.analog.to_string();
        report.note_exact_analog(&info).iter().for_each(|note| job.notify(note));
        (report.file, report.unchanged) = (name.clone(), is_unchanged);
        report.effort = self.settings.effort.level();
        if args.verify {
            compare(output, job)?;
            report.verified = true;
        }
        Ok(FileReport {
            data_lost: info.source.frames_missing > 0,
            text: report.text(),
            line: report.text(),
            json: job.json(&report)?,
            figures: Figures {
                frames: report.frames,
                seconds: report.seconds,
                bytes_read,
                bytes_written: written.file_bytes,
                is_unchanged,
            },
            ..FileReport::default()
        })
    }
}

/// The take at `path` if it is complete and has the id of this import: the same bytes and settings. It is read
/// completely, so that a damaged one does not count as done.
///
/// # Errors
/// If its length cannot be determined. A take that cannot be read counts as none.
fn existing(path: &Path, header: &Header) -> anyhow::Result<Option<TakeAccount>> {
    let Ok(file) = remote::open(path) else { return Ok(None) };
    let file_bytes = file.len_bytes()?;
    let Ok(summary) = Summary::read_stated(BufReader::new(file)) else { return Ok(None) };
    if summary.take.header.take_id != header.take_id || summary.health() != TakeHealth::Complete {
        return Ok(None);
    }
    Ok(Some(TakeAccount {
        file_bytes,
        samples: summary.samples(),
        kept: summary.statistics.knots(),
        max_error_mm: summary.max_error_mm(),
        ledger: summary.take.ledger.unwrap_or_default(),
        ..TakeAccount::default()
    }))
}

/// Compares a new take with its source.
///
/// # Errors
/// If a sample is not within the tolerance, or a gap differs.
fn compare(output: &Path, job: &Job<'_>) -> anyhow::Result<()> {
    let tolerance_mm = TakeEnds::read(&mut remote::open(output)?)?.header.tolerance_mm;
    let report = super::verify::against(output, &job.input.path, tolerance_mm)?;
    ensure!(
        report.is_within(),
        "{} differs from {}: {}",
        output.display(),
        job.input.name.display(),
        report.text(tolerance_mm).trim_end()
    );
    Ok(())
}

/// Refuses a tolerance that would destroy the motion if the unit of the file, unstated or implausible, is not the one
/// assumed.
///
/// # Errors
/// A usage error that recommends `--unit`.
fn check_unit(info: &MotionInfo, file: &Path, tolerance_mm: f64) -> anyhow::Result<()> {
    let is_destroyed = |found: &&Ambiguity| found.is_destroyed_by(tolerance_mm);
    let found = info.source.ambiguities.iter().find(is_destroyed);
    let why = match found {
        Some(Ambiguity::Unit { stated, span }) => {
            let unit = match stated.as_str() {
                "" => "no unit of length is stated".to_owned(),
                unit => format!("the unit of length `{}` is unknown", plain(unit)),
            };
            format!("{unit}, and all markers lie within {span:.4} units")
        }
        Some(Ambiguity::StatedUnit { stated, span_mm }) => format!(
            "the unit of length is stated as `{}`, in which all markers lie within {span_mm:.4} mm",
            plain(stated)
        ),
        _ => return Ok(()),
    };
    bail!(UsageError(format!(
        "{}: {why}; as millimetres, a tolerance of {tolerance_mm} mm would destroy the motion: give --unit (mm, cm, m, \
         in...), or --lossless to keep every bit as it is read",
        file.display()
    )))
}

#[derive(Debug, Serialize)]
pub(super) struct ImportReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    /// The source.
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    file: PathBuf,
    /// Whether the take existed, written from the same file with the same settings.
    unchanged: bool,
    frames: u64,
    frames_missing: u64,
    seconds: f64,
    markers: usize,
    rate_hz: f64,
    #[serde(flatten)]
    size: SizeReport,
    /// 1 for every resampler but dense.
    effort: u8,
    samples_missing: u64,
    foreign_dropped: Vec<String>,
    /// Analog channels whose samples are not those of the file, but within their tolerance.
    analog_channels_inexact: usize,
    /// As given; empty without any.
    #[serde(skip)]
    analog_tolerance: String,
    warnings: Vec<String>,
    /// Whether the take was compared with its source, with `--verify`: a difference is an error.
    verified: bool,
}

impl ImportReport {
    pub(super) fn new(
        take: &Path,
        info: &MotionInfo,
        codec: &Settings,
        written: &TakeAccount,
        foreign_dropped: Vec<String>,
    ) -> Self {
        let (frames, n_markers) = (info.n_frames, info.markers.len() as u64);
        Self {
            take: take.to_owned(),
            file: PathBuf::new(),
            unchanged: false,
            frames,
            frames_missing: info.source.frames_missing,
            seconds: frames as f64 / info.rate_hz,
            markers: info.markers.len(),
            rate_hz: info.rate_hz,
            size: SizeReport::new(written, codec),
            effort: Effort::MIN.level(),
            samples_missing: frames.saturating_mul(n_markers).saturating_sub(written.samples),
            foreign_dropped,
            analog_channels_inexact: info.n_inexact_channels(),
            analog_tolerance: String::new(),
            warnings: info.source.warnings.clone(),
            verified: false,
        }
    }

    /// What to say of a tolerance that changed no sample.
    fn note_exact_analog(&self, info: &MotionInfo) -> Option<String> {
        let tolerance = &self.analog_tolerance;
        match self.analog_channels_inexact {
            0 if tolerance.is_empty() => None,
            0 if info.has_analog() => Some(format!(
                "--analog-tolerance {tolerance} changes nothing: every analog sample is exact"
            )),
            0 => Some(format!("--analog-tolerance {tolerance}: the file has no analog channels")),
            _ => None,
        }
    }

    pub(super) fn text(&self) -> String {
        let gaps = match self.samples_missing {
            0 => String::new(),
            n => format!(" ({} samples missing)", thousands(n)),
        };
        let analog = match self.analog_channels_inexact {
            0 => String::new(),
            n => format!(
                "; {} within {}, not exact",
                count(n as u64, "analog channel"),
                self.analog_tolerance
            ),
        };
        let unchanged = if self.unchanged { "; unchanged, imported before" } else { "" };
        let verified = if self.verified { "; compared with the source" } else { "" };
        format!(
            "{}: {} of {}{gaps} at {}, {}{analog}{unchanged}{verified}\n",
            plain_path(&self.take),
            count(self.frames, "frame"),
            count(self.markers as u64, "marker"),
            rate(self.rate_hz),
            self.size.text(),
        )
    }
}

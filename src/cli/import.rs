//! `import`: converts a motion file of another tool to a take.

use std::path::{Path, PathBuf};

use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{pipeline::TakeAccount, threads};
use mocapd_codec::Settings;
use mocapd_service::subject::unused_part_notes;
use mocapd_take::{
    interchange::{Direction, LengthUnit, ReadOptions},
    motion::{Ambiguity, MotionInfo},
};
use serde::Serialize;

use super::{
    original::{Import, ImportProgress, ImportSettings},
    output::{Progress, notify, plain, plain_path, print, print_json},
    paths,
    subject::SubjectArgs,
    values::{CodecArgs, SizeReport, count, thousands, tolerance_mm},
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A .c3d, .trc, .tsv (QTM) or .csv file
    file: PathBuf,
    /// The take to write; it must not exist
    #[arg(short, long, value_name = "TAKE")]
    output: PathBuf,
    #[command(flatten)]
    codec: CodecArgs,
    #[command(flatten)]
    subject: SubjectArgs,
    /// Unit of length of the file, if it states none or a wrong one: mm, cm, dm, m, um, in, ft
    #[arg(long, value_name = "UNIT")]
    unit: Option<LengthUnit>,
    /// Axis that points up in the file, if it states none or a wrong one: x, y, z; with -x, -y or -z the take is
    /// rotated so that the axis points up
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    up: Option<Direction>,
    /// Import marker trajectories only, without analog channels, model outputs and other parameters
    #[arg(long)]
    drop_foreign: bool,
    /// Number of resampler threads; the take is the same for any number [default: one per core, at most 8]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let codec = args.codec.settings()?;
    paths::check_take_output(&args.output)?;
    let settings = ImportSettings {
        codec,
        options: ReadOptions { unit: args.unit, up: args.up },
        drops_foreign: args.drop_foreign,
        subject: args.subject.load()?,
        n_workers: args.threads.map_or_else(threads::default_workers, usize::from),
    };
    let counters = ImportProgress::default();
    let import = Import::open(&args.file, &settings, &counters)?;
    let info = import.info();
    check_unit(info, &args.file, tolerance_mm(&codec))?;
    let about_file = |message: &str| notify(&format!("{}: {message}", args.file.display()));
    info.source.warnings.iter().for_each(|warning| about_file(warning));
    let foreign_dropped = import.foreign_dropped.clone();
    if !foreign_dropped.is_empty() {
        about_file(&format!("left out (--drop-foreign): {}", foreign_dropped.join(", ")));
    }
    let unseen = unused_part_notes(settings.subject.as_ref(), &info.labels());
    unseen.iter().for_each(|warning| about_file(warning));
    let n_samples = info.n_frames.saturating_mul(info.markers.len() as u64);
    let progress = Progress::follow("resampling", &counters.samples, n_samples);
    let (info, written) = import.write(&args.output)?;
    drop(progress);
    if written.samples == 0 {
        about_file("no samples: the take holds only gaps");
    }
    let report = ImportReport::new(&args.output, &info, &codec, &written, foreign_dropped);
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.text())?;
    }
    Ok(Outcome::of(info.source.frames_missing > 0))
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
            format!("{unit}, and all markers are within {span:.4} of it")
        }
        Some(Ambiguity::StatedUnit { stated, span_mm }) => format!(
            "the unit of length is stated as `{}`, in which all markers are within {span_mm:.4} mm",
            plain(stated)
        ),
        _ => return Ok(()),
    };
    anyhow::bail!(UsageError(format!(
        "{}: {why}; as millimetres, a tolerance of {tolerance_mm} mm would destroy the motion: give --unit (mm, cm, m, \
         in...), or --lossless to keep every bit as it is read",
        file.display()
    )))
}

#[derive(Debug, Serialize)]
pub(super) struct ImportReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    frames: u64,
    frames_missing: u64,
    seconds: f64,
    markers: usize,
    rate_hz: f64,
    #[serde(flatten)]
    size: SizeReport,
    samples_missing: u64,
    foreign_dropped: Vec<String>,
    warnings: Vec<String>,
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
            frames,
            frames_missing: info.source.frames_missing,
            seconds: frames as f64 / info.rate_hz,
            markers: info.markers.len(),
            rate_hz: info.rate_hz,
            size: SizeReport::new(written, codec),
            samples_missing: frames.saturating_mul(n_markers).saturating_sub(written.samples),
            foreign_dropped,
            warnings: info.source.warnings.clone(),
        }
    }

    pub(super) fn text(&self) -> String {
        let gaps = match self.samples_missing {
            0 => String::new(),
            n => format!(" ({} samples missing)", thousands(n)),
        };
        format!(
            "{}: {} of {}{gaps} at {} Hz, {}\n",
            plain_path(&self.take),
            count(self.frames, "frame"),
            count(self.markers as u64, "marker"),
            self.rate_hz,
            self.size.text(),
        )
    }
}

//! `import`: converts a motion file of another tool to a take.

use std::{
    io::BufWriter,
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicU64},
};

use anyhow::Context;
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{
    files::NewFile,
    pipeline::{TakeAccount, offline},
    threads,
};
use mocapd_codec::Settings;
use mocapd_service::subject::unused_part_notes;
use mocapd_take::{
    interchange::{Direction, LengthUnit, ReadOptions},
    motion::{Ambiguity, Motion},
    record::Header,
};
use serde::Serialize;

use super::{
    original::{header_of, read_motion_and_bytes},
    output::{Progress, notify, plain, plain_path, print, print_json},
    paths,
    subject::SubjectArgs,
    values::{CodecArgs, SizeReport, count, rate, thousands, tolerance_mm},
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
    let subject = args.subject.load()?;
    let options = ReadOptions { unit: args.unit, up: args.up };
    let (mut motion, bytes) = read_motion_and_bytes(&args.file, &options)?;
    check_unit(&motion, &args.file, tolerance_mm(&codec))?;
    let about_file = |message: &str| notify(&format!("{}: {message}", args.file.display()));
    motion.info.source.warnings.iter().for_each(|warning| about_file(warning));
    let mut foreign_dropped = Vec::new();
    if args.drop_foreign && !motion.info.foreign.is_empty() {
        foreign_dropped.extend(motion.info.foreign.drain(..).map(|part| part.kind));
        about_file(&format!("left out (--drop-foreign): {}", foreign_dropped.join(", ")));
    }
    let mut header = header_of(&motion, &args.file, &codec);
    header.settings.extend(options.settings());
    if args.drop_foreign {
        header.settings.push(("drop_foreign".to_owned(), "true".to_owned()));
    }
    let unseen = unused_part_notes(subject.as_ref(), &motion.info.labels());
    unseen.iter().for_each(|warning| about_file(warning));
    header.set_source_bytes(bytes.len() as u64);
    header.set_import_id(&bytes, subject.as_ref())?;
    motion.info.subject = subject;
    drop(bytes);
    let workers = args.threads.map_or_else(threads::default_workers, usize::from);
    let written = write(&motion, &header, workers, &args.output)
        .with_context(|| format!("cannot write {}", args.output.display()))?;
    if written.samples == 0 {
        about_file("no samples: the take holds only gaps");
    }
    let report = ImportReport::new(&args.output, &motion, &codec, &written, foreign_dropped);
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.text())?;
    }
    Ok(Outcome::of(motion.info.source.frames_missing > 0))
}

/// Refuses a tolerance that would destroy the motion if the unit of the file, unstated or implausible, is not the one
/// assumed.
///
/// # Errors
/// A usage error that recommends `--unit`.
fn check_unit(motion: &Motion, file: &Path, tolerance_mm: f64) -> anyhow::Result<()> {
    let is_destroyed = |found: &&Ambiguity| found.is_destroyed_by(tolerance_mm);
    let found = motion.info.source.ambiguities.iter().find(is_destroyed);
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

fn write(
    motion: &Motion,
    header: &Header,
    workers: usize,
    to: &Path,
) -> anyhow::Result<TakeAccount> {
    let mut output = NewFile::create(to)?;
    let counter = Arc::new(AtomicU64::new(0));
    let progress = Progress::follow("resampling", &counter, motion.positions_mm.len() as u64);
    let out = BufWriter::new(&mut output);
    let (written, out) = offline::write_take(motion, header, workers, &counter, out)?;
    drop(out);
    drop(progress);
    output.keep()?;
    Ok(written)
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
        motion: &Motion,
        codec: &Settings,
        written: &TakeAccount,
        foreign_dropped: Vec<String>,
    ) -> Self {
        let info = &motion.info;
        let frames = motion.n_frames() as u64;
        Self {
            take: take.to_owned(),
            frames,
            frames_missing: info.source.frames_missing,
            seconds: frames as f64 / info.rate_hz,
            markers: info.markers.len(),
            rate_hz: info.rate_hz,
            size: SizeReport::new(written, codec),
            samples_missing: (motion.positions_mm.len() as u64).saturating_sub(written.samples),
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
            "{}: {} of {}{gaps} at {}, {}\n",
            plain_path(&self.take),
            count(self.frames, "frame"),
            count(self.markers as u64, "marker"),
            rate(self.rate_hz),
            self.size.text(),
        )
    }
}

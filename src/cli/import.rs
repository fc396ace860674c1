//! `import`: a file of the field becomes a take.

use std::{
    io::{BufWriter, Read},
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicU64},
};

use anyhow::{Context, bail};
use mocapd::{
    files::{self, NewFile},
    header, inspect,
    outcome::{Outcome, UsageError},
    pipeline::offline,
    threads,
};
use mocapd_take::{
    interchange::Format,
    motion::{Motion, is_gap},
    record::ImportSource,
};
use serde::Serialize;

use super::{
    codec_args::CodecArgs,
    output::{bytes, print, print_json, say, thousands},
    progress::Progress,
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
    /// Leave out what is not marker trajectories (analog channels, model outputs, foreign parameters)
    #[arg(long)]
    drop_foreign: bool,
    /// Resampler threads; the bytes are the same for any number
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    take: PathBuf,
    frames: u64,
    markers: usize,
    rate_hz: f64,
    samples: u64,
    raw_bytes: u64,
    file_bytes: u64,
    ratio: f64,
    max_error_mm: f64,
    recoded_blocks: u64,
    foreign_dropped: Vec<String>,
    frames_missing: u64,
    warnings: Vec<String>,
}

/// By a file's ending, or a usage error that lists them.
pub(crate) fn format_of(path: &Path) -> anyhow::Result<Format> {
    Format::from_extension(path).ok_or_else(|| {
        let message = format!("{}: the ending tells the format: use .c3d, .trc, .tsv or .csv", path.display());
        UsageError(message).into()
    })
}

/// Reads a whole file of the field.
pub(crate) fn read_motion(path: &Path) -> anyhow::Result<Motion> {
    let format = format_of(path)?;
    let mut file = Vec::new();
    let reading = || format!("cannot read {}", path.display());
    files::open(path)?.read_to_end(&mut file).with_context(reading)?;
    let motion = format.read(&file).with_context(reading)?;
    if motion.info.markers.is_empty() {
        bail!("{} holds no markers: there is nothing to make a take of", path.display());
    }
    if motion.n_frames() == 0 {
        bail!("{} holds no frames: there is nothing to make a take of", path.display());
    }
    Ok(motion)
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let codec = args.codec.settings();
    let mut output = NewFile::create(&args.output)?;
    let mut motion = read_motion(&args.file)?;
    for warning in &motion.info.source.warnings {
        say(&format!("{}: {warning}", args.file.display()));
    }
    let mut foreign_dropped = Vec::new();
    if args.drop_foreign {
        foreign_dropped.extend(motion.info.foreign.drain(..).map(|part| part.kind));
        say(&format!("left out, as asked: {}", foreign_dropped.join(", ")));
    }
    let n_rows = motion.n_frames();
    let mut header = header::new(&codec, motion.info.rate_hz)?;
    header.up_axis = motion.info.up.code();
    header.stretch_rows = offline::stretch_rows(&codec, motion.info.rate_hz, n_rows) as u32;
    header.channels = header::channels(&motion.info.markers);
    let source = &motion.info.source;
    header.source = Some(ImportSource {
        format: source.format.clone(),
        file: args.file.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        unit: source.unit.clone(),
        factor: source.factor,
        first_frame: source.first_frame,
        warnings: source.warnings.clone(),
    });

    let counter = Arc::new(AtomicU64::new(0));
    let progress = Progress::follow("resampling", &counter, motion.positions_mm.len() as u64);
    let workers = args.threads.map_or_else(threads::default_workers, usize::from);
    let (written, out) =
        offline::write_take(&motion, &header, workers, &counter, BufWriter::new(&mut output))?;
    drop(out);
    drop(progress);
    output.keep()?;

    let samples = motion.positions_mm.iter().filter(|&&p| !is_gap(p)).count() as u64;
    let report = Report {
        take: args.output.clone(),
        frames: n_rows as u64,
        markers: motion.info.markers.len(),
        rate_hz: motion.info.rate_hz,
        samples,
        raw_bytes: 12 * samples,
        file_bytes: written.file_bytes,
        ratio: inspect::size_ratio(samples, written.file_bytes),
        max_error_mm: written.max_error_mm,
        recoded_blocks: written.recoded,
        foreign_dropped,
        frames_missing: motion.info.source.frames_missing,
        warnings: motion.info.source.warnings.clone(),
    };
    if args.json {
        print_json(&report)?;
    } else {
        print(&format!(
            "{}: {} frames of {} markers at {} Hz, {} raw -> {} ({:.1}:1), max error {:.4} mm\n",
            report.take.display(),
            thousands(report.frames),
            report.markers,
            report.rate_hz,
            bytes(report.raw_bytes),
            bytes(report.file_bytes),
            report.ratio,
            report.max_error_mm,
        ))?;
    }
    Ok(Outcome::of(report.frames_missing > 0))
}

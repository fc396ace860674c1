//! `export`: a take in a format that other tools open.

mod part;

use std::{
    io::{BufReader, BufWriter, Write},
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicU64},
    time::Duration,
};

use anyhow::Context;
use mocapd::{
    files::{self, NewFile},
    outcome::{Outcome, UsageError},
    units,
};
use mocapd_take::{
    TakeFrames,
    interchange::Format,
    motion::{FrameSource, MotionInfo},
};

use self::part::Part;
use super::{output::say, paths, progress::Progress};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The take
    take: PathBuf,
    /// The file to write, .c3d, .trc or .csv, or, where they are built in, .parquet or .mcap; it must not exist
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Leave out what is before this time: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    from: Option<Duration>,
    /// Leave out what is at or after this time
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    to: Option<Duration>,
    /// Of Parquet a row a frame, with three columns a marker, instead of a row a sample
    #[arg(long)]
    wide: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let format = match (paths::output_format(&args.output)?, args.wide) {
        (Format::Parquet, true) => Format::ParquetWide,
        (format, false) => format,
        (_, true) => {
            return Err(UsageError("--wide is for .parquet: leave it out".to_owned()).into());
        }
    };
    format.check_built()?;
    paths::check_output(&args.output)?;
    let reading = || format!("cannot read {}", args.take.display());
    let file = files::open(&args.take)?;
    let mut frames = TakeFrames::open(BufReader::new(file)).with_context(reading)?;
    let left_out = left_out(frames.info(), format);
    let counter = Arc::new(AtomicU64::new(0));
    let mut part = Part::new(&mut frames, args.from, args.to, Arc::clone(&counter))?;
    let progress = Progress::follow("exporting", &counter, part.info().n_frames);
    write(&mut part, format, &args.output)?;
    drop(progress);
    if !left_out.is_empty() {
        let output = args.output.display();
        say(&format!("{output} cannot hold, and so has not: {}", left_out.join(", ")));
    }
    for problem in frames.problems() {
        say(&format!("{}: {problem}", args.take.display()));
    }
    Ok(Outcome::of(!frames.problems().is_empty()))
}

/// Writes a whole file under its own name, or none.
pub(super) fn write(
    frames: &mut dyn FrameSource,
    format: Format,
    path: &Path,
) -> anyhow::Result<()> {
    let mut output = NewFile::create(path)?;
    let mut out = BufWriter::new(&mut output);
    let writing = || format!("cannot write {}", path.display());
    format.write(frames, &mut out).with_context(writing)?;
    out.flush().with_context(writing)?;
    drop(out);
    output.keep()
}

/// What an importer kept and only another format takes back (docs/foreign.md).
fn left_out(info: &MotionInfo, format: Format) -> Vec<String> {
    let prefix = match format {
        Format::C3d => "c3d/",
        Format::Trc => "trc/",
        Format::Tsv | Format::Csv | Format::Parquet | Format::ParquetWide | Format::Mcap => {
            return info.foreign.iter().map(|p| p.kind.clone()).collect();
        }
    };
    let others = info.foreign.iter().filter(|part| !part.kind.starts_with(prefix));
    others.map(|part| part.kind.clone()).collect()
}

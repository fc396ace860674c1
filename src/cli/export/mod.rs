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
use mocapd_take::{TakeFrames, interchange::Format, motion::FrameSource};

use self::part::Part;
use super::{output::say, paths, progress::Progress};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The take
    take: PathBuf,
    /// The file to write, .c3d, .trc, .tsv (QTM) or .csv, or, where they are built in, .parquet or .mcap; it must not
    /// exist
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Rows of a CSV file: `wide`, one a frame; `long`, one a sample that is present
    #[arg(long, value_name = "LAYOUT", default_value = "wide")]
    layout: Layout,
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

/// How a CSV file is laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Layout {
    Wide,
    Long,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let format = format(args)?;
    format.check_built()?;
    paths::check_output(&args.output)?;
    let reading = || format!("cannot read {}", args.take.display());
    let file = files::open(&args.take)?;
    let mut frames = TakeFrames::open(BufReader::new(file)).with_context(reading)?;
    let counter = Arc::new(AtomicU64::new(0));
    let mut part = Part::new(&mut frames, args.from, args.to, Arc::clone(&counter))?;
    let left_out = format.leaves_out(part.info());
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

/// The format by the output's ending and what was said beside it.
fn format(args: &Args) -> anyhow::Result<Format> {
    let found = paths::output_format(&args.output)?;
    if args.wide {
        return match found {
            Format::Parquet => Ok(Format::ParquetWide),
            _ => Err(UsageError("--wide is for .parquet: leave it out".to_owned()).into()),
        };
    }
    match (found, args.layout) {
        (Format::Csv, Layout::Long) => Ok(Format::CsvLong),
        (format, Layout::Wide) => Ok(format),
        (_, Layout::Long) => {
            Err(UsageError("--layout long is for .csv: other formats have one layout".to_owned())
                .into())
        }
    }
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

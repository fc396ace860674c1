//! `export`: a take in a format that other tools open.

mod format;
mod part;
mod spreadsheet;

use std::{
    io::{BufReader, BufWriter, Write},
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicU64},
    time::Duration,
};

use anyhow::Context;
use mocapd::{
    ahead::Ahead,
    outcome::{Outcome, UsageError},
};
use mocapd_acquire::{
    files::{self, NewFile, NewFolder, SparseFile},
    threads,
};
use mocapd_service::units;
use mocapd_take::{
    TakeFrames, TakeMap,
    interchange::{Direction, Format, Turned, bids, npz},
    motion::{FrameSource, UpAxis},
    record::Ledger,
};

use self::{format::FormatArgs, part::Part, spreadsheet::Guarded};
use super::{output::Progress, output::say, paths, values::count};

/// What is written at once: so much that the calls into the system cost nothing beside the bytes.
const BUFFER_BYTES: usize = 1 << 20;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The take
    take: PathBuf,
    /// What to write: a file, .c3d, .trc, .tsv (QTM), .csv, .npz, .xdf or, where they are built in, .parquet or .mcap,
    /// or with `--format bids` a folder; it must not exist
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    format: FormatArgs,
    /// Turn the take by a quarter so that this axis points up: x, y or z
    #[arg(long, value_name = "AXIS", value_parser = axis)]
    up: Option<UpAxis>,
    /// Leave out what is before this time: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    from: Option<Duration>,
    /// Leave out what is at or after this time
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    to: Option<Duration>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let format = args.format.of(&args.output)?;
    format.check_built()?;
    paths::check_output(&args.output)?;
    let reading = || format!("cannot read {}", args.take.display());
    let file = SparseFile::open(&args.take)?;
    let wanted = |kind: &str| format.gives_back(kind);
    let mut frames = TakeFrames::open_with(BufReader::new(file), wanted, files::scratch)
        .with_context(reading)?;
    let range =
        part::range(frames.info(), frames.map().n_held.unwrap_or_default(), args.from, args.to)
            .with_context(|| args.take.display().to_string())?;
    if args.up.is_some() && frames.info().up == UpAxis::Unknown {
        return Err(UsageError(format!(
            "{} does not say what is up, so that --up cannot turn it: import its file again with --up",
            args.take.display()
        ))
        .into());
    }
    let mut ahead = Ahead::start(&args.take, &frames, range.start, threads::default_workers())?;
    let mut left_out = Vec::new();
    let mut not_turned = Vec::new();
    let mut export = |source: &mut dyn FrameSource| {
        let counter = Arc::new(AtomicU64::new(0));
        let mut part = Part::new(source, &range, Arc::clone(&counter));
        left_out = format.leaves_out(part.info(), args.up.is_some());
        let _progress = Progress::follow("exporting", &counter, part.info().n_frames);
        let mut turned;
        let frames: &mut dyn FrameSource = match args.up {
            None => &mut part,
            Some(up) => {
                turned = Turned::new(&mut part, up)?.context("the take does not say what is up")?;
                not_turned = turned.not_turned();
                &mut turned
            }
        };
        if format == Format::Bids {
            write_folder(frames, &args.format.names(&args.take)?, &args.output)
        } else if args.format.is_for_spreadsheet() {
            write(&mut Guarded::new(frames), format, &args.output)
        } else {
            write(frames, format, &args.output)
        }
    };
    let done = match &mut ahead {
        None => false,
        Some(ahead) => match export(ahead) {
            // What is missing of a take with a flaw is known to the reader that goes through it frame by frame. Nothing
            // of the first try is left.
            Err(_) if ahead.has_flaw() => false,
            tried => {
                tried?;
                true
            }
        },
    };
    if !done {
        frames.seek(range.start)?;
        export(&mut frames)?;
    }
    if !left_out.is_empty() {
        let output = args.output.display();
        say(&format!("{output} cannot hold, and so has not: {}", left_out.join(", ")));
    }
    not_turned.retain(|_| format == Format::C3d);
    if !not_turned.is_empty() {
        say(&format!("{}: not turned: {}", args.output.display(), not_turned.join(", ")));
    }
    say_lost(args, frames.map());
    let problems = frames.problems();
    for problem in problems {
        say(&format!("{}: {problem}", args.take.display()));
    }
    Ok(Outcome::of(!problems.is_empty()))
}

/// Says how many frames the take lost while it was recorded.
fn say_lost(args: &Args, take: &TakeMap) {
    let n_lost = take.ledger.as_ref().map_or(0, Ledger::frames_lost);
    if n_lost > 0 {
        // No other program can tell them from markers that were hidden.
        say(&format!(
            "{}: {} of the take were lost while it was recorded; those within {} are gaps there, as hidden markers are",
            args.take.display(),
            count(n_lost, "frame"),
            args.output.display()
        ));
    }
}

/// An axis that is to point up.
fn axis(text: &str) -> Result<UpAxis, String> {
    let direction: Direction = text.parse()?;
    if direction.is_negative() {
        return Err(format!("'{text}' points down: use x, y or z"));
    }
    Ok(direction.axis())
}

/// Writes a whole file under its own name, or none.
pub(super) fn write(
    frames: &mut dyn FrameSource,
    format: Format,
    path: &Path,
) -> anyhow::Result<()> {
    let mut output = NewFile::create(path)?;
    let mut out = BufWriter::with_capacity(BUFFER_BYTES, &mut output);
    let writing = || format!("cannot write {}", path.display());
    let written = match format {
        Format::Npz => npz::write(frames, &mut out),
        _ => format.write(frames, &mut out),
    };
    written.with_context(writing)?;
    out.flush().with_context(writing)?;
    drop(out);
    output.keep()
}

/// Writes a whole folder under its own name, or none.
fn write_folder(
    frames: &mut dyn FrameSource,
    names: &bids::Names,
    path: &Path,
) -> anyhow::Result<()> {
    let mut output = NewFolder::create(path)?;
    let writing = || format!("cannot write {}", path.display());
    bids::write(frames, names, &mut output).with_context(writing)?;
    output.keep()
}

//! `diff`: shows how two takes differ, or a take and a motion file.

mod report;

use std::{
    io::BufReader,
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicU64},
};

use anyhow::{Context, bail};
use mocapd::outcome::{DataLostError, Outcome, UsageError};
use mocapd_acquire::files::{self, CountingFile, SparseFile};
use mocapd_take::{
    TakeFrames,
    compare::{ContentDifference, Difference, TimesDifference, compare, compare_times},
    motion::FrameSource,
};

use self::report::{DiffReport, MotionReport};
use super::{
    edited::open,
    motion_files::read_options,
    original::{MotionSource, open_motion},
    output::{Progress, notify, print, print_json},
    paths,
};

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Exit codes: 0 no difference, 1 different, 2 usage error, 3 a take is damaged or was cut off, so that \
    not all of it was compared"
)]
pub(crate) struct Args {
    /// A take
    a: PathBuf,
    /// Another take; or a .c3d, .trc, .tsv or .csv file, of which only the motion is compared
    b: PathBuf,
    /// Compare the motion only: markers, frames, gaps and samples
    #[arg(long)]
    motion: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// A take whose bytes are counted as they are read.
type Frames = TakeFrames<BufReader<CountingFile>>;

/// Times that each file is read: for its map, its frames and its times.
const PASSES: u64 = 3;

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    if !paths::is_take(&args.a) {
        let message = format!("{} is not a take: name a .take first", args.a.display());
        bail!(UsageError(message));
    }
    let is_motion_file = !paths::is_take(&args.b);
    if is_motion_file {
        paths::input_format(&args.b)?;
    }
    let report = if is_motion_file { of_motion_file(args)? } else { of_takes(args)? };
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.text())?;
        report.problems().for_each(notify);
    }
    let (a, b) = (args.a.display(), args.b.display());
    if !report.is_whole() {
        bail!(DataLostError(format!("{a} and {b} could not be compared as a whole")));
    } else if !report.is_equal() {
        bail!("{a} and {b} differ");
    }
    Ok(Outcome::Done)
}

/// Opens a take and reads the content of its foreign parts, if they are `wanted`.
fn open_frames(path: &Path, read: &Arc<AtomicU64>, wanted: bool) -> anyhow::Result<Frames> {
    let reading = || format!("cannot read {}", path.display());
    let input = open(path, read)?;
    TakeFrames::open_with(input, |_| wanted, files::scratch).with_context(reading)
}

fn len_bytes(path: &Path) -> anyhow::Result<u64> {
    Ok(SparseFile::open(path)?.len_bytes()?)
}

fn compare_motion(
    args: &Args,
    a: &mut Frames,
    b: &mut dyn FrameSource,
) -> anyhow::Result<(Difference, MotionReport)> {
    let markers = if b.info().markers.len() > a.info().markers.len() { b.info() } else { a.info() };
    let labels = markers.labels();
    let comparing = || format!("cannot compare {} with {}", args.a.display(), args.b.display());
    let difference = compare(a, b).with_context(comparing)?;
    let report = MotionReport::new(&difference, &labels);
    Ok((difference, report))
}

/// Compares a take with a motion file, which is read as it was for the import.
fn of_motion_file(args: &Args) -> anyhow::Result<DiffReport> {
    let read = Arc::default();
    // The times of rows are not read.
    let passes = PASSES - 1;
    let _progress =
        Progress::follow("comparing", &read, passes * (len_bytes(&args.a)? + len_bytes(&args.b)?));
    let mut a = open_frames(&args.a, &read, false)?;
    let source = MotionSource::file(&args.b)?;
    let mut b = open_motion(&source, &read_options(&a), false, &read)?;
    let (_, found) = compare_motion(args, &mut a, &mut b)?;
    Ok(DiffReport::new(args, found, None, a.problems().iter().map(|p| (&args.a, p))))
}

fn of_takes(args: &Args) -> anyhow::Result<DiffReport> {
    let read = Arc::default();
    let _progress =
        Progress::follow("comparing", &read, PASSES * (len_bytes(&args.a)? + len_bytes(&args.b)?));
    let mut a = open_frames(&args.a, &read, !args.motion)?;
    let mut b = open_frames(&args.b, &read, !args.motion)?;
    let content = (!args.motion).then(|| {
        let of = |frames: &Frames| (frames.map().clone(), frames.info().foreign.clone());
        let ((one, one_parts), (other, other_parts)) = (of(&a), of(&b));
        ContentDifference::between((&one, &one_parts), (&other, &other_parts))
    });
    let (_, found) = compare_motion(args, &mut a, &mut b)?;
    let content = match content {
        Some(content) => Some((content, times(args, &a, &b, &read)?)),
        None => None,
    };
    let problems = a.problems().iter().map(|problem| (&args.a, problem));
    let others = b.problems().iter().map(|problem| (&args.b, problem));
    Ok(DiffReport::new(args, found, content, problems.chain(others)))
}

/// Compares the times of two recordings; an import has none.
fn times(
    args: &Args,
    a: &Frames,
    b: &Frames,
    read: &Arc<AtomicU64>,
) -> anyhow::Result<Option<TimesDifference>> {
    if a.map().header.device.is_none() || b.map().header.device.is_none() {
        return Ok(None);
    }
    let inputs = (open(&args.a, read)?, open(&args.b, read)?);
    Ok(Some(compare_times((inputs.0, a.map()), (inputs.1, b.map()))?))
}

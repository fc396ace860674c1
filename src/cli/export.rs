//! `export`: a take in a format that other tools open.

use std::{
    io::{BufReader, BufWriter, Write},
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
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
    motion::{FrameSource, MotionInfo, Position},
};

use super::{import::format_of, output::say, progress::Progress};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The take
    take: PathBuf,
    /// The file to write, .c3d, .trc or .csv; it must not exist
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Leave out what is before this time
    #[arg(long, value_name = "TIME", value_parser = units::duration)]
    from: Option<Duration>,
    /// Leave out what is at or after this time
    #[arg(long, value_name = "TIME", value_parser = units::duration)]
    to: Option<Duration>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let format = format_of(&args.output)?;
    let reading = || format!("cannot read {}", args.take.display());
    let file = files::open(&args.take)?;
    let mut frames = TakeFrames::open(BufReader::new(file)).with_context(reading)?;
    let counter = Arc::new(AtomicU64::new(0));
    let mut part = Part::new(&mut frames, args.from, args.to, Arc::clone(&counter))?;
    let mut output = NewFile::create(&args.output)?;
    let progress = Progress::follow("exporting", &counter, part.end);
    let mut out = BufWriter::new(&mut output);
    let writing = || format!("cannot write {}", args.output.display());
    format.write(&mut part, &mut out).with_context(writing)?;
    out.flush().with_context(writing)?;
    drop(out);
    drop(progress);
    output.keep()?;
    for problem in frames.problems() {
        say(&format!("{}: {problem}", args.take.display()));
    }
    Ok(Outcome::of(!frames.problems().is_empty()))
}

/// The frames from one time to another.
struct Part<'a> {
    frames: &'a mut dyn FrameSource,
    info: MotionInfo,
    next: u64,
    end: u64,
    counter: Arc<AtomicU64>,
}

impl<'a> Part<'a> {
    fn new(
        frames: &'a mut dyn FrameSource,
        from: Option<Duration>,
        to: Option<Duration>,
        counter: Arc<AtomicU64>,
    ) -> anyhow::Result<Self> {
        let mut info = frames.info().clone();
        let frame_at = |time: Duration| (time.as_secs_f64() * info.rate_hz).ceil() as u64;
        let first = from.map_or(0, frame_at);
        let end = to.map_or(info.n_frames, frame_at).min(info.n_frames);
        if first >= end {
            let length_s = info.n_frames as f64 / info.rate_hz;
            let message = format!("no frames there: the take is {length_s:.3} s long");
            return Err(UsageError(message).into());
        }
        let mut row = vec![mocapd_take::motion::GAP; info.markers.len()];
        for _ in 0..first {
            frames.next_frame(&mut row)?;
        }
        if (first, end) != (0, info.n_frames) {
            // What an importer kept beside the markers belongs to the whole.
            info.foreign.clear();
            info.source.first_frame += first;
        }
        info.n_frames = end - first;
        Ok(Self { frames, info, next: first, end, counter })
    }
}

impl FrameSource for Part<'_> {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> std::io::Result<bool> {
        if self.next >= self.end {
            return Ok(false);
        }
        self.next += 1;
        self.counter.store(self.next, Ordering::Relaxed);
        self.frames.next_frame(row)
    }
}

//! A take as frames, decoded by several threads ahead of who reads them: what lies between two key stretches is decoded
//! by one thread.
//!
//! Only for takes without a flaw: whoever knows what a damaged one is missing is [`TakeFrames`]. One that turns up later
//! is an error, and [`Ahead::has_flaw`].

mod jobs;
mod lines;
#[cfg(test)]
mod tests;

use std::{
    fs::File,
    io::{self, Read, Seek, SeekFrom},
    path::Path,
};

use crossbeam_channel::{Receiver, bounded};
use mocapd_codec::Settings;
use mocapd_take::{
    TakeFrames, TakeMap, TakeReader,
    motion::{FrameSource, GAP, MotionInfo, Position},
};

use self::{
    jobs::{Job, Jobs, coded_max, read},
    lines::{Decoded, Rows, work},
};
use mocapd_acquire::{files, threads};

/// Most bytes that all threads may hold of what they decode.
const MEMORY_MAX: u64 = 128 << 20;

/// Bytes a sample of the stretch that a thread works on: position, flags, and what a decoder keeps beside them.
const SAMPLE_BYTES: u64 = 24;

/// Frames of a take in order.
#[derive(Debug)]
pub struct Ahead {
    info: MotionInfo,
    take: Option<TakeMap>,
    /// From each job, in order.
    decoded: Receiver<Receiver<Decoded>>,
    /// The one that is being read.
    job: Option<Receiver<Decoded>>,
    current: Rows,
    next_row: u64,
    ended: bool,
    has_flaw: bool,
}

impl Ahead {
    /// Starts threads for the take at `path`, which `frames` was opened of, from `first_row` on; `None` where that is better read by one:
    /// where it has a flaw, or where stretches are so long that there is memory for one of them only.
    ///
    /// # Errors
    /// When the file cannot be opened again, or the system refuses a thread.
    pub fn start<R: Read + Seek>(
        path: &Path,
        frames: &TakeFrames<R>,
        first_row: u64,
        n_threads: usize,
    ) -> anyhow::Result<Option<Self>> {
        let info = frames.info();
        let samples = frames.longest_stretch().saturating_mul(info.markers.len() as u64);
        let in_memory = MEMORY_MAX / samples.saturating_mul(SAMPLE_BYTES).max(1);
        let n_threads = (n_threads as u64).min(in_memory) as usize;
        if !frames.problems().is_empty() || n_threads < 2 || info.markers.is_empty() {
            return Ok(None);
        }
        let (offset, reader) = frames.reader_at(first_row)?;
        let mut file = files::open(path)?;
        file.seek(SeekFrom::Start(offset))?;
        let mut ahead = Self::with_threads(
            (file, reader),
            info.clone(),
            frames.codec()?,
            (n_threads, coded_max(samples)),
        )?;
        ahead.next_row = first_row;
        ahead.take = frames.take().cloned();
        Ok(Some(ahead))
    }

    fn with_threads(
        (file, reader): (File, TakeReader),
        info: MotionInfo,
        codec: Settings,
        (n_threads, n_coded): (usize, usize),
    ) -> anyhow::Result<Self> {
        // A job waits where every thread has one; and what came of jobs may wait for each thread.
        let (to_do, jobs) = bounded::<Job>(1);
        let (in_order, decoded) = bounded(n_threads);
        let n_markers = info.markers.len();
        for index in 0..n_threads {
            let jobs = jobs.clone();
            let work = move || work(codec, n_markers, &jobs);
            threads::spawn(&format!("mocapd-decode-{index}"), work)?;
        }
        let jobs = Jobs { to_do, in_order, n_coded };
        threads::spawn("mocapd-read", move || read(file, reader, &jobs))?;
        Ok(Self {
            info,
            take: None,
            decoded,
            job: None,
            current: Rows::default(),
            next_row: 0,
            ended: false,
            has_flaw: false,
        })
    }

    /// Whether something turned out to be missing: then what was read is not to be used.
    #[must_use]
    pub fn has_flaw(&self) -> bool {
        self.has_flaw
    }

    /// Takes rows until some of them come at or after the next, or there are no more.
    fn advance(&mut self) -> io::Result<()> {
        while !self.ended && self.current.end_row() <= self.next_row {
            if self.job.is_none() {
                self.job = self.decoded.recv().ok();
            }
            let decoded = self.job.as_ref().and_then(|job| job.recv().ok());
            match decoded.unwrap_or_else(|| Decoded::Failed(io::Error::other("a thread failed"))) {
                Decoded::Rows(rows) => self.current = rows,
                Decoded::Flaw => {
                    self.has_flaw = true;
                    return Err(io::Error::new(io::ErrorKind::InvalidData, "the take has a flaw"));
                }
                Decoded::Next => self.job = None,
                Decoded::End => self.ended = true,
                Decoded::Failed(error) => return Err(error),
            }
        }
        Ok(())
    }
}

impl FrameSource for Ahead {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        if self.next_row >= self.info.n_frames {
            return Ok(false);
        }
        self.advance()?;
        // Rows that were lost before the take was written are in no stretch.
        match self.current.row(self.next_row, row.len()) {
            Some(found) => row.copy_from_slice(found),
            None => row.fill(GAP),
        }
        self.next_row += 1;
        Ok(true)
    }

    fn take(&self) -> Option<&TakeMap> {
        self.take.as_ref()
    }
}

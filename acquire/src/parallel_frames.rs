//! Parallel decoding of a take: worker threads decode ranges between key stretches, and the frames come out in order.
//!
//! Only intact takes are decoded in parallel; [`TakeFrames`] reads damaged ones and accounts for what they lost. Damage
//! that shows up while decoding is an error and sets [`ParallelFrames::is_damaged`].

#[cfg(test)]
mod tests;

use std::{
    collections::VecDeque,
    fs::File,
    io::{self, Read, Seek},
    ops::Range,
    path::Path,
    vec,
};

use crossbeam_channel::{Receiver, Sender, bounded};
use mocapd_take::{
    TakeError, TakeFrames, TakeMap, TakeTraversal,
    motion::{FrameSource, GAP, MotionInfo, Position},
    traversal::Decode,
};

use crate::{files, threads};

/// Limit on the memory of all worker threads together, bytes.
const MEMORY_MAX: u64 = 128 << 20;

/// Memory per sample of the stretch that a thread decodes, bytes: position, flags and decoder state.
const SAMPLE_BYTES: u64 = 24;

/// Target size of a job, samples, where key stretches are close enough together: milliseconds of work, so that the
/// cost of starting a job is negligible and the first frames come soon.
const JOB_SAMPLES: u64 = 1 << 14;

/// Samples per batch of rows: 200 kB, which stay in the processor's cache while columns are transposed to rows.
const BATCH_SAMPLES: usize = 1 << 14;

/// Batches of one job that may be queued for the reader: 8 MB, unless a single row is larger than a batch, and enough
/// that no thread blocks while the reader drains the queue of another.
const BATCHES_QUEUED_MAX: usize = 40;

/// The frames of an intact take in order, decoded by several threads.
#[derive(Debug)]
pub struct ParallelFrames {
    info: MotionInfo,
    take: TakeMap,
    /// Row ranges that have not been queued yet.
    pieces: vec::IntoIter<Range<u64>>,
    jobs: Sender<Job>,
    /// The output of the queued jobs, in order of their rows.
    decoded: VecDeque<Receiver<Decoded>>,
    /// Limit on the number of queued jobs.
    queued_max: usize,
    current: Rows,
    next_row: u64,
    is_damaged: bool,
}

/// A range of rows for the next idle thread to decode, and where to send them.
struct Job {
    rows: Range<u64>,
    decoded: Sender<Decoded>,
}

/// The output of a job, one message after another.
enum Decoded {
    Rows(Rows),
    /// All rows of the job were sent.
    End,
    /// The take turned out to be damaged.
    Damaged,
    Failed(TakeError),
}

/// A batch of consecutive rows, row-major: `n_rows` times one position per marker.
#[derive(Debug, Default)]
struct Rows {
    first_row: u64,
    n_rows: u64,
    positions: Vec<Position>,
}

impl ParallelFrames {
    /// Starts threads that decode the take at `path` from `first_row` on; `frames` was opened from the same file.
    ///
    /// `None` if the take should be read by one thread: if it is damaged, or if its stretches are so long that only one
    /// of them fits into memory.
    ///
    /// # Errors
    /// When the file cannot be opened again, or the system refuses a thread.
    pub fn start<R: Read + Seek>(
        path: &Path,
        frames: &TakeFrames<R>,
        first_row: u64,
        n_threads: usize,
    ) -> anyhow::Result<Option<Self>> {
        let (take, n_markers) = (frames.map(), frames.info().markers.len() as u64);
        let n_samples = take.n_rows.saturating_sub(first_row).saturating_mul(n_markers);
        let n_pieces = (n_samples / JOB_SAMPLES).max(n_threads as u64);
        let pieces = take.pieces(&(first_row..take.n_rows), n_pieces as usize);
        let n_threads = threads_max(take, n_markers).min(n_threads);
        if !frames.problems().is_empty() || n_threads < 2 || n_markers == 0 {
            return Ok(None);
        }
        let n_threads = n_threads.min(pieces.len());
        Self::with_threads(path, frames, pieces, n_threads).map(Some)
    }

    fn with_threads<R: Read + Seek>(
        path: &Path,
        frames: &TakeFrames<R>,
        pieces: Vec<Range<u64>>,
        n_threads: usize,
    ) -> anyhow::Result<Self> {
        let (info, take) = (frames.info().clone(), frames.map().clone());
        // One job is being read, each thread works on one, and one waits.
        let queued_max = n_threads + 2;
        let (jobs, to_do) = bounded::<Job>(queued_max);
        let n_markers = info.markers.len();
        for index in 0..n_threads {
            let to_do = to_do.clone();
            let take = TakeTraversal::from_map(files::open(path)?, &take, Decode::All)?;
            let work = move || work(take, n_markers, &to_do);
            threads::spawn(&format!("mocapd-decode-{index}"), work)?;
        }
        Ok(Self {
            info,
            take,
            next_row: pieces.first().map_or(0, |rows| rows.start),
            pieces: pieces.into_iter(),
            jobs,
            decoded: VecDeque::with_capacity(queued_max),
            queued_max,
            current: Rows::default(),
            is_damaged: false,
        })
    }

    /// Whether the take turned out to be damaged; the frames read so far must then be discarded.
    #[must_use]
    pub fn is_damaged(&self) -> bool {
        self.is_damaged
    }

    /// Receives batches until one holds or follows the next row, or no batch is left.
    fn advance(&mut self) -> io::Result<()> {
        let failed = || io::Error::other("a decoder thread ended early");
        while self.current.end_row() <= self.next_row {
            while self.decoded.len() < self.queued_max
                && let Some(rows) = self.pieces.next()
            {
                let (to_reader, decoded) = bounded(BATCHES_QUEUED_MAX);
                let job = Job { rows, decoded: to_reader };
                self.jobs.send(job).map_err(|_| failed())?;
                self.decoded.push_back(decoded);
            }
            let Some(decoded) = self.decoded.front() else { return Ok(()) };
            match decoded.recv().map_err(|_| failed())? {
                Decoded::Rows(rows) => self.current = rows,
                Decoded::End => drop(self.decoded.pop_front()),
                Decoded::Damaged => {
                    self.is_damaged = true;
                    return Err(io::Error::new(io::ErrorKind::InvalidData, "the take is damaged"));
                }
                Decoded::Failed(error) => return Err(io::Error::other(error)),
            }
        }
        Ok(())
    }
}

impl FrameSource for ParallelFrames {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        if self.next_row >= self.info.n_frames {
            return Ok(false);
        }
        self.advance()?;
        // No stretch holds the rows that were lost before the take was written.
        match self.current.row(self.next_row, row.len()) {
            Some(found) => row.copy_from_slice(found),
            None => row.fill(GAP),
        }
        self.next_row += 1;
        Ok(true)
    }

    fn take(&self) -> Option<&TakeMap> {
        Some(&self.take)
    }
}

impl Rows {
    /// One past the last row.
    fn end_row(&self) -> u64 {
        self.first_row + self.n_rows
    }

    /// The positions of `row`, if this batch holds it.
    fn row(&self, row: u64, n_markers: usize) -> Option<&[Position]> {
        let index = usize::try_from(row.checked_sub(self.first_row)?).ok()?;
        let start = index.checked_mul(n_markers)?;
        if row < self.end_row() { self.positions.get(start..start + n_markers) } else { None }
    }
}

/// How many threads fit into [`MEMORY_MAX`] while each decodes a stretch of the largest size.
fn threads_max(take: &TakeMap, n_markers: u64) -> usize {
    let samples = take.longest_stretch.unwrap_or_default().saturating_mul(n_markers);
    (MEMORY_MAX / samples.saturating_mul(SAMPLE_BYTES).max(1)) as usize
}

/// Decodes one job after another, until the channel of jobs or that of the output is disconnected.
fn work(mut take: TakeTraversal<File>, n_markers: usize, jobs: &Receiver<Job>) {
    for Job { rows, decoded } in jobs {
        let read = take.read_rows(&rows, |take, range, offset| {
            // Checked before sending: rows behind a damaged chunk would look as if nothing were missing.
            let sent =
                take.is_intact() && send_rows(take, range, offset, n_markers, &decoded).is_some();
            if sent { Ok(()) } else { Err(io::Error::from(io::ErrorKind::BrokenPipe).into()) }
        });
        let last = match read {
            _ if !take.is_intact() => Decoded::Damaged,
            Ok(()) => Decoded::End,
            Err(error) => Decoded::Failed(error),
        };
        if decoded.send(last).is_err() {
            return;
        }
    }
}

/// Transposes the rows `range` of a stretch, the first of which is at `offset` in it, and sends them in batches; `None`
/// if the receiver is gone.
fn send_rows(
    take: &TakeTraversal<File>,
    range: Range<u64>,
    offset: usize,
    n_markers: usize,
    decoded: &Sender<Decoded>,
) -> Option<()> {
    let step = (BATCH_SAMPLES / n_markers.max(1)).max(1);
    for first_row in range.clone().step_by(step) {
        let n = (range.end - first_row).min(step as u64) as usize;
        let skipped = offset + (first_row - range.start) as usize;
        let mut positions = vec![GAP; n * n_markers];
        for (column, rows) in take.rows().take(n_markers).enumerate() {
            let Some(rows) = rows else { continue };
            let samples = rows.positions.iter().zip(&rows.present).skip(skipped).take(n);
            let places = positions.iter_mut().skip(column).step_by(n_markers);
            for (place, (&position, &present)) in places.zip(samples) {
                if present {
                    *place = position;
                }
            }
        }
        let rows = Rows { first_row, n_rows: n as u64, positions };
        decoded.send(Decoded::Rows(rows)).ok()?;
    }
    Some(())
}

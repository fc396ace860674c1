//! A take as frames, decoded by several threads ahead of who reads them: each decodes what lies between two key
//! stretches.
//!
//! Only for takes without a flaw: whoever knows what a damaged one is missing is [`TakeFrames`]. One that turns up later
//! is an error, and [`Ahead::has_flaw`].

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
use mocapd_acquire::{files, threads};
use mocapd_take::{
    TakeError, TakeFrames, TakeMap, TakeTraversal,
    motion::{FrameSource, GAP, MotionInfo, Position},
    traversal::Decode,
};

/// Most bytes that all threads may hold of what they decode.
const MEMORY_MAX: u64 = 128 << 20;

/// Bytes a sample of the stretch that a thread works on: position, flags, and what a decoder keeps beside them.
const SAMPLE_BYTES: u64 = 24;

/// Samples of a piece of the take, where keys are near enough: milliseconds of work, beside which it costs nothing to begin
/// one.
const PIECE_SAMPLES: u64 = 1 << 14;

/// Samples that are handed over at once: 200 kB, which stay in a processor's cache while their columns become rows.
const ROWS_SAMPLES: usize = 1 << 14;

/// Rows of a piece that wait to be read: so many that no thread waits while another's are read. They are 8 MB at most.
const WAITING_MAX: usize = 40;

/// Frames of a take in order.
#[derive(Debug)]
pub struct Ahead {
    info: MotionInfo,
    take: TakeMap,
    /// Those that no thread has yet.
    pieces: vec::IntoIter<Range<u64>>,
    jobs: Sender<Job>,
    /// What comes of the others, in order.
    decoded: VecDeque<Receiver<Decoded>>,
    /// Most of these.
    under_way_max: usize,
    current: Rows,
    next_row: u64,
    has_flaw: bool,
}

/// A piece for a thread, whichever is the next that has nothing to do.
struct Job {
    rows: Range<u64>,
    decoded: Sender<Decoded>,
}

/// What a thread gives of a piece.
enum Decoded {
    Rows(Rows),
    /// That was all.
    End,
    /// Something of the take is missing.
    Flaw,
    Failed(TakeError),
}

/// Successive rows, frame by frame.
#[derive(Debug, Default)]
struct Rows {
    first_row: u64,
    n_rows: u64,
    positions: Vec<Position>,
}

impl Ahead {
    /// Starts threads for the take at `path`, which `frames` was opened of, from `first_row` on; `None` where that is better
    /// read by one: where it has a flaw, or where stretches are so long that there is memory for one of them only.
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
        let n_pieces = (n_samples / PIECE_SAMPLES).max(n_threads as u64);
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
        // One is read, each thread has one, and one is next.
        let under_way_max = n_threads + 2;
        let (jobs, to_do) = bounded::<Job>(under_way_max);
        let n_markers = info.markers.len();
        for index in 0..n_threads {
            let to_do = to_do.clone();
            let take = TakeTraversal::of_map(files::open(path)?, &take, Decode::All)?;
            let work = move || work(take, n_markers, &to_do);
            threads::spawn(&format!("mocapd-decode-{index}"), work)?;
        }
        Ok(Self {
            info,
            take,
            next_row: pieces.first().map_or(0, |rows| rows.start),
            pieces: pieces.into_iter(),
            jobs,
            decoded: VecDeque::with_capacity(under_way_max),
            under_way_max,
            current: Rows::default(),
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
        let failed = || io::Error::other("a thread failed");
        while self.current.end_row() <= self.next_row {
            while self.decoded.len() < self.under_way_max
                && let Some(rows) = self.pieces.next()
            {
                let (to_reader, decoded) = bounded(WAITING_MAX);
                let job = Job { rows, decoded: to_reader };
                self.jobs.send(job).map_err(|_| failed())?;
                self.decoded.push_back(decoded);
            }
            let Some(decoded) = self.decoded.front() else { return Ok(()) };
            match decoded.recv().map_err(|_| failed())? {
                Decoded::Rows(rows) => self.current = rows,
                Decoded::End => drop(self.decoded.pop_front()),
                Decoded::Flaw => {
                    self.has_flaw = true;
                    return Err(io::Error::new(io::ErrorKind::InvalidData, "the take has a flaw"));
                }
                Decoded::Failed(error) => return Err(io::Error::other(error)),
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
        Some(&self.take)
    }
}

impl Rows {
    /// The row after the last.
    fn end_row(&self) -> u64 {
        self.first_row + self.n_rows
    }

    /// A row, if it is one of these.
    fn row(&self, row: u64, n_markers: usize) -> Option<&[Position]> {
        let index = usize::try_from(row.checked_sub(self.first_row)?).ok()?;
        let start = index.checked_mul(n_markers)?;
        if row < self.end_row() { self.positions.get(start..start + n_markers) } else { None }
    }
}

/// Threads for whose stretches there is memory.
fn threads_max(take: &TakeMap, n_markers: u64) -> usize {
    let samples = take.longest_stretch.unwrap_or_default().saturating_mul(n_markers);
    (MEMORY_MAX / samples.saturating_mul(SAMPLE_BYTES).max(1)) as usize
}

/// Does one job after another, until nobody wants them any more.
fn work(mut take: TakeTraversal<File>, n_markers: usize, jobs: &Receiver<Job>) {
    for Job { rows, decoded } in jobs {
        let read = take.read_rows(&rows, |take, held, offset| {
            // Before anything behind it is read as if nothing were missing.
            let sent =
                take.is_intact() && send_rows(take, held, offset, n_markers, &decoded).is_some();
            if sent { Ok(()) } else { Err(io::Error::from(io::ErrorKind::BrokenPipe).into()) }
        });
        let last = match read {
            _ if !take.is_intact() => Decoded::Flaw,
            Ok(()) => Decoded::End,
            Err(error) => Decoded::Failed(error),
        };
        if decoded.send(last).is_err() {
            return;
        }
    }
}

/// Sends rows of a stretch, of which they begin at `offset`, columns turned into rows; `None` when nobody wants them any
/// more.
fn send_rows(
    take: &TakeTraversal<File>,
    held: Range<u64>,
    offset: usize,
    n_markers: usize,
    decoded: &Sender<Decoded>,
) -> Option<()> {
    let step = (ROWS_SAMPLES / n_markers.max(1)).max(1);
    for first_row in held.clone().step_by(step) {
        let n = (held.end - first_row).min(step as u64) as usize;
        let skipped = offset + (first_row - held.start) as usize;
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

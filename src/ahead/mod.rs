//! A take as frames, decoded by several threads ahead of who reads them: what lies between two key stretches is decoded
//! by one thread, and the next by the next, in turn.
//!
//! Only for takes without a flaw: whoever knows what a damaged one is missing is [`TakeFrames`]. One that turns up later
//! is an error, and [`Ahead::has_flaw`].

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

use self::lines::{CODED_MAX, Coded, Decoded, PIECES_MAX, Rows, decode, read};
use crate::threads;

/// Most bytes that all threads may hold of what they decode.
const MEMORY_MAX: u64 = 128 << 20;

/// Bytes a sample of the stretch that a thread works on: position, flags, and what a decoder keeps beside them.
const SAMPLE_BYTES: u64 = 24;

/// Frames of a take in order.
#[derive(Debug)]
pub struct Ahead {
    info: MotionInfo,
    take: Option<TakeMap>,
    /// From each thread, in turn.
    decoded: Vec<Receiver<Decoded>>,
    turn: usize,
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
        let mut file = File::open(path)?;
        file.seek(SeekFrom::Start(offset))?;
        let mut ahead = Self::with_threads(file, reader, info.clone(), frames.codec()?, n_threads)?;
        ahead.next_row = first_row;
        ahead.take = frames.take().cloned();
        Ok(Some(ahead))
    }

    fn with_threads(
        file: File,
        reader: TakeReader,
        info: MotionInfo,
        codec: Settings,
        n_threads: usize,
    ) -> anyhow::Result<Self> {
        let (mut to_lines, mut from_lines) = (Vec::new(), Vec::new());
        for index in 0..n_threads {
            let (coded_in, coded) = bounded::<Coded>(CODED_MAX);
            let (decoded_in, decoded) = bounded::<Decoded>(PIECES_MAX);
            let n_markers = info.markers.len();
            threads::spawn(&format!("mocapd-decode-{index}"), move || {
                decode(codec, n_markers, &coded, &decoded_in);
            })?;
            to_lines.push(coded_in);
            from_lines.push(decoded);
        }
        threads::spawn("mocapd-read", move || read(file, reader, &to_lines))?;
        Ok(Self {
            info,
            take: None,
            decoded: from_lines,
            turn: 0,
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
            let decoded = self.decoded.get(self.turn).and_then(|line| line.recv().ok());
            match decoded.unwrap_or_else(|| Decoded::Failed(io::Error::other("a thread failed"))) {
                Decoded::Rows(rows) => self.current = rows,
                Decoded::Flaw => {
                    self.has_flaw = true;
                    return Err(io::Error::new(io::ErrorKind::InvalidData, "the take has a flaw"));
                }
                Decoded::Next => self.turn = (self.turn + 1) % self.decoded.len().max(1),
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

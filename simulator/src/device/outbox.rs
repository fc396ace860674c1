//! The device's bounded output queue of whole messages.

use std::collections::VecDeque;

use super::SentLog;

/// Smallest capacity, bytes: as much as a kernel pty holds.
const CAPACITY_MIN: usize = 64 << 10;

/// Largest capacity, bytes: 1.3 s of 200 markers at 1000 Hz (3.1 MB/s).
const CAPACITY_MAX: usize = 4 << 20;

/// Frames that always fit, regardless of their size.
const FRAMES_MIN: usize = 4;

impl Queued {
    /// A frame, or another message.
    pub(crate) fn frame_if(is_frame: bool) -> Self {
        if is_frame { Self::Frame } else { Self::Other }
    }
}

/// A queue of bytes that counts a frame as sent once the line has taken all of it.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    bytes: Vec<u8>,
    head: usize,
    capacity: usize,
    /// Bytes ever queued.
    queued: u64,
    /// Where each waiting frame ends, in bytes ever queued.
    frame_ends: VecDeque<u64>,
    frames_sent: u64,
    frames_discarded: u64,
    /// The same of batches of samples.
    batch_ends: VecDeque<u64>,
    batches_discarded: u64,
}

/// What is queued.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Queued {
    Frame,
    Batch,
    Other,
}

impl Outbox {
    /// Sets the capacity to `size` bytes, or to one second of frames and of `samples_bytes_per_s`, between 64 KiB and
    /// 4 MiB.
    pub(crate) fn resize(
        &mut self,
        frame_bytes: usize,
        rate_millihertz: u32,
        samples_bytes_per_s: u64,
        size: Option<usize>,
    ) {
        let frames = frame_bytes as u64 * u64::from(rate_millihertz) / 1000;
        let second = frames.saturating_add(samples_bytes_per_s);
        let second = usize::try_from(second).unwrap_or(CAPACITY_MAX);
        let capacity = size.unwrap_or(second.clamp(CAPACITY_MIN, CAPACITY_MAX));
        self.capacity = capacity.max(FRAMES_MIN * frame_bytes);
    }

    pub(crate) fn has_room(&self, bytes: usize) -> bool {
        self.pending().len() + bytes <= self.capacity
    }

    /// Queues the bytes that `write` appends.
    pub(crate) fn put(&mut self, what: Queued, write: impl FnOnce(&mut Vec<u8>)) {
        let start = self.bytes.len();
        write(&mut self.bytes);
        self.queued += (self.bytes.len() - start) as u64;
        if self.bytes.len() > start {
            match what {
                Queued::Frame => self.frame_ends.push_back(self.queued),
                Queued::Batch => self.batch_ends.push_back(self.queued),
                Queued::Other => {}
            }
        }
    }

    pub(crate) fn pending(&self) -> &[u8] {
        self.bytes.get(self.head..).unwrap_or_default()
    }

    /// The line took the first `n` bytes.
    pub(crate) fn sent(&mut self, n: usize) {
        self.head = (self.head + n).min(self.bytes.len());
        let sent = self.bytes_sent();
        while self.frame_ends.pop_front_if(|end| *end <= sent).is_some() {
            self.frames_sent += 1;
        }
        while self.batch_ends.pop_front_if(|end| *end <= sent).is_some() {}
        if self.head == self.bytes.len() {
            self.bytes.clear();
            self.head = 0;
        } else if self.head > self.bytes.len() / 2 {
            // Amortised: moves at most as many bytes as were sent since the last move.
            self.bytes.drain(..self.head);
            self.head = 0;
        }
    }

    /// Discards the bytes that the line has not taken. A message that it took in part stays incomplete on the line.
    pub(crate) fn discard(&mut self) {
        self.queued = self.bytes_sent();
        self.frames_discarded += self.frames_waiting();
        self.batches_discarded += self.batch_ends.len() as u64;
        self.frame_ends.clear();
        self.batch_ends.clear();
        self.bytes.clear();
        self.head = 0;
    }

    /// Fills in the queue's counters of a log: frames sent, waiting and discarded, and bytes sent.
    pub(crate) fn complete_log(&self, log: &SentLog) -> SentLog {
        SentLog {
            frames_sent: self.frames_sent,
            frames_waiting: self.frames_waiting(),
            frames_discarded: self.frames_discarded,
            batches_discarded: self.batches_discarded,
            bytes_sent: self.bytes_sent(),
            ..log.clone()
        }
    }

    fn bytes_sent(&self) -> u64 {
        self.queued - self.pending().len() as u64
    }

    fn frames_waiting(&self) -> u64 {
        self.frame_ends.len() as u64
    }
}

//! Where other threads leave word for the reader: boundaries between takes, and marks.
//!
//! The reader looks here with every frame and every read: two loads when there is nothing.

use std::sync::{
    Arc, Weak,
    atomic::{AtomicU64, Ordering},
};

use crossbeam_channel::{Receiver, Sender, bounded};
use mocapd_take::record::Event;

/// Marks that wait for the reader, which looks every 20 ms: more is a client that hammers, and is told so.
const MARKS_MAX: usize = 16;

/// A mark, and where its row is told.
#[derive(Debug)]
pub(super) struct MarkOrder {
    pub(super) event: Event,
    pub(super) row: Sender<u64>,
    /// Gone when whoever asked has given up: then it is no mark.
    pub(super) asked: Weak<()>,
}

/// The outer side.
#[derive(Debug, Clone)]
pub(super) struct Desk {
    /// The last boundary wanted, as [`Boundary::word`] has it.
    boundary: Arc<AtomicU64>,
    marks: Sender<MarkOrder>,
}

/// The reader's side.
#[derive(Debug)]
pub(super) struct DeskIn {
    boundary: Arc<AtomicU64>,
    done: u64,
    marks: Receiver<MarkOrder>,
}

/// A boundary that is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Boundary {
    pub(super) number: u64,
    /// Whether a take is being written after it: key stretches may be rarer then.
    pub(super) recording: bool,
    /// Whether a take begins there: then it waits for a device that is away, whose absence is none of the take's.
    pub(super) begins: bool,
}

impl Boundary {
    fn word(self) -> u64 {
        (self.number << 2) | (u64::from(self.begins) << 1) | u64::from(self.recording)
    }
}

pub(super) fn desk() -> (Desk, DeskIn) {
    let (marks, marks_out) = bounded(MARKS_MAX);
    let boundary = Arc::new(AtomicU64::new(0));
    let desk = Desk { boundary: Arc::clone(&boundary), marks };
    (desk, DeskIn { boundary, done: 0, marks: marks_out })
}

impl Desk {
    /// The stretch that is open ends now, and the next one is a key.
    pub(super) fn want(&self, boundary: Boundary) {
        self.boundary.store(boundary.word(), Ordering::Release);
    }

    /// `false` when too many wait.
    pub(super) fn mark(&self, mark: MarkOrder) -> bool {
        self.marks.try_send(mark).is_ok()
    }
}

impl DeskIn {
    pub(super) fn boundary(&mut self) -> Option<Boundary> {
        let word = self.boundary.load(Ordering::Acquire);
        if word == self.done {
            return None;
        }
        self.done = word;
        Some(Boundary { number: word >> 2, begins: word & 2 != 0, recording: word & 1 != 0 })
    }

    /// The next mark that somebody still waits for.
    pub(super) fn mark(&self) -> Option<MarkOrder> {
        self.marks.try_iter().find(|mark| mark.asked.strong_count() > 0)
    }
}

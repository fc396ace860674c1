//! The fate of every frame on a line with faults: the ground truth for tests of recordings.
//!
//! A frame is whole when the bytes between two 0x00 on the line are exactly its own, regardless of damage before and
//! after it.

use std::collections::{BTreeMap, VecDeque};
use std::hash::{DefaultHasher, Hash, Hasher};

use mocapd_drivers::link::WIRE_BYTES_MAX;

use super::{Kind, Kinds};
use crate::device::{Fate, FaultTotals, Sent, SentFate};

/// Maximum number of entries for frames whose fate is open: 18 minutes at 240 Hz, 25 MB. Only a device that stalls for
/// longer has more. By then its queue drops every new frame, and consecutive drops share one entry and one line of the
/// log.
const ENTRIES_MAX: usize = 1 << 18;

#[derive(Debug)]
struct Entry<T> {
    /// Number of the first frame, counted from 0 since the device was made.
    number: u64,
    /// Consecutive frames in this entry.
    frames: u64,
    /// The first frame.
    frame: T,
    fate: Option<Fate>,
    again: u32,
    faults: Kinds,
    /// Hash of the encoded frame without its terminating 0x00.
    content_hash: u64,
    /// The fate stays open until the line has taken this many bytes in all; `u64::MAX` until the frame is queued.
    open_until: u64,
}

/// Follows every frame, or every batch, from the device to the line, and records its fate.
#[derive(Debug)]
pub(super) struct FateTracker<T> {
    /// Frames whose fate is open.
    entries: VecDeque<Entry<T>>,
    /// Frames that the device produced.
    n_produced: u64,
    /// The number of the next frame that the device hands over.
    next: u64,
    /// By series, the highest number of a frame that went over the line whole.
    last_whole: BTreeMap<u8, u64>,
    /// Bytes that the line took since the last 0x00.
    segment: Vec<u8>,
    queued_bytes: u64,
    taken_bytes: u64,
    /// `taken_bytes` at the last 0x00: everything before it is final.
    decided_bytes: u64,
    unasked: bool,
    closed: Vec<SentFate<T>>,
    keeps_frames: bool,
    totals: FaultTotals,
}

impl<T> Default for FateTracker<T> {
    fn default() -> Self {
        Self {
            entries: VecDeque::default(),
            n_produced: 0,
            next: 0,
            last_whole: BTreeMap::new(),
            segment: Vec::new(),
            queued_bytes: 0,
            taken_bytes: 0,
            decided_bytes: 0,
            unasked: false,
            closed: Vec::new(),
            keeps_frames: false,
            totals: FaultTotals::default(),
        }
    }
}

impl<T: Sent> FateTracker<T> {
    pub(super) fn keep_frames(&mut self) {
        self.keeps_frames = true;
    }

    pub(super) fn take_frames(&mut self) -> Vec<SentFate<T>> {
        std::mem::take(&mut self.closed)
    }

    pub(super) fn totals(&self) -> FaultTotals {
        self.totals.clone()
    }

    /// Registers a frame that the device produced.
    pub(super) fn produced(&mut self, frame: T) {
        let fate = frame.is_dropped().then_some(Fate::Dropped);
        let open_until = if frame.is_dropped() { 0 } else { u64::MAX };
        let number = self.n_produced;
        self.n_produced += 1;
        if self.entries.len() >= ENTRIES_MAX
            && frame.is_dropped()
            && let Some(last) = self.entries.back_mut()
            && (last.fate, last.frame.run()) == (Some(Fate::Dropped), frame.run())
        {
            last.frames += 1;
            return;
        }
        let (again, faults, content_hash, frames) = (0, Kinds::default(), 0, 1);
        let entry = Entry { number, frames, frame, fate, again, faults, content_hash, open_until };
        self.entries.push_back(entry);
    }

    /// Matches an encoded frame with the next one that the device did not drop; returns its number and the frame.
    pub(super) fn handed_over(&mut self, message: &[u8]) -> Option<(u64, T)> {
        loop {
            let number = self.next;
            let entry = self.entry(number)?;
            let (frame, frames) = (entry.frame, entry.frames);
            let dropped = entry.fate.is_some();
            entry.content_hash = hash(message.strip_suffix(&[0]).unwrap_or(message));
            self.next += frames;
            if !dropped {
                return Some((number, frame));
            }
        }
    }

    /// Records that the device discarded its next `n` queued frames.
    pub(super) fn discarded(&mut self, n: u64) {
        for _ in 0..n {
            if let Some(entry) = self.handed_over(&[]).and_then(|(number, _)| self.entry(number)) {
                (entry.fate, entry.open_until) = (Some(Fate::Discarded), 0);
            }
        }
        self.close_decided();
    }

    /// Records that faults touched a frame.
    pub(super) fn touch(&mut self, number: u64, faults: Kinds) {
        if let Some(entry) = self.entry(number) {
            entry.faults.add(faults);
        }
    }

    /// Records that a fault of this kind lost the frame.
    pub(super) fn lost(&mut self, number: u64, kind: Kind) {
        if let Some(entry) = self.entry(number) {
            (entry.fate, entry.open_until) = (Some(Fate::Lost), 0);
            entry.faults.add(Kinds::of(kind));
        }
    }

    /// Queues `bytes` for the line; `number` is the frame that they belong to, if any.
    pub(super) fn queued(&mut self, bytes: usize, number: Option<u64>) {
        self.queued_bytes += bytes as u64;
        let until = self.queued_bytes;
        if let Some(entry) = number.and_then(|number| self.entry(number)) {
            entry.open_until = until;
        }
    }

    /// Accounts for bytes that the line took.
    pub(super) fn taken(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.taken_bytes += 1;
            if byte != 0 {
                // A segment longer than the longest message cannot be a frame.
                if self.segment.len() <= WIRE_BYTES_MAX {
                    self.segment.push(byte);
                }
                continue;
            }
            self.decided_bytes = self.taken_bytes;
            if !self.segment.is_empty() {
                let content_hash = hash(&self.segment);
                self.segment.clear();
                self.arrived(content_hash);
            }
        }
        self.close_decided();
    }

    fn arrived(&mut self, content_hash: u64) {
        let next = self.next;
        let mut handed_over = self.entries.iter_mut().take_while(|entry| entry.number < next);
        let Some(entry) = handed_over.find(|entry| {
            entry.content_hash == content_hash
                && !matches!(entry.fate, Some(Fate::Dropped | Fate::Discarded | Fate::Lost))
        }) else {
            return;
        };
        if entry.fate.is_some() {
            entry.again += 1;
            return;
        }
        let number = entry.number;
        let last = self.last_whole.entry(entry.frame.series()).or_insert(number);
        let late = *last > number;
        *last = number.max(*last);
        entry.fate = Some(match (self.unasked, late) {
            (true, _) => Fate::Unasked,
            (_, true) => Fate::Late,
            _ => Fate::Whole,
        });
    }

    /// Records that everything queued for the line is lost: the cable is pulled, or the device has lost its power.
    pub(super) fn cut(&mut self, kind: Kind) {
        let next = self.next;
        for entry in self.entries.iter_mut().take_while(|entry| entry.number < next) {
            if entry.fate.is_none() {
                entry.faults.add(Kinds::of(kind));
                entry.open_until = 0;
            }
        }
        self.segment.clear();
        self.queued_bytes = self.taken_bytes;
        self.decided_bytes = self.taken_bytes;
        self.close_decided();
    }

    /// Sets whether frames that arrive from now on are unasked: sent without a request by a host.
    pub(super) fn set_unasked(&mut self, unasked: bool) {
        self.unasked = unasked;
    }

    /// Settles every open fate: nothing goes over the line any more.
    pub(super) fn close(&mut self) {
        for entry in &mut self.entries {
            if entry.open_until > self.taken_bytes {
                entry.fate = entry.fate.or(Some(Fate::Waiting));
            }
            entry.open_until = 0;
        }
        self.close_decided();
    }

    fn entry(&mut self, number: u64) -> Option<&mut Entry<T>> {
        let place = self.entries.partition_point(|entry| entry.number < number);
        self.entries.get_mut(place).filter(|entry| entry.number == number)
    }

    fn close_decided(&mut self) {
        while let Some(entry) = self.entries.pop_front_if(|e| e.open_until <= self.decided_bytes) {
            let Entry { number, frames, frame, fate, again, faults, .. } = entry;
            let fate = fate.unwrap_or(Fate::Damaged);
            let fate = SentFate { frame, frames, fate, again, faults };
            self.next = self.next.max(number + frames);
            self.totals.add(&fate);
            if self.keeps_frames {
                self.closed.push(fate);
            }
        }
    }
}

fn hash(bytes: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    bytes.hash(&mut hasher);
    hasher.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::SentFrame;

    fn frame(seq: u32, dropped: bool) -> SentFrame {
        SentFrame {
            run: 1,
            seq,
            device_ticks: 10 * u64::from(seq),
            present: 3,
            dropped,
            unasked: false,
            host_ns: 10_000 * u64::from(seq),
        }
    }

    /// A device that stalls for a day: its queue still goes out whole, and memory for the dropped frames is bounded.
    #[test]
    fn a_stall_of_a_day_is_accounted_for_in_bounded_memory() {
        let mut tracker = FateTracker::default();
        tracker.keep_frames();
        let day = 20_736_000;
        let waiting = 500;
        for seq in 0..day {
            tracker.produced(frame(seq, (waiting..day - 10).contains(&seq)));
            assert!(tracker.entries.len() <= ENTRIES_MAX + 10);
        }
        // Then it resumes, with the queued frames and the new ones.
        let mut numbers = Vec::new();
        for seq in (0..waiting).chain(day - 10..day) {
            let message = format!("{seq}\0").into_bytes();
            let (number, found) = tracker.handed_over(&message).unwrap();
            assert_eq!(found.seq, seq);
            numbers.push(number);
            tracker.queued(message.len(), Some(number));
            tracker.taken(&message);
        }
        let expected: Vec<u64> = (0..waiting).chain(day - 10..day).map(u64::from).collect();
        assert_eq!(numbers, expected, "faults depend on a frame's number");
        tracker.close();
        let totals = tracker.totals();
        assert_eq!(totals.of(Fate::Whole), u64::from(waiting + 10));
        assert_eq!(totals.of(Fate::Damaged), 0);
        assert_eq!(totals.of(Fate::Dropped), u64::from(day - 10 - waiting));
        // Every frame is in the log exactly once.
        let mut next = 0;
        for fate in tracker.take_frames() {
            assert_eq!(fate.frame, frame(next, fate.fate == Fate::Dropped));
            next += fate.frames as u32;
        }
        assert_eq!(next, day);
    }
}

//! What became of every frame on a damaged line: the truth that recordings are held against.
//!
//! A frame is whole when the bytes between two 0x00 on the line are its own, whatever happened around it.

use std::collections::VecDeque;
use std::hash::{DefaultHasher, Hash, Hasher};

use mocapd_drivers::link::WIRE_BYTES_MAX;

use super::kinds::{Kind, Kinds};
use crate::device::{Fate, FaultTotals, FrameFate, SentFrame};

/// Entries of frames whose fate is open: 18 minutes at 240 Hz, and 25 MB. Only a device that stalls for longer has more,
/// and all but those in its queue are dropped by then: of these, the ones in a row share an entry, and a line of the log.
const ENTRIES_MAX: usize = 1 << 18;

#[derive(Debug)]
struct Entry {
    /// Its number, and of how many in a row.
    number: u64,
    frames: u64,
    /// The first of them.
    frame: SentFrame,
    fate: Option<Fate>,
    again: u32,
    faults: Kinds,
    /// Of what is between its 0x00 and the one before.
    content: u64,
    /// Up to which byte of the line its fate is open; `u64::MAX` before it was put there.
    open_until: u64,
}

/// Frames whose fate is open, and the bytes since the last 0x00.
#[derive(Debug, Default)]
pub(super) struct Account {
    entries: VecDeque<Entry>,
    /// Frames that the device made.
    made: u64,
    /// The number of the next frame that the device hands over.
    next: u64,
    /// The last one that went whole.
    last_whole: Option<u64>,
    segment: Vec<u8>,
    put_bytes: u64,
    taken_bytes: u64,
    /// What was taken up to the last 0x00: no more bytes join what stands before it.
    decided_bytes: u64,
    unasked: bool,
    closed: Vec<FrameFate>,
    keeps_frames: bool,
    totals: FaultTotals,
}

impl Account {
    pub(super) fn keep_frames(&mut self) {
        self.keeps_frames = true;
    }

    pub(super) fn take_frames(&mut self) -> Vec<FrameFate> {
        std::mem::take(&mut self.closed)
    }

    pub(super) fn totals(&self) -> FaultTotals {
        self.totals.clone()
    }

    /// The device made a frame.
    pub(super) fn produced(&mut self, frame: SentFrame) {
        let fate = frame.dropped.then_some(Fate::Dropped);
        let open_until = if frame.dropped { 0 } else { u64::MAX };
        let number = self.made;
        self.made += 1;
        if self.entries.len() >= ENTRIES_MAX
            && frame.dropped
            && let Some(last) = self.entries.back_mut()
            && (last.fate, last.frame.run) == (Some(Fate::Dropped), frame.run)
        {
            last.frames += 1;
            return;
        }
        let (again, faults, content, frames) = (0, Kinds::default(), 0, 1);
        let entry = Entry { number, frames, frame, fate, again, faults, content, open_until };
        self.entries.push_back(entry);
    }

    /// The device hands over the next frame that it did not drop: its number here, and itself.
    pub(super) fn handed_over(&mut self, message: &[u8]) -> Option<(u64, SentFrame)> {
        loop {
            let number = self.next;
            let entry = self.entry(number)?;
            let (frame, frames) = (entry.frame, entry.frames);
            let dropped = entry.fate.is_some();
            entry.content = hash(message.strip_suffix(&[0]).unwrap_or(message));
            self.next += frames;
            if !dropped {
                return Some((number, frame));
            }
        }
    }

    /// So many frames waited in the device, and will not leave it.
    pub(super) fn discarded(&mut self, n: u64) {
        for _ in 0..n {
            if let Some((number, _)) = self.handed_over(&[])
                && let Some(entry) = self.entry(number)
            {
                (entry.fate, entry.open_until) = (Some(Fate::Discarded), 0);
            }
        }
        self.close_decided();
    }

    /// A fault touched a frame.
    pub(super) fn touch(&mut self, number: u64, faults: Kinds) {
        if let Some(entry) = self.entry(number) {
            entry.faults.add(faults);
        }
    }

    /// A frame is left out.
    pub(super) fn lost(&mut self, number: u64, kind: Kind) {
        if let Some(entry) = self.entry(number) {
            (entry.fate, entry.open_until) = (Some(Fate::Lost), 0);
            entry.faults.add(Kinds::of(kind));
        }
    }

    /// So many bytes go to the line, for this frame where it is one.
    pub(super) fn put(&mut self, bytes: usize, number: Option<u64>) {
        self.put_bytes += bytes as u64;
        let until = self.put_bytes;
        if let Some(entry) = number.and_then(|number| self.entry(number)) {
            entry.open_until = until;
        }
    }

    /// The line took these.
    pub(super) fn taken(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.taken_bytes += 1;
            if byte != 0 {
                // What is longer than a message is none.
                if self.segment.len() <= WIRE_BYTES_MAX {
                    self.segment.push(byte);
                }
                continue;
            }
            self.decided_bytes = self.taken_bytes;
            if !self.segment.is_empty() {
                let content = hash(&self.segment);
                self.segment.clear();
                self.arrived(content);
            }
        }
        self.close_decided();
    }

    fn arrived(&mut self, content: u64) {
        let next = self.next;
        let mut handed_over = self.entries.iter_mut().take_while(|entry| entry.number < next);
        let Some(entry) = handed_over.find(|entry| {
            entry.content == content
                && !matches!(entry.fate, Some(Fate::Dropped | Fate::Discarded | Fate::Lost))
        }) else {
            return;
        };
        if entry.fate.is_some() {
            entry.again += 1;
            return;
        }
        let number = entry.number;
        let late = self.last_whole.is_some_and(|last| last > number);
        entry.fate = Some(match (self.unasked, late) {
            (true, _) => Fate::Unasked,
            (_, true) => Fate::Late,
            _ => Fate::Whole,
        });
        self.last_whole = self.last_whole.max(Some(number));
    }

    /// What is on its way to the line does not get there: it is pulled out, or the device is dead.
    pub(super) fn cut(&mut self, kind: Kind) {
        let next = self.next;
        for entry in self.entries.iter_mut().take_while(|entry| entry.number < next) {
            if entry.fate.is_none() {
                entry.faults.add(Kinds::of(kind));
                entry.open_until = 0;
            }
        }
        self.segment.clear();
        self.put_bytes = self.taken_bytes;
        self.decided_bytes = self.taken_bytes;
        self.close_decided();
    }

    /// Frames that arrive from now on were asked for by nobody, or were again.
    pub(super) fn set_unasked(&mut self, unasked: bool) {
        self.unasked = unasked;
    }

    /// Nothing goes over the line any more.
    pub(super) fn close(&mut self) {
        for entry in &mut self.entries {
            if entry.open_until > self.taken_bytes {
                entry.fate = entry.fate.or(Some(Fate::Waiting));
            }
            entry.open_until = 0;
        }
        self.close_decided();
    }

    fn entry(&mut self, number: u64) -> Option<&mut Entry> {
        let place = self.entries.partition_point(|entry| entry.number < number);
        self.entries.get_mut(place).filter(|entry| entry.number == number)
    }

    fn close_decided(&mut self) {
        while let Some(entry) = self.entries.front().filter(|e| e.open_until <= self.decided_bytes)
        {
            let Entry { number, frames, frame, fate, again, faults, .. } = *entry;
            let fate = fate.unwrap_or(Fate::Damaged);
            let fate = FrameFate { frame, frames, fate, again, faults };
            self.next = self.next.max(number + frames);
            self.totals.add(&fate);
            if self.keeps_frames {
                self.closed.push(fate);
            }
            self.entries.pop_front();
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

    /// A device that stalls for a day: what its queue holds goes whole after all, and the memory for the rest is bounded.
    #[test]
    fn a_stall_of_a_day_is_accounted_for_in_bounded_memory() {
        let mut account = Account::default();
        account.keep_frames();
        let day = 20_736_000;
        let waiting = 500;
        for seq in 0..day {
            account.produced(frame(seq, (waiting..day - 10).contains(&seq)));
            assert!(account.entries.len() <= ENTRIES_MAX + 10);
        }
        // Then it goes on, with what waited and what it makes.
        let mut numbers = Vec::new();
        for seq in (0..waiting).chain(day - 10..day) {
            let message = format!("{seq}\0").into_bytes();
            let (number, found) = account.handed_over(&message).unwrap();
            assert_eq!(found.seq, seq);
            numbers.push(number);
            account.put(message.len(), Some(number));
            account.taken(&message);
        }
        let expected: Vec<u64> = (0..waiting).chain(day - 10..day).map(u64::from).collect();
        assert_eq!(numbers, expected, "what hits a frame is a function of its number");
        account.close();
        let totals = account.totals();
        assert_eq!(totals.of(Fate::Whole), u64::from(waiting + 10));
        assert_eq!(totals.of(Fate::Damaged), 0);
        assert_eq!(totals.of(Fate::Dropped), u64::from(day - 10 - waiting));
        // Every frame stands in the log, once.
        let mut next = 0;
        for fate in account.take_frames() {
            assert_eq!(fate.frame, frame(next, fate.fate == Fate::Dropped));
            next += fate.frames as u32;
        }
        assert_eq!(next, day);
    }
}

//! What waits for a client: messages in order, of which those of frames and of batches of samples may be dropped.

use std::collections::VecDeque;

/// Bytes of frames and batches that wait for a client that does not read. Beyond it the oldest are dropped whole. 200 markers as
/// spheres at 1000 Hz are 22 MB/s, so that this is a fifth of a second of the most that can be sent, and more than a second of
/// 64 markers at 240 Hz.
const DROPPABLE_BYTES_MAX: usize = 4 << 20;

/// Entries that wait, which bounds the memory of short ones: sixteen seconds of frames at 1000 Hz.
const ENTRIES_MAX: usize = 1 << 14;

/// Bytes of replies and announcements that wait, which cannot be dropped: the schemas of a hundred groups of sampled channels. A
/// client that does not read them is disconnected.
const OTHER_BYTES_MAX: usize = 2 << 20;

/// Their number, so that short ones leave room for frames.
const OTHER_ENTRIES_MAX: usize = 1 << 12;

/// What messages are of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum EntryKind {
    /// A frame.
    Frame,
    /// A batch of samples.
    Batch,
    /// Replies, announcements and log entries, which are not dropped.
    Other,
}

/// Messages that are sent, or dropped, together.
#[derive(Debug)]
struct QueuedEntry {
    bytes: Vec<u8>,
    kind: EntryKind,
}

/// Numbers of frames, and of batches of samples.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct MissedCounts {
    pub(super) frames: u64,
    pub(super) batches: u64,
}

impl MissedCounts {
    pub(super) fn add(&mut self, other: Self) {
        self.frames += other.frames;
        self.batches += other.batches;
    }

    fn count(&mut self, kind: EntryKind) {
        self.frames += u64::from(kind == EntryKind::Frame);
        self.batches += u64::from(kind == EntryKind::Batch);
    }
}

/// The messages that wait for a client.
#[derive(Debug, Default)]
pub(super) struct Outbox {
    entries: VecDeque<QueuedEntry>,
    /// Bytes of the first entry that were sent.
    sent: usize,
    droppable_bytes: usize,
    other_bytes: usize,
    other_entries: usize,
    frames_sent: u64,
}

impl Outbox {
    /// Appends messages that are not dropped. Returns `false` if too many wait.
    pub(super) fn put(&mut self, bytes: Vec<u8>) -> bool {
        if self.other_bytes + bytes.len() > OTHER_BYTES_MAX
            || self.other_entries >= OTHER_ENTRIES_MAX
        {
            return false;
        }
        if !bytes.is_empty() {
            self.other_bytes += bytes.len();
            self.other_entries += 1;
            self.entries.push_back(QueuedEntry { bytes, kind: EntryKind::Other });
        }
        true
    }

    /// Appends the messages of a frame or batch. Returns what was dropped for them, the oldest first.
    pub(super) fn put_droppable(&mut self, bytes: Vec<u8>, kind: EntryKind) -> MissedCounts {
        let mut dropped = MissedCounts::default();
        while self.droppable_bytes + bytes.len() > DROPPABLE_BYTES_MAX
            || self.entries.len() >= ENTRIES_MAX
        {
            let Some(oldest) = self.drop_oldest() else {
                dropped.count(kind);
                return dropped;
            };
            dropped.count(oldest);
        }
        self.droppable_bytes += bytes.len();
        self.entries.push_back(QueuedEntry { bytes, kind });
        dropped
    }

    /// Drops the oldest frame or batch of which nothing was sent. Returns which there was.
    fn drop_oldest(&mut self) -> Option<EntryKind> {
        let begun = usize::from(self.sent > 0);
        let mut waiting = self.entries.iter().skip(begun);
        let oldest = waiting.position(|entry| entry.kind != EntryKind::Other)?;
        let entry = self.entries.remove(begun + oldest)?;
        self.droppable_bytes -= entry.bytes.len();
        Some(entry.kind)
    }

    /// The bytes to send next: the rest of the first entry.
    pub(super) fn next(&self) -> &[u8] {
        self.entries.front().and_then(|entry| entry.bytes.get(self.sent..)).unwrap_or_default()
    }

    /// The connection took the first `n` of them.
    pub(super) fn sent(&mut self, n: usize) {
        self.sent += n.min(self.next().len());
        if self.entries.front().is_some_and(|entry| entry.bytes.len() == self.sent) {
            self.sent = 0;
            if let Some(entry) = self.entries.pop_front() {
                self.frames_sent += u64::from(entry.kind == EntryKind::Frame);
                match entry.kind {
                    EntryKind::Frame | EntryKind::Batch => {
                        self.droppable_bytes -= entry.bytes.len();
                    }
                    EntryKind::Other => {
                        self.other_bytes -= entry.bytes.len();
                        self.other_entries -= 1;
                    }
                }
            }
        }
    }

    /// Drops all frames and batches of which nothing was sent. Returns their numbers.
    pub(super) fn drop_all_droppable(&mut self) -> MissedCounts {
        let mut dropped = MissedCounts::default();
        while let Some(oldest) = self.drop_oldest() {
            dropped.count(oldest);
        }
        dropped
    }

    /// Drops everything; what the connection took a part of has no end then. Returns the frames and batches that were waiting.
    pub(super) fn clear(&mut self) -> MissedCounts {
        let mut dropped = MissedCounts::default();
        self.entries.iter().for_each(|entry| dropped.count(entry.kind));
        *self = Self { frames_sent: self.frames_sent, ..Self::default() };
        dropped
    }

    /// Whether what a client requests is to wait until it has read its replies.
    pub(super) fn is_full(&self) -> bool {
        // Half is left for what it did not request.
        self.other_bytes > OTHER_BYTES_MAX / 2 || self.other_entries > OTHER_ENTRIES_MAX / 2
    }

    /// Frames that the connection took whole.
    pub(super) fn frames_sent(&self) -> u64 {
        self.frames_sent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(frames: u64, batches: u64) -> MissedCounts {
        MissedCounts { frames, batches }
    }

    #[test]
    fn only_whole_frames_and_batches_are_dropped_and_the_oldest_first() {
        let mut outbox = Outbox::default();
        assert!(outbox.put(b"reply".to_vec()));
        let quarter = DROPPABLE_BYTES_MAX / 4;
        for number in 0..4 {
            let kind = if number == 1 { EntryKind::Batch } else { EntryKind::Frame };
            assert_eq!(outbox.put_droppable(vec![number; quarter], kind), counts(0, 0));
        }
        outbox.sent(5);
        outbox.sent(1);
        let put =
            |outbox: &mut Outbox, n: usize| outbox.put_droppable(vec![9; n], EntryKind::Frame);
        assert_eq!(put(&mut outbox, quarter), counts(0, 1), "the second; the first was begun");
        outbox.sent(quarter - 1);
        assert_eq!((outbox.next()[0], outbox.frames_sent()), (2, 1));
        assert_eq!(put(&mut outbox, DROPPABLE_BYTES_MAX + 1), counts(4, 0), "one that never fits");
        assert_eq!(outbox.next(), b"");
        assert_eq!(put(&mut outbox, DROPPABLE_BYTES_MAX), counts(0, 0));
        assert_eq!(outbox.clear(), counts(1, 0));
        assert_eq!(outbox.next(), b"");
    }

    #[test]
    fn short_frames_are_bounded_by_their_number() {
        let mut outbox = Outbox::default();
        let mut dropped = MissedCounts::default();
        for _ in 0..ENTRIES_MAX + 10 {
            dropped.add(outbox.put_droppable(vec![1], EntryKind::Frame));
        }
        assert_eq!(dropped, counts(10, 0));
    }

    #[test]
    fn replies_that_are_not_read_are_bounded() {
        let mut outbox = Outbox::default();
        let n = (0..).take_while(|_| outbox.put(vec![1; 1000])).count();
        assert_eq!(n, OTHER_BYTES_MAX / 1000);
        assert!(outbox.is_full());
        outbox.sent(1000);
        assert!(outbox.put(vec![1; 1000]));
    }
}

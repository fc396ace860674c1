//! What waits for a client of a server: packets in order, of which frames may be dropped.

use std::{collections::VecDeque, sync::Arc};

/// Bytes that wait for a client that does not read: a second of 200 markers at 1000 Hz. Beyond it frames are dropped whole
/// (of a recorder the oldest ones, else the newest), and its commands wait.
const BYTES_MAX: usize = 4 << 20;

/// Packets that wait, which bounds the memory of short ones: sixteen seconds of frames at 1000 Hz.
const PACKETS_MAX: usize = 1 << 14;

/// A packet that waits. All clients of the same components share the bytes of a frame.
#[derive(Debug)]
struct WaitingPacket {
    bytes: Arc<[u8]>,
    is_frame: bool,
}

/// The packets that wait for a client.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    packets: VecDeque<WaitingPacket>,
    /// Bytes of the first packet that were sent.
    sent: usize,
    /// Bytes of all packets, less those.
    waiting: usize,
    /// Bytes ever queued.
    queued: u64,
    frames_waiting: usize,
    frames_sent: u64,
}

impl Outbox {
    pub(crate) fn put(&mut self, write: impl FnOnce(&mut Vec<u8>)) {
        let mut bytes = Vec::new();
        write(&mut bytes);
        self.push(bytes.into(), false);
    }

    pub(crate) fn put_frame(&mut self, bytes: Arc<[u8]>) {
        self.push(bytes, true);
    }

    fn push(&mut self, bytes: Arc<[u8]>, is_frame: bool) {
        self.waiting += bytes.len();
        self.queued += bytes.len() as u64;
        self.frames_waiting += usize::from(is_frame);
        self.packets.push_back(WaitingPacket { bytes, is_frame });
    }

    /// Drops the oldest frame of which nothing was sent. Returns whether there was one.
    pub(crate) fn drop_oldest_frame(&mut self) -> bool {
        let begun = usize::from(self.sent > 0);
        let oldest = self.packets.iter().skip(begun).position(|packet| packet.is_frame);
        let Some(packet) = oldest.and_then(|at| self.packets.remove(begun + at)) else {
            return false;
        };
        self.waiting -= packet.bytes.len();
        self.frames_waiting -= 1;
        true
    }

    /// Drops everything.
    pub(crate) fn clear(&mut self) {
        self.packets.clear();
        (self.sent, self.waiting, self.frames_waiting) = (0, 0, 0);
    }

    /// The bytes to send next: the rest of the first packet.
    pub(crate) fn next(&self) -> &[u8] {
        self.packets.front().and_then(|packet| packet.bytes.get(self.sent..)).unwrap_or_default()
    }

    /// The connection took the first `n` of them.
    pub(crate) fn sent(&mut self, n: usize) {
        let n = n.min(self.next().len());
        self.sent += n;
        self.waiting -= n;
        if self.packets.front().is_some_and(|packet| packet.bytes.len() == self.sent) {
            self.sent = 0;
            if self.packets.pop_front().is_some_and(|packet| packet.is_frame) {
                self.frames_waiting -= 1;
                self.frames_sent += 1;
            }
        }
    }

    /// Whether nothing may be added that the client did not ask for.
    pub(crate) fn is_full(&self) -> bool {
        !self.has_room_for(1)
    }

    /// Whether a packet of so many bytes may wait.
    pub(crate) fn has_room_for(&self, bytes: usize) -> bool {
        self.waiting + bytes <= BYTES_MAX && self.packets.len() < PACKETS_MAX
    }

    /// Whether a part of a frame was sent.
    pub(crate) fn has_begun_frame(&self) -> bool {
        self.sent > 0 && self.packets.front().is_some_and(|packet| packet.is_frame)
    }

    /// Bytes that wait.
    pub(crate) fn waiting(&self) -> usize {
        self.waiting
    }

    pub(crate) fn frames_waiting(&self) -> usize {
        self.frames_waiting
    }

    /// Frames that the connection took whole.
    pub(crate) fn frames_sent(&self) -> u64 {
        self.frames_sent
    }

    /// Bytes ever queued.
    pub(crate) fn queued(&self) -> u64 {
        self.queued
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_whole_frames_are_dropped_and_the_oldest_first() {
        let mut outbox = Outbox::default();
        outbox.put(|out| out.extend_from_slice(b"reply"));
        for frame in ["one", "two", "three"] {
            outbox.put_frame(frame.as_bytes().into());
        }
        outbox.sent(5);
        outbox.sent(1);
        assert_eq!(outbox.next(), b"ne", "the first frame was begun");
        assert!(outbox.drop_oldest_frame());
        outbox.sent(2);
        assert_eq!((outbox.next(), outbox.waiting()), (&b"three"[..], 5));
        assert_eq!((outbox.frames_waiting(), outbox.frames_sent()), (1, 1));
        assert!(outbox.drop_oldest_frame());
        assert!(!outbox.drop_oldest_frame());
        assert_eq!((outbox.next(), outbox.waiting(), outbox.queued()), (&b""[..], 0, 16));
    }
}

//! Faults on the wire: messages in, damaged bytes out.
//!
//! A frame's damage is a function of the script and the frame's number; other messages are numbered separately, so the
//! timing of pings does not change what happens to frames. The one exception: a damaged 0x00 joins its message to the
//! one that follows.

use std::sync::Arc;

use mocapd_drivers::device::{DeviceEvent, Protocol};
use mocapd_drivers::link::HostLink;

use super::fates::FateTracker;
use super::script::Script;
use super::source::stream;
use super::{Fault, Kind, Kinds};
use crate::device::{FaultCounts, Sent, SentBatch, SentFrame};

/// With this many damaged bytes waiting for the line, no more are taken from the device: as many as a kernel pty holds.
const OUT_BYTES_MAX: usize = 64 << 10;

/// Maximum number of copies of one frame; each copy has its own stream of random numbers.
const COPIES_MAX: u64 = 4;

/// First random stream of messages that are not frames: above the streams of all frames.
const OTHER_STREAMS: u64 = 1 << 40;

/// First number of batches of samples in random streams: above those of all frames and other messages.
const BATCHES: u64 = 1 << 41;

/// A numbered message: faults depend on its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Numbered {
    Frame(u64),
    /// With its series.
    Batch(u64, u8),
}

impl Numbered {
    /// Its number among the random streams.
    fn index(self) -> u64 {
        match self {
            Self::Frame(number) => number,
            Self::Batch(number, _) => BATCHES + number,
        }
    }

    fn is_like(self, other: Self) -> bool {
        match (self, other) {
            (Self::Frame(_), Self::Frame(_)) => true,
            (Self::Batch(_, series), Self::Batch(_, of_other)) => series == of_other,
            _ => false,
        }
    }

    /// The number of a message before it, of the same kind.
    fn back(self, by: u64) -> u64 {
        match self {
            Self::Frame(number) => number.saturating_sub(by),
            Self::Batch(number, _) => BATCHES + number.saturating_sub(by),
        }
    }
}

/// Appends the damaged form of a byte; the second argument selects the bit to damage.
type Damage = fn(u8, usize, &mut Vec<u8>);

/// A frame or batch that is held back.
#[derive(Debug)]
struct LateFrame {
    /// How many of its kind, or of its series, go before it.
    frames_left: u32,
    number: Numbered,
    bytes: Vec<u8>,
}

/// The faults of a script that act on encoded messages.
#[derive(Debug)]
pub(super) struct WireFaults {
    script: Arc<Script>,
    pub(super) fates: FateTracker<SentFrame>,
    pub(super) batches: FateTracker<SentBatch>,
    /// A decoder of the undamaged messages, to distinguish the kinds of messages.
    reader: HostLink,
    late: Vec<LateFrame>,
    /// Bytes for the line.
    pub(super) out: Vec<u8>,
    n_others: u64,
    n_hellos: u64,
    /// Time of the last frame since the first Start, which is also used for messages without a time of their own.
    since_ns: Option<u64>,
    /// Kinds that destroyed the 0x00 of the last message, which now runs into the next one.
    unterminated: Kinds,
    scratch: Vec<u8>,
    /// Counts that cannot be derived from the frames' fates.
    pub(super) counts: FaultCounts,
}

/// The kinds of messages that faults distinguish.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum MessageKind {
    Frame,
    Batch,
    Hello,
    End,
    Other,
}

impl WireFaults {
    pub(super) fn new(script: Arc<Script>) -> Self {
        Self {
            script,
            fates: FateTracker::default(),
            batches: FateTracker::default(),
            reader: HostLink::new(),
            late: Vec::new(),
            out: Vec::new(),
            n_others: 0,
            n_hellos: 0,
            since_ns: None,
            unterminated: Kinds::default(),
            scratch: Vec::new(),
            counts: FaultCounts::default(),
        }
    }

    pub(super) fn has_room(&self) -> bool {
        self.out.len() < OUT_BYTES_MAX
    }

    /// Whether no message is left to send.
    pub(super) fn is_empty(&self) -> bool {
        self.out.is_empty() && self.late.is_empty()
    }

    /// The line took the first `n` bytes.
    pub(super) fn sent(&mut self, n: usize) {
        let n = n.min(self.out.len());
        let taken = self.out.get(..n).unwrap_or_default();
        self.fates.taken(taken);
        self.batches.taken(taken);
        self.out.drain(..n);
    }

    /// Discards everything in flight, because of a fault of this kind.
    pub(super) fn cut(&mut self, kind: Kind) {
        self.out.clear();
        self.late.clear();
        self.unterminated = Kinds::default();
        self.fates.cut(kind);
        self.batches.cut(kind);
    }

    /// Sets whether messages that arrive from now on are unasked.
    pub(super) fn set_unasked(&mut self, unasked: bool) {
        self.fates.set_unasked(unasked);
        self.batches.set_unasked(unasked);
    }

    /// Settles every open fate.
    pub(super) fn close(&mut self) {
        self.fates.close();
        self.batches.close();
    }

    fn touch(&mut self, number: Numbered, faults: Kinds) {
        match number {
            Numbered::Frame(number) => self.fates.touch(number, faults),
            Numbered::Batch(number, _) => self.batches.touch(number, faults),
        }
    }

    /// Queues bytes for the line in both trackers.
    fn queued(&mut self, bytes: usize, number: Option<Numbered>) {
        let frame = if let Some(Numbered::Frame(number)) = number { Some(number) } else { None };
        let batch = if let Some(Numbered::Batch(number, _)) = number { Some(number) } else { None };
        self.fates.queued(bytes, frame);
        self.batches.queued(bytes, batch);
    }

    /// Takes one message of the device, with its 0x00. `since` converts the time at which it was due to that since the
    /// first Start, nanoseconds.
    pub(super) fn message(&mut self, bytes: &[u8], since: impl FnOnce(u64) -> u64) {
        let mut message = MessageKind::Other;
        self.reader.push(bytes, &mut |event| {
            message = match event {
                DeviceEvent::Frame(_) => MessageKind::Frame,
                DeviceEvent::Samples(_) | DeviceEvent::Poses(_) | DeviceEvent::EndOfPoses(_) => {
                    MessageKind::Batch
                }
                DeviceEvent::Hello(_) => MessageKind::Hello,
                DeviceEvent::EndOfStream(_) => MessageKind::End,
                _ => MessageKind::Other,
            };
        });
        match message {
            MessageKind::Frame => {
                if let Some((number, frame)) = self.fates.handed_over(bytes) {
                    self.since_ns = Some(since(frame.host_ns()));
                    self.numbered(Numbered::Frame(number), bytes);
                    return;
                }
            }
            MessageKind::Batch => {
                if let Some((number, batch)) = self.batches.handed_over(bytes) {
                    self.since_ns = Some(since(batch.host_ns()));
                    self.numbered(Numbered::Batch(number, batch.series()), bytes);
                    return;
                }
            }
            MessageKind::Hello => self.garbage(),
            // No frame follows the last one, so late frames are sent now.
            MessageKind::End => self.release(None, u32::MAX),
            MessageKind::Other => {}
        }
        self.n_others += 1;
        self.put(bytes, OTHER_STREAMS + self.n_others, None);
    }

    fn numbered(&mut self, number: Numbered, bytes: &[u8]) {
        let since_ns = self.since_ns.unwrap_or(0);
        let script = Arc::clone(&self.script);
        let mut copies = 1;
        let mut late = None;
        for (index, scheduled) in script.active(since_ns) {
            let hits = |number, rate| stream(&script, index, number).unit() < rate;
            match scheduled.fault {
                Fault::LostFrames { rate, run }
                    if (number.back(run - 1)..=number.index()).any(|n| hits(n, rate)) =>
                {
                    match number {
                        Numbered::Frame(number) => self.fates.lost(number, Kind::LostFrames),
                        Numbered::Batch(number, _) => self.batches.lost(number, Kind::LostFrames),
                    }
                    copies = 0;
                }
                Fault::DoubledFrames { rate } if hits(number.index(), rate) => {
                    copies *= 2;
                    self.counts.add(Kind::DoubledFrames, u64::from(copies > 0));
                }
                Fault::Bursts { .. } => self.counts.add(Kind::Bursts, 1),
                Fault::LateFrames { rate, by } if hits(number.index(), rate) => late = Some(by),
                _ => {}
            }
        }
        let copies = copies.min(COPIES_MAX);
        match late {
            Some(frames_left) if copies > 0 => {
                self.touch(number, Kinds::of(Kind::LateFrames));
                // One more than it is late by, because the release below counts this frame itself.
                let frames_left = frames_left + 1;
                self.late.push(LateFrame { frames_left, number, bytes: bytes.to_vec() });
            }
            _ => {
                for copy in 0..copies {
                    self.put(bytes, number.index() * COPIES_MAX + copy, Some(number));
                }
            }
        }
        self.release(Some(number), 1);
    }

    /// Counts `frames` as passed, of the kind of `like` or of all, and sends the late ones that are due.
    fn release(&mut self, like: Option<Numbered>, frames: u32) {
        let is_like = |late: &LateFrame| like.is_none_or(|like| like.is_like(late.number));
        for late in self.late.iter_mut().filter(|late| is_like(late)) {
            late.frames_left = late.frames_left.saturating_sub(frames);
        }
        while let Some(due) = self.late.iter().position(|frame| frame.frames_left == 0) {
            let LateFrame { number, bytes, .. } = self.late.remove(due);
            self.put(&bytes, number.index() * COPIES_MAX, Some(number));
        }
    }

    fn garbage(&mut self) {
        self.n_hellos += 1;
        let script = Arc::clone(&self.script);
        for (index, scheduled) in script.faults.iter().enumerate() {
            match scheduled.fault {
                Fault::Garbage { bytes, times } if self.n_hellos <= times => {
                    let mut rng = stream(&script, index, self.n_hellos);
                    let garbage: Vec<u8> = (0..bytes).map(|_| rng.next_u64() as u8).collect();
                    self.queued(garbage.len(), None);
                    self.counts.add(Kind::Garbage, 1);
                    self.out.extend(garbage);
                }
                _ => {}
            }
        }
    }

    /// Damages a message as the script says, and queues it for the line.
    fn put(&mut self, bytes: &[u8], stream_index: u64, number: Option<Numbered>) {
        let mut touched = std::mem::take(&mut self.unterminated);
        let script = Arc::clone(&self.script);
        let mut now = std::mem::take(&mut self.scratch);
        now.clear();
        now.extend_from_slice(bytes);
        // Windowed faults hit nothing before the first frame.
        let since_ns = self.since_ns.unwrap_or(u64::MAX);
        for (index, scheduled) in script.active(since_ns) {
            let (rate, damage): (f64, Damage) = match scheduled.fault {
                Fault::BitFlips { rate } => (rate, |byte, bit, out| out.push(byte ^ 1 << bit)),
                Fault::DroppedBytes { rate } => (rate, |_, _, _| {}),
                Fault::DoubledBytes { rate } => (rate, |byte, _, out| out.extend([byte; 2])),
                _ => continue,
            };
            let mut rng = stream(&script, index, stream_index);
            let before = std::mem::take(&mut now);
            for byte in before {
                if rng.unit() < rate {
                    damage(byte, rng.below(8), &mut now);
                    touched.add(Kinds::of(scheduled.fault.kind()));
                } else {
                    now.push(byte);
                }
            }
        }
        if now.last() != Some(&0) {
            // Its terminator is gone: it runs into the next message.
            self.unterminated = touched;
        }
        if let Some(number) = number {
            self.touch(number, touched);
        }
        self.queued(now.len(), number);
        self.out.extend_from_slice(&now);
        self.scratch = now;
    }
}

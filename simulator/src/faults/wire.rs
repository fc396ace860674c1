//! What goes wrong with bytes on their way: messages in, damaged bytes out.
//!
//! A frame's damage is a function of the script and of its number, and that of other messages of theirs: pings come when
//! the host likes, and do not change what happens to frames. Only a 0x00 that is hit joins a message to whichever comes
//! behind it.

use std::sync::Arc;

use mocapd_drivers::device::{DeviceEvent, Protocol};
use mocapd_drivers::link::HostLink;

use super::account::Account;
use super::kinds::{Fault, Kind, Kinds};
use super::script::Script;
use super::source::stream;
use crate::device::{Parts, SentFrame};

/// Damaged bytes that wait for the line before no more are asked of the device: a pty of the kernel holds as many.
const OUT_BYTES_MAX: usize = 64 << 10;

/// Copies of a frame have streams of random numbers of their own.
const COPIES: u64 = 4;

/// What is no frame has its streams behind those of all frames.
const OTHERS: u64 = 1 << 40;

/// What becomes of a byte that is hit, and of a bit of it.
type Damage = fn(u8, usize, &mut Vec<u8>);

/// A message that is held back.
#[derive(Debug)]
struct Held {
    /// How many frames go first.
    frames_left: u32,
    number: u64,
    bytes: Vec<u8>,
}

/// The line, as far as it damages what it carries.
#[derive(Debug)]
pub(super) struct Wire {
    script: Arc<Script>,
    pub(super) account: Account,
    /// A host without faults: it tells what a message is.
    reader: HostLink,
    late: Vec<Held>,
    /// What the line should carry next.
    pub(super) out: Vec<u8>,
    others: u64,
    greetings: u64,
    /// The time of the last frame since the first Start: what is no frame has none of its own.
    since_ns: Option<u64>,
    /// The faults that hit the 0x00 before the next message.
    spoilt: Kinds,
    scratch: Vec<u8>,
    /// Beside those that frames were touched by.
    pub(super) parts: Parts,
}

/// What a message is, as far as it matters here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Message {
    Frame,
    Hello,
    End,
    Other,
}

impl Wire {
    pub(super) fn new(script: Arc<Script>) -> Self {
        Self {
            script,
            account: Account::default(),
            reader: HostLink::new(),
            late: Vec::new(),
            out: Vec::new(),
            others: 0,
            greetings: 0,
            since_ns: None,
            spoilt: Kinds::default(),
            scratch: Vec::new(),
            parts: Parts::default(),
        }
    }

    pub(super) fn has_room(&self) -> bool {
        self.out.len() < OUT_BYTES_MAX
    }

    /// Whether every message that came in went out.
    pub(super) fn is_empty(&self) -> bool {
        self.out.is_empty() && self.late.is_empty()
    }

    /// The line took so many bytes.
    pub(super) fn sent(&mut self, n: usize) {
        let n = n.min(self.out.len());
        self.account.taken(self.out.get(..n).unwrap_or_default());
        self.out.drain(..n);
    }

    /// What is on its way is gone.
    pub(super) fn cut(&mut self, kind: Kind) {
        self.out.clear();
        self.late.clear();
        self.spoilt = Kinds::default();
        self.account.cut(kind);
    }

    /// One message of the device, with its 0x00. `since` gives a frame's time since the first Start.
    pub(super) fn message(&mut self, bytes: &[u8], since: impl FnOnce(&SentFrame) -> u64) {
        let mut message = Message::Other;
        self.reader.push(bytes, &mut |event| {
            message = match event {
                DeviceEvent::Frame(_) => Message::Frame,
                DeviceEvent::Hello(_) => Message::Hello,
                DeviceEvent::EndOfStream(_) => Message::End,
                _ => Message::Other,
            };
        });
        match message {
            Message::Frame => {
                if let Some((number, frame)) = self.account.handed_over(bytes) {
                    self.since_ns = Some(since(&frame));
                    self.frame(number, bytes);
                    return;
                }
            }
            Message::Hello => self.garbage(),
            // No frame comes after it.
            Message::End => self.release(u32::MAX),
            Message::Other => {}
        }
        self.others += 1;
        self.put(bytes, OTHERS + self.others, None);
    }

    fn frame(&mut self, number: u64, bytes: &[u8]) {
        let since_ns = self.since_ns.unwrap_or(0);
        let script = Arc::clone(&self.script);
        let mut copies = 1;
        let mut late = None;
        for (index, windowed) in script.faults.iter().enumerate() {
            if !windowed.is_on(since_ns) {
                continue;
            }
            let hits = |number, rate| stream(&script, index, number).unit() < rate;
            match windowed.fault {
                Fault::LostFrames { rate, run }
                    if (number.saturating_sub(run - 1)..=number).any(|n| hits(n, rate)) =>
                {
                    self.account.lost(number, Kind::LostFrames);
                    copies = 0;
                }
                Fault::DoubledFrames { rate } if hits(number, rate) => {
                    copies *= 2;
                    self.parts.add(Kind::DoubledFrames, u64::from(copies > 0));
                }
                Fault::Bursts { .. } => self.parts.add(Kind::Bursts, 1),
                Fault::LateFrames { rate, by } if hits(number, rate) => late = Some(by),
                _ => {}
            }
        }
        let copies = copies.min(COPIES);
        match late {
            Some(frames_left) if copies > 0 => {
                self.account.touch(number, Kinds::of(Kind::LateFrames));
                // One more than it is late by: this frame itself is counted below.
                let frames_left = frames_left + 1;
                self.late.push(Held { frames_left, number, bytes: bytes.to_vec() });
            }
            _ => {
                for copy in 0..copies {
                    self.put(bytes, number * COPIES + copy, Some(number));
                }
            }
        }
        self.release(1);
    }

    /// So many frames went by, or will never.
    fn release(&mut self, frames: u32) {
        for held in &mut self.late {
            held.frames_left = held.frames_left.saturating_sub(frames);
        }
        while let Some(due) = self.late.iter().position(|held| held.frames_left == 0) {
            let Held { number, bytes, .. } = self.late.remove(due);
            self.put(&bytes, number * COPIES, Some(number));
        }
    }

    fn garbage(&mut self) {
        self.greetings += 1;
        let script = Arc::clone(&self.script);
        for (index, windowed) in script.faults.iter().enumerate() {
            match windowed.fault {
                Fault::Garbage { bytes, times } if self.greetings <= times => {
                    let mut rng = stream(&script, index, self.greetings);
                    let garbage: Vec<u8> = (0..bytes).map(|_| rng.next_u64() as u8).collect();
                    self.account.put(garbage.len(), None);
                    self.parts.add(Kind::Garbage, 1);
                    self.out.extend(garbage);
                }
                _ => {}
            }
        }
    }

    /// A message to the line, as it is when the faults are through with it.
    fn put(&mut self, bytes: &[u8], stream_index: u64, number: Option<u64>) {
        let mut touched = std::mem::take(&mut self.spoilt);
        let script = Arc::clone(&self.script);
        let mut now = std::mem::take(&mut self.scratch);
        now.clear();
        now.extend_from_slice(bytes);
        // Until the first frame nothing is late enough to be hit.
        let since_ns = self.since_ns.unwrap_or(u64::MAX);
        let faults = script.faults.iter().enumerate().filter(|(_, w)| w.is_on(since_ns));
        for (index, windowed) in faults {
            let (rate, how): (f64, Damage) = match windowed.fault {
                Fault::BitFlips { rate } => (rate, |byte, bit, out| out.push(byte ^ 1 << bit)),
                Fault::DroppedBytes { rate } => (rate, |_, _, _| {}),
                Fault::DoubledBytes { rate } => (rate, |byte, _, out| out.extend([byte; 2])),
                _ => continue,
            };
            let mut rng = stream(&script, index, stream_index);
            let before = std::mem::take(&mut now);
            for byte in before {
                if rng.unit() < rate {
                    how(byte, rng.below(8), &mut now);
                    touched.add(Kinds::of(windowed.fault.kind()));
                } else {
                    now.push(byte);
                }
            }
        }
        if now.last() != Some(&0) {
            // It is not closed, and takes what comes next with it.
            self.spoilt = touched;
        }
        if let Some(number) = number {
            self.account.touch(number, touched);
        }
        self.account.put(now.len(), number);
        self.out.extend_from_slice(&now);
        self.scratch = now;
    }
}

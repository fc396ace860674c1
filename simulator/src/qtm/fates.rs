//! What became of every frame, for the stream that was started first: the ground truth for recordings.

use std::collections::VecDeque;

use mocapd_drivers::qtm::{ClientId, Delivery};

use crate::device::{Fate, FaultTotals, FrameFate, SentFrame, SentLog};
use crate::faults::{Kind, Kinds};

/// Frames whose fate is open: more than the queue of a client holds, whose frames have 24 bytes at least.
const OPEN_MAX: usize = 1 << 18;

#[derive(Debug)]
struct LoggedFrame {
    fate: FrameFate,
    /// What it waits for.
    waits_for: Option<Way>,
    /// Its fate once it has left.
    then: Fate,
}

/// How a frame leaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    /// With so many bytes ever queued for a client.
    Stream(ClientId, u64),
    /// In datagrams, which carry the number of the frame.
    Datagrams(u64),
}

/// Follows frames to the connections that take them.
#[derive(Debug, Default)]
pub(crate) struct DeliveryLog {
    open: VecDeque<LoggedFrame>,
    closed: Vec<FrameFate>,
    keeps_frames: bool,
    totals: FaultTotals,
    bytes_sent: u64,
    frames_sent: u64,
    last_ns: Option<u64>,
}

impl DeliveryLog {
    pub(crate) fn keep_frames(&mut self) {
        self.keeps_frames = true;
    }

    pub(crate) fn take(&mut self) -> Vec<FrameFate> {
        std::mem::take(&mut self.closed)
    }

    pub(crate) fn totals(&self) -> FaultTotals {
        self.totals.clone()
    }

    /// When the last frame was due.
    pub(crate) fn last_ns(&self) -> Option<u64> {
        self.last_ns
    }

    fn add(&mut self, frame: SentFrame, fate: Fate, waits_for: Option<Way>) {
        self.last_ns = Some(frame.host_ns);
        let fate = FrameFate { frame, frames: 1, fate, again: 0, faults: Kinds::default() };
        self.open.push_back(LoggedFrame { fate, waits_for, then: Fate::Whole });
        while self.open.len() > OPEN_MAX {
            self.close_first();
        }
    }

    /// A fault of this kind lost the frame.
    pub(crate) fn lost(&mut self, frame: SentFrame, kind: Kind) {
        self.add(frame, Fate::Lost, None);
        if let Some(last) = self.open.back_mut() {
            last.fate.faults = Kinds::of(kind);
        }
        self.close_decided();
    }

    /// The server sent the frame, or not. Its datagrams carry `number`.
    pub(crate) fn sent(&mut self, frame: SentFrame, delivery: Delivery, number: u64) {
        match delivery {
            Delivery::Queued { client, end } => {
                self.add(frame, Fate::Waiting, Some(Way::Stream(client, end)));
            }
            Delivery::Datagrams(_) => {
                self.add(frame, Fate::Waiting, Some(Way::Datagrams(number)));
            }
            Delivery::Dropped => {
                self.add(SentFrame { dropped: true, ..frame }, Fate::Dropped, None);
            }
            Delivery::NotRequested | Delivery::NoStream => {
                self.add(SentFrame { unasked: true, ..frame }, Fate::Unasked, None);
            }
        }
    }

    /// The last frame arrives after later ones.
    pub(crate) fn late(&mut self, frame: SentFrame, faults: Kinds) {
        if let Some(last) = self.open.back_mut().filter(|last| last.fate.frame == frame) {
            last.then = Fate::Late;
            last.fate.faults = faults;
        }
    }

    /// A connection took `n` more bytes, so many in all.
    pub(crate) fn taken(&mut self, id: ClientId, bytes_sent: u64, n: usize) {
        self.bytes_sent += n as u64;
        for entry in &mut self.open {
            match entry.waits_for {
                Some(Way::Stream(client, end)) if client == id && end <= bytes_sent => {
                    entry.waits_for = None;
                    entry.fate.fate = entry.then;
                }
                // They are in the order of their ends.
                Some(Way::Stream(client, _)) if client == id => break,
                _ => {}
            }
        }
        self.close_decided();
    }

    /// The system took a datagram of the frame with this number, or lost it.
    pub(crate) fn datagram_taken(&mut self, number: u64, bytes: Option<usize>) {
        self.bytes_sent += bytes.unwrap_or(0) as u64;
        // A copy may follow when the first one has settled the frame.
        let entry = self.open.iter_mut().find(|e| e.waits_for == Some(Way::Datagrams(number)));
        if let Some(entry) = entry {
            entry.waits_for = None;
            entry.fate.fate = if bytes.is_some() { entry.then } else { Fate::Lost };
        }
    }

    /// The copies of the last frame, which leave with it.
    pub(crate) fn again(&mut self, copies: u32) {
        if let Some(last) = self.open.back_mut() {
            last.fate.again += copies;
        }
    }

    /// All datagrams were handed over.
    pub(crate) fn settle(&mut self) {
        self.close_decided();
    }

    /// What waits for a client does not reach it any more.
    pub(crate) fn abandon(&mut self, id: ClientId) {
        for entry in &mut self.open {
            if matches!(entry.waits_for, Some(Way::Stream(client, _)) if client == id) {
                entry.waits_for = None;
                entry.fate.fate = Fate::Discarded;
            }
        }
        self.close_decided();
    }

    /// All connections were cut, and no datagram leaves any more.
    pub(crate) fn cut(&mut self, kind: Kind) {
        for entry in self.open.iter_mut().filter(|entry| entry.waits_for.is_some()) {
            entry.waits_for = None;
            entry.fate.fate = Fate::Lost;
            entry.fate.again = 0;
            entry.fate.faults = Kinds::of(kind);
        }
        self.close_decided();
    }

    fn close_decided(&mut self) {
        while self.open.front().is_some_and(|entry| entry.waits_for.is_none()) {
            self.close_first();
        }
    }

    fn close_first(&mut self) {
        let Some(LoggedFrame { fate, .. }) = self.open.pop_front() else { return };
        self.totals.add(&fate);
        self.frames_sent += u64::from(matches!(fate.fate, Fate::Whole | Fate::Late));
        if self.keeps_frames {
            self.closed.push(fate);
        }
    }

    /// Nothing is sent any more.
    pub(crate) fn close(&mut self) {
        while !self.open.is_empty() {
            self.close_first();
        }
    }

    /// Fills in what was sent.
    pub(crate) fn complete(&self, log: &mut SentLog) {
        log.bytes_sent = self.bytes_sent;
        log.frames_sent = self.frames_sent;
        log.frames_waiting = self.open.iter().filter(|e| e.waits_for.is_some()).count() as u64;
        log.frames_discarded = self.totals.of(Fate::Discarded) + self.totals.of(Fate::Lost);
    }
}

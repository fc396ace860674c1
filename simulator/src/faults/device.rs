//! A device on a line with faults: the device itself, what damages its bytes, and what cuts it off.

use std::sync::Arc;

use super::connection::{Connection, State};
use super::kinds::Kind;
use super::script::Script;
use super::wire::Wire;
use crate::device::{Device, FrameFate, LineDevice, SentFrame, SentLog};

/// A [`Device`] whose script has its way with it, sans-io as the device is.
///
/// What the script does inside the device is the device's own: it has the same script in its settings.
#[derive(Debug)]
pub struct FaultyDevice {
    device: Device,
    wire: Wire,
    connection: Connection,
    state: State,
    first_start_ns: Option<u64>,
    /// Of the last turn, since then.
    seen_ns: Option<u64>,
    discarded: u64,
    starts: u64,
    /// Plugged in again, and no host has said anything: nothing leaves it.
    unheard: bool,
}

impl FaultyDevice {
    /// A device with faults. It should have been made with the same script in its settings.
    #[must_use]
    pub fn new(mut device: Device, script: &Arc<Script>) -> Self {
        device.keep_frame_log();
        Self {
            device,
            wire: Wire::new(Arc::clone(script)),
            connection: Connection::new(script),
            state: State { plugged: true, powered: true, flows: true },
            first_start_ns: None,
            seen_ns: None,
            discarded: 0,
            starts: 0,
            unheard: false,
        }
    }

    /// Frames whose fate is known, in the order in which they were produced, when they were asked for.
    pub fn take_fates(&mut self) -> Vec<FrameFate> {
        self.wire.account.take_frames()
    }

    fn since_ns(&self, now_ns: u64) -> Option<u64> {
        self.first_start_ns.map(|start_ns| now_ns.saturating_sub(start_ns))
    }

    /// Frames that the device made, and those that it will not hand over.
    fn collect(&mut self) {
        for frame in self.device.take_frames() {
            self.wire.account.produced(frame);
        }
        let discarded = self.device.log().frames_discarded;
        self.wire.account.discarded(discarded - self.discarded);
        self.discarded = discarded;
    }

    /// What the device said goes on its way, in whole messages.
    fn carry(&mut self) {
        let first_start_ns = self.first_start_ns.unwrap_or(0);
        while self.wire.has_room() {
            let pending = self.device.pending();
            // A 0x00 in front of a message is filler, and part of it.
            let start = pending.iter().take_while(|byte| **byte == 0).count();
            let rest = pending.get(start..).unwrap_or_default();
            let Some(end) = rest.iter().position(|byte| *byte == 0) else { break };
            let n = start + end + 1;
            self.wire.message(pending.get(..n).unwrap_or_default(), |frame: &SentFrame| {
                frame.host_ns.saturating_sub(first_start_ns)
            });
            self.device.sent(n);
        }
    }

    /// What begins or ends at this time does.
    fn turn(&mut self, now_ns: u64) {
        let Some(since_ns) = self.since_ns(now_ns) else { return };
        self.seen_ns = Some(since_ns);
        let (before, now) = (self.state, self.connection.state(since_ns));
        self.state = now;
        if before.powered && !now.powered {
            // What it was about to say is lost with its memory.
            self.collect();
            self.device.lose_power();
            self.collect();
            self.wire.cut(Kind::PowerLoss);
        } else if before.plugged && !now.plugged {
            self.wire.cut(Kind::Unplug);
        }
        if !before.powered && now.powered {
            self.device.power_up(now_ns, now.plugged && before.plugged);
        }
        if !before.plugged && now.plugged {
            self.unheard = true;
            self.wire.account.set_unasked(true);
        }
    }
}

impl LineDevice for FaultyDevice {
    fn on_bytes(&mut self, bytes: &[u8], now_ns: u64) {
        self.turn(now_ns);
        if !self.state.plugged || !self.state.powered {
            return;
        }
        self.unheard = false;
        self.device.on_bytes(bytes, now_ns);
        self.collect();
        let starts = self.device.log().starts;
        if starts > self.starts {
            self.starts = starts;
            self.first_start_ns.get_or_insert(now_ns);
            self.wire.account.set_unasked(false);
        }
    }

    fn poll(&mut self, now_ns: u64) -> u64 {
        self.turn(now_ns);
        let mut wake_ns = u64::MAX;
        if self.state.powered {
            wake_ns = self.device.poll(now_ns);
            self.collect();
        }
        if self.state.flows && !self.unheard {
            self.carry();
        }
        let Some(since_ns) = self.since_ns(now_ns) else { return wake_ns };
        self.connection.tick(since_ns, self.wire.out.len());
        let next_ns = self.connection.next_ns(since_ns);
        wake_ns.min(next_ns.saturating_add(now_ns - since_ns))
    }

    fn pending(&self) -> &[u8] {
        if !self.state.flows || self.unheard {
            return &[];
        }
        let out = &self.wire.out;
        out.get(..self.connection.allowed(out.len())).unwrap_or_default()
    }

    fn sent(&mut self, n: usize) {
        self.wire.sent(n);
        self.connection.sent(n);
    }

    fn has_ended(&self) -> bool {
        let is_there = self.state.plugged && self.state.powered;
        let all_left = self.wire.is_empty() && self.device.pending().is_empty();
        is_there && all_left && self.device.has_ended()
    }

    fn is_plugged(&self) -> bool {
        self.state.plugged
    }

    fn log(&self) -> SentLog {
        let mut totals = self.wire.account.totals();
        let begun = self.seen_ns.map(|since_ns| self.connection.parts(since_ns));
        for parts in [self.device.fault_parts(), self.wire.parts, begun.unwrap_or_default()] {
            totals.parts = totals.parts.join(parts);
        }
        SentLog { faults: Some(totals), ..self.device.log() }
    }

    fn keep_frame_log(&mut self) {
        self.wire.account.keep_frames();
    }

    /// Those whose fate is known.
    fn take_frames(&mut self) -> Vec<SentFrame> {
        self.take_fates().into_iter().map(|fate| fate.frame).collect()
    }

    fn log_header(&self) -> &'static str {
        FrameFate::CSV_HEADER
    }

    fn take_log_lines(&mut self) -> Vec<String> {
        self.take_fates().into_iter().map(FrameFate::to_csv).collect()
    }

    fn close(&mut self) {
        self.collect();
        self.wire.account.close();
    }
}

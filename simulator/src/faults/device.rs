//! A device behind a faulty line: the device itself, damage to its bytes, and outages of the connection.

use std::sync::Arc;

use super::connection::{ConnectionFaults, ConnectionState};
use super::kinds::Kind;
use super::script::Script;
use super::wire::WireFaults;
use crate::device::{Device, FrameFate, LineDevice, SentFrame, SentLog};

/// A [`Device`] behind the faults of a script; sans-io, like the device itself.
///
/// The device applies the faults inside it (motion, counter, clock): its settings hold the same script.
#[derive(Debug)]
pub struct FaultyDevice {
    device: Device,
    wire: WireFaults,
    connection: ConnectionFaults,
    state: ConnectionState,
    first_start_ns: Option<u64>,
    /// Time of the last state update, since the first Start.
    last_update_ns: Option<u64>,
    discarded: u64,
    starts: u64,
    /// The cable is back in and no host has sent anything yet: no bytes leave the device.
    awaits_host: bool,
}

impl FaultyDevice {
    /// Wraps a device whose settings hold the same script.
    #[must_use]
    pub fn new(mut device: Device, script: &Arc<Script>) -> Self {
        device.keep_frame_log();
        Self {
            device,
            wire: WireFaults::new(Arc::clone(script)),
            connection: ConnectionFaults::new(script),
            state: ConnectionState { plugged: true, powered: true, flows: true },
            first_start_ns: None,
            last_update_ns: None,
            discarded: 0,
            starts: 0,
            awaits_host: false,
        }
    }

    /// Takes the frames whose fate is known, in order of production. Empty without
    /// [`keep_frame_log`](LineDevice::keep_frame_log).
    pub fn take_fates(&mut self) -> Vec<FrameFate> {
        self.wire.fates.take_frames()
    }

    fn since_ns(&self, now_ns: u64) -> Option<u64> {
        self.first_start_ns.map(|start_ns| now_ns.saturating_sub(start_ns))
    }

    /// Passes newly produced and discarded frames on to the fate tracker.
    fn collect(&mut self) {
        for frame in self.device.take_frames() {
            self.wire.fates.produced(frame);
        }
        let discarded = self.device.log().frames_discarded;
        self.wire.fates.discarded(discarded - self.discarded);
        self.discarded = discarded;
    }

    /// Moves whole messages from the device to the faulty wire.
    fn forward_messages(&mut self) {
        let first_start_ns = self.first_start_ns.unwrap_or(0);
        while self.wire.has_room() {
            let pending = self.device.pending();
            // A 0x00 in front of a message is filler and travels with it.
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

    /// Applies the outages that begin or end at this time.
    fn update_state(&mut self, now_ns: u64) {
        let Some(since_ns) = self.since_ns(now_ns) else { return };
        self.last_update_ns = Some(since_ns);
        let (before, now) = (self.state, self.connection.state(since_ns));
        self.state = now;
        if before.powered && !now.powered {
            // Its queue is lost with its memory.
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
            self.awaits_host = true;
            self.wire.fates.set_unasked(true);
        }
    }
}

impl LineDevice for FaultyDevice {
    fn on_bytes(&mut self, bytes: &[u8], now_ns: u64) {
        self.update_state(now_ns);
        if !self.state.plugged || !self.state.powered {
            return;
        }
        self.awaits_host = false;
        self.device.on_bytes(bytes, now_ns);
        self.collect();
        let starts = self.device.log().starts;
        if starts > self.starts {
            self.starts = starts;
            self.first_start_ns.get_or_insert(now_ns);
            self.wire.fates.set_unasked(false);
        }
    }

    fn poll(&mut self, now_ns: u64) -> u64 {
        self.update_state(now_ns);
        let mut wake_ns = u64::MAX;
        if self.state.powered {
            wake_ns = self.device.poll(now_ns);
            self.collect();
        }
        if self.state.flows && !self.awaits_host {
            self.forward_messages();
        }
        let Some(since_ns) = self.since_ns(now_ns) else { return wake_ns };
        self.connection.tick(since_ns, self.wire.out.len());
        let next_ns = self.connection.next_ns(since_ns);
        wake_ns.min(next_ns.saturating_add(now_ns - since_ns))
    }

    fn pending(&self) -> &[u8] {
        if !self.state.flows || self.awaits_host {
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
        let mut totals = self.wire.fates.totals();
        let begun = self.last_update_ns.map(|since_ns| self.connection.counts(since_ns));
        for counts in [self.device.fault_counts(), self.wire.counts, begun.unwrap_or_default()] {
            totals.counts = totals.counts.merge(counts);
        }
        SentLog { faults: Some(totals), ..self.device.log() }
    }

    fn keep_frame_log(&mut self) {
        self.wire.fates.keep_frames();
    }

    /// Takes the frames whose fate is known.
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
        self.wire.fates.close();
    }
}

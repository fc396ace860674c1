//! A device behind a faulty line: the device itself, damage to its bytes, and outages of the connection.

use std::sync::Arc;

use super::script::{ScheduledFault, Script, nanoseconds};
use super::wire::WireFaults;
use super::{Fault, Kind};
use crate::device::{BatchFate, Device, FaultCounts, FrameFate, LineDevice, SentFrame, SentLog};
use crate::line::LatencyTimer;

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
    batches_discarded: u64,
    starts: u64,
    /// Whether the cable is back in and no host has sent anything yet: no bytes leave the device.
    awaits_host: bool,
    /// Whether the cable or the power is back and the host has not started the device again. Before it does, it sends
    /// Stop, in case the device still streams; that Stop does not end the run for `--once`.
    awaits_start: bool,
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
            batches_discarded: 0,
            starts: 0,
            awaits_host: false,
            awaits_start: false,
        }
    }

    /// Takes the frames whose fate is known, in order of production. Empty without
    /// [`keep_frame_log`](LineDevice::keep_frame_log).
    pub fn take_fates(&mut self) -> Vec<FrameFate> {
        self.wire.fates.take_frames()
    }

    /// Takes the batches of samples whose fate is known, in order of production.
    pub fn take_batch_fates(&mut self) -> Vec<BatchFate> {
        self.wire.batches.take_frames()
    }

    fn since_ns(&self, now_ns: u64) -> Option<u64> {
        self.first_start_ns.map(|start_ns| now_ns.saturating_sub(start_ns))
    }

    /// Passes newly produced and discarded frames on to the fate tracker.
    fn collect(&mut self) {
        for frame in self.device.take_frames() {
            self.wire.fates.produced(frame);
        }
        for batch in self.device.take_batches() {
            self.wire.batches.produced(batch);
        }
        let SentLog { frames_discarded, batches_discarded, .. } = self.device.log();
        self.wire.fates.discarded(frames_discarded - self.discarded);
        self.wire.batches.discarded(batches_discarded - self.batches_discarded);
        (self.discarded, self.batches_discarded) = (frames_discarded, batches_discarded);
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
            self.wire.message(pending.get(..n).unwrap_or_default(), |host_ns| {
                host_ns.saturating_sub(first_start_ns)
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
            self.awaits_start = true;
        }
        if !before.plugged && now.plugged {
            self.awaits_host = true;
            self.awaits_start = true;
            self.wire.set_unasked(true);
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
            self.awaits_start = false;
            self.first_start_ns.get_or_insert(now_ns);
            self.wire.set_unasked(false);
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
        let is_over = !self.awaits_start || self.device.has_played_all();
        is_there && is_over && all_left && self.device.has_ended()
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
        let batch_faults = Some(self.wire.batches.totals());
        SentLog { faults: Some(totals), batch_faults, ..self.device.log() }
    }

    fn keep_frame_log(&mut self) {
        self.wire.fates.keep_frames();
        self.wire.batches.keep_frames();
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

    fn batch_log_header(&self) -> &'static str {
        BatchFate::CSV_HEADER
    }

    fn take_batch_lines(&mut self) -> Vec<String> {
        self.take_batch_fates().into_iter().map(BatchFate::to_csv).collect()
    }

    fn close(&mut self) {
        self.collect();
        self.wire.close();
    }
}

/// The state of the connection at one time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ConnectionState {
    /// Whether the cable is plugged in.
    pub(crate) plugged: bool,
    /// Whether the device is switched on.
    pub(crate) powered: bool,
    /// Whether the line delivers bytes.
    pub(crate) flows: bool,
}

/// A stall, unplugged cable or loss of power, from its start to its end.
#[derive(Debug, Clone, Copy)]
struct Outage {
    kind: Kind,
    from_ns: u64,
    to_ns: u64,
    keeps_port: bool,
}

/// A window in which waiting bytes are delivered only once per period.
#[derive(Debug, Clone, Copy)]
struct Burst {
    from_ns: u64,
    to_ns: u64,
    period_ns: u64,
}

/// The faults of a script that act on the connection. Times are nanoseconds since the first Start.
#[derive(Debug)]
pub(crate) struct ConnectionFaults {
    outages: Vec<Outage>,
    bursts: Vec<Burst>,
    timer: Option<LatencyTimer>,
}

impl ConnectionFaults {
    pub(crate) fn new(script: &Script) -> Self {
        let mut outages = Vec::new();
        let mut bursts = Vec::new();
        for &ScheduledFault { ref fault, from_ns, to_ns } in &script.faults {
            let kind = fault.kind();
            match *fault {
                Fault::Stall { at_s, for_s }
                | Fault::Unplug { at_s, for_s }
                | Fault::PowerLoss { at_s, for_s, .. } => {
                    let (from_ns, to_ns) = (nanoseconds(at_s), nanoseconds(at_s + for_s));
                    let keeps_port = matches!(fault, Fault::PowerLoss { keeps_port: true, .. });
                    outages.push(Outage { kind, from_ns, to_ns, keeps_port });
                }
                Fault::Bursts { period_ms } => {
                    bursts.push(Burst { from_ns, to_ns, period_ns: period_ms * 1_000_000 });
                }
                _ => {}
            }
        }
        Self { outages, bursts, timer: None }
    }

    /// The state at `since_ns` after the first Start.
    pub(crate) fn state(&self, since_ns: u64) -> ConnectionState {
        let mut state = ConnectionState { plugged: true, powered: true, flows: true };
        for outage in &self.outages {
            if (outage.from_ns..outage.to_ns).contains(&since_ns) {
                state.plugged &= outage.kind == Kind::Stall || outage.keeps_port;
                state.powered &= outage.kind != Kind::PowerLoss;
                state.flows = false;
            }
        }
        state
    }

    /// The time of the next change; `u64::MAX` when none is left.
    pub(crate) fn next_ns(&self, since_ns: u64) -> u64 {
        let edges = self.outages.iter().flat_map(|outage| [outage.from_ns, outage.to_ns]);
        let edge = edges.filter(|at| *at > since_ns).min().unwrap_or(u64::MAX);
        edge.min(self.timer.as_ref().map_or(u64::MAX, |timer| timer.next_ns))
    }

    /// How many outages of each kind have begun.
    pub(crate) fn counts(&self, since_ns: u64) -> FaultCounts {
        let mut counts = FaultCounts::default();
        for outage in self.outages.iter().filter(|outage| outage.from_ns <= since_ns) {
            counts.add(outage.kind, 1);
        }
        counts
    }

    /// How many of the `waiting` bytes may be delivered now.
    pub(super) fn allowed(&self, waiting: usize) -> usize {
        self.timer.as_ref().map_or(waiting, |timer| timer.released.min(waiting))
    }

    /// Advances the latency timer. `waiting` bytes have been waiting since the last call.
    pub(super) fn tick(&mut self, since_ns: u64, waiting: usize) {
        let on = self.bursts.iter().find(|burst| (burst.from_ns..burst.to_ns).contains(&since_ns));
        match (on, &mut self.timer) {
            (None, timer) => *timer = None,
            (Some(_), Some(timer)) => timer.tick(since_ns, waiting),
            (Some(burst), timer) => *timer = Some(LatencyTimer::new(burst.period_ns, since_ns)),
        }
    }

    pub(super) fn sent(&mut self, n: usize) {
        if let Some(timer) = &mut self.timer {
            timer.sent(n);
        }
    }
}

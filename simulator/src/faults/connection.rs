//! Faults of the connection: stalls, bursts, unplugged cables and losses of power.

use super::kinds::{Fault, Kind};
use super::script::{ScheduledFault, Script, nanoseconds};
use crate::device::FaultCounts;
use crate::line::LatencyTimer;

/// The state of the connection at one time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ConnectionState {
    /// The cable is plugged in.
    pub(super) plugged: bool,
    /// The device is switched on.
    pub(super) powered: bool,
    /// Bytes are delivered.
    pub(super) flows: bool,
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
pub(super) struct ConnectionFaults {
    outages: Vec<Outage>,
    bursts: Vec<Burst>,
    timer: Option<LatencyTimer>,
}

impl ConnectionFaults {
    pub(super) fn new(script: &Script) -> Self {
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
    pub(super) fn state(&self, since_ns: u64) -> ConnectionState {
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
    pub(super) fn next_ns(&self, since_ns: u64) -> u64 {
        let edges = self.outages.iter().flat_map(|outage| [outage.from_ns, outage.to_ns]);
        let edge = edges.filter(|at| *at > since_ns).min().unwrap_or(u64::MAX);
        edge.min(self.timer.as_ref().map_or(u64::MAX, |timer| timer.next_ns))
    }

    /// How many outages of each kind have begun.
    pub(super) fn counts(&self, since_ns: u64) -> FaultCounts {
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

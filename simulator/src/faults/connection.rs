//! What goes wrong with the connection: when nothing is handed over, and when there is none.

use super::kinds::{Fault, Kind};
use super::script::{Script, Windowed, nanoseconds};
use crate::device::Parts;
use crate::line::Batch;

/// The state of the connection at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct State {
    /// The cable is in.
    pub(super) plugged: bool,
    /// The device is switched on.
    pub(super) powered: bool,
    /// What it says is handed over.
    pub(super) flows: bool,
}

/// One thing that is not there for a while.
#[derive(Debug, Clone, Copy)]
struct Outage {
    kind: Kind,
    from_ns: u64,
    to_ns: u64,
    keeps_port: bool,
}

/// While what waits is handed over once in a while only.
#[derive(Debug, Clone, Copy)]
struct Burst {
    from_ns: u64,
    to_ns: u64,
    period_ns: u64,
}

/// The faults of a script that act on the connection. Times are nanoseconds since the first Start.
#[derive(Debug)]
pub(super) struct Connection {
    outages: Vec<Outage>,
    bursts: Vec<Burst>,
    batch: Option<Batch>,
}

impl Connection {
    pub(super) fn new(script: &Script) -> Self {
        let mut outages = Vec::new();
        let mut bursts = Vec::new();
        for windowed in &script.faults {
            let kind = windowed.fault.kind();
            match windowed.fault {
                Fault::Stall { at_s, for_s }
                | Fault::Unplug { at_s, for_s }
                | Fault::PowerLoss { at_s, for_s, .. } => {
                    let (from_ns, to_ns) = (nanoseconds(at_s), nanoseconds(at_s + for_s));
                    let keeps_port =
                        matches!(windowed.fault, Fault::PowerLoss { keeps_port, .. } if keeps_port);
                    outages.push(Outage { kind, from_ns, to_ns, keeps_port });
                }
                Fault::Bursts { period_ms } => {
                    let Windowed { from_ns, to_ns, .. } = *windowed;
                    bursts.push(Burst { from_ns, to_ns, period_ns: period_ms * 1_000_000 });
                }
                _ => {}
            }
        }
        Self { outages, bursts, batch: None }
    }

    /// What is there at a time.
    pub(super) fn state(&self, since_ns: u64) -> State {
        let mut state = State { plugged: true, powered: true, flows: true };
        for outage in &self.outages {
            if (outage.from_ns..outage.to_ns).contains(&since_ns) {
                state.plugged &= outage.kind == Kind::Stall || outage.keeps_port;
                state.powered &= outage.kind != Kind::PowerLoss;
                state.flows = false;
            }
        }
        state
    }

    /// When it changes next.
    pub(super) fn next_ns(&self, since_ns: u64) -> u64 {
        let edges = self.outages.iter().flat_map(|outage| [outage.from_ns, outage.to_ns]);
        let edge = edges.filter(|at| *at > since_ns).min().unwrap_or(u64::MAX);
        edge.min(self.batch.as_ref().map_or(u64::MAX, |batch| batch.next_ns))
    }

    /// The outages that have begun.
    pub(super) fn parts(&self, since_ns: u64) -> Parts {
        let mut parts = Parts::default();
        for outage in self.outages.iter().filter(|outage| outage.from_ns <= since_ns) {
            parts.add(outage.kind, 1);
        }
        parts
    }

    /// How many of the `waiting` bytes may be handed over.
    pub(super) fn allowed(&self, waiting: usize) -> usize {
        self.batch.as_ref().map_or(waiting, |batch| batch.released.min(waiting))
    }

    /// Time passed. `waiting` bytes were there all the while.
    pub(super) fn tick(&mut self, since_ns: u64, waiting: usize) {
        let on = self.bursts.iter().find(|burst| (burst.from_ns..burst.to_ns).contains(&since_ns));
        match (on, &mut self.batch) {
            (None, batch) => *batch = None,
            (Some(_), Some(batch)) => batch.tick(since_ns, waiting),
            (Some(burst), batch) => *batch = Some(Batch::new(burst.period_ns, since_ns)),
        }
    }

    pub(super) fn sent(&mut self, n: usize) {
        if let Some(batch) = &mut self.batch {
            batch.sent(n);
        }
    }
}

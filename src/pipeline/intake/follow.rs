//! What each frame's counter and clock say of those before it.

use mocapd_drivers::device::Frame;
use mocapd_take::{
    record::{Event, EventKind},
    timeline::Causes,
};

use super::{Intake, Step};

impl Intake {
    /// `false` for a frame that was seen before.
    pub(super) fn follow(&mut self, frame: &Frame<'_>) -> bool {
        match self.axis.step(frame.seq, frame.device_ticks) {
            Step::Next { missing } => {
                self.counts.not_received += u64::from(missing);
                self.pending.add(u64::from(missing), Causes::NOT_RECEIVED);
            }
            Step::Again => {
                self.counts.duplicates += 1;
                return false;
            }
            Step::Jump => self.counts.counter_jumps += 1,
        }
        true
    }

    /// The device went away, is back, and was told to start again: its reports count from there, and what its counter
    /// skips until its next frame was lost to the outage.
    pub fn rejoin(&mut self) {
        self.rejoining = true;
        self.clocks.rejoin();
        self.counts.rejoin();
    }

    /// The first frame after an outage.
    pub(super) fn end_outage(&mut self, frame: &Frame<'_>, arrival_ns: u64) {
        self.rejoining = false;
        if let Some(missing) = self.axis.rejoin(frame.seq, frame.device_ticks) {
            let missing = u64::from(missing);
            self.counts.lost_in_outages += missing;
            self.pending.add(missing, Causes::NOT_RECEIVED.union(Causes::DISCONNECTED));
        } else {
            // How many frames it would have sent meanwhile nobody knows: none are made up.
            self.event(Event {
                kind: EventKind::Host,
                row: 0,
                device_ticks: frame.device_ticks,
                host_ns: arrival_ns,
                input: 0,
                text: "the device began anew: its frame counter and clock start over".to_owned(),
            });
        }
        self.counts.reports_from = self.counts.seen();
    }
}

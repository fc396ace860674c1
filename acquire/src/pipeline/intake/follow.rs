//! What each frame's counter and clock say of those before it.

use mocapd_drivers::device::Frame;
use mocapd_take::{
    record::{Event, EventKind},
    timeline::Causes,
};

use super::{Intake, Step, UNSEEN_MAX};

impl Intake {
    /// `false` for a frame that was seen before.
    pub(super) fn follow(&mut self, frame: &Frame<'_>) -> bool {
        match self.axis.step(frame.seq, frame.device_ticks) {
            Step::Next { missing } => {
                // A take that ended in a silence has what was due in it.
                let counted = std::mem::take(&mut self.rows_away);
                let missing = u64::from(missing);
                self.counts.not_produced(counted.saturating_sub(missing));
                let new = missing.saturating_sub(counted);
                self.counts.not_received += new;
                self.pending.add(new, Causes::NOT_RECEIVED);
            }
            Step::Again => {
                self.counts.duplicates += 1;
                return false;
            }
            Step::Jump => {
                self.counts.counter_jumps += 1;
                let counted = std::mem::take(&mut self.rows_away);
                self.counts.not_produced(counted);
            }
        }
        true
    }

    /// The device went away, is back, and was told to start again: its reports count from there, and what is missing
    /// until its next frame was lost to the outage.
    pub fn rejoin(&mut self) {
        self.rejoining = true;
        self.clocks.rejoin();
        self.counts.rejoin();
    }

    /// The first frame after an outage.
    pub(super) fn end_outage(&mut self, frame: &Frame<'_>, arrival_ns: u64) {
        self.rejoining = false;
        let silent_s = self.silences.until_ns(arrival_ns) as f64 * 1e-9;
        let (missing, causes, how, why) = match self.axis.rejoin(frame.seq, frame.device_ticks) {
            Some(missing) => {
                let causes = Causes::NOT_RECEIVED.union(Causes::DISCONNECTED);
                (u64::from(missing), causes, "goes on", "are missing by its counter")
            }
            // Its counter tells nothing of the time between; the host's clock does, so that the take keeps time.
            None => {
                let due = self.due(silent_s);
                (due, Causes::DISCONNECTED, "began anew", "were due by the host's clock")
            }
        };
        let new = missing.saturating_sub(std::mem::take(&mut self.rows_away));
        // At the first row that there is again.
        let row = self.next_row + self.pending.rows() + new;
        let event = Event {
            kind: EventKind::Host,
            row,
            device_ticks: frame.device_ticks,
            host_ns: arrival_ns,
            input: 0,
            text: format!(
                "the device is back after {silent_s:.3} s, and {how}: {missing} frames {why}"
            ),
        };
        self.event_at(row, event);
        self.counts.reports_from = self.counts.seen() + new;
        self.counts.lost_to_outage(new);
        self.counts.told_twice = missing;
        self.pending.add(new, causes);
    }

    /// How many frames fit between two that are so far apart.
    pub(super) fn due(&self, silent_s: f64) -> u64 {
        ((silent_s * self.rate_hz).round() as u64).saturating_sub(1).min(UNSEEN_MAX)
    }
}

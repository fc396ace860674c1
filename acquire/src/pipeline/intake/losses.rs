//! Loss between two frames: by the device's frame counter, which also shows repeated frames, by the clock in a silence, and
//! the rows pending until the next frame.

use mocapd_drivers::{axis::SeqStep, device::Frame};
use mocapd_take::{
    record::{Event, EventKind},
    timeline::LossCauses,
};

use super::{Intake, UNSEEN_MAX};
use crate::pipeline::{counts::PendingRows, plan::RUNS_MAX};

impl Intake {
    /// Counts the frames missing before this one. Returns `false` for a frame that was received before.
    pub(super) fn count_frame(&mut self, frame: &Frame<'_>) -> bool {
        match self.counter.step(frame.seq, frame.device_ticks) {
            SeqStep::Next { missing } => {
                // A take that ended in a silence has already counted what was due in it.
                let counted = std::mem::take(&mut self.rows_away);
                let missing = u64::from(missing);
                self.counts.not_produced(counted.saturating_sub(missing));
                let new = missing.saturating_sub(counted);
                self.counts.not_received += new;
                self.pending.add(new, LossCauses::NOT_RECEIVED);
            }
            SeqStep::Stale => {
                self.counts.duplicates += 1;
                return false;
            }
            SeqStep::Jump => {
                self.counts.counter_jumps += 1;
                let counted = std::mem::take(&mut self.rows_away);
                self.counts.not_produced(counted);
            }
        }
        true
    }

    /// Prepares for the first frame after an outage, when the device was told to start again: its reports count from
    /// here, and frames missing until that frame were lost to the outage.
    pub fn rejoin(&mut self) {
        self.rejoining = true;
        self.reset_poses();
        // Samples before it lie in the segment of the clock that ends here.
        self.samples.end_blocks(self.feed.next_stretch(), self.clocks.segment());
        self.samples.rejoin();
        self.clocks.rejoin();
        self.counts.rejoin();
    }

    /// Counts the loss at the first frame after an outage.
    pub(super) fn end_outage(&mut self, frame: &Frame<'_>, arrival_ns: u64) {
        self.rejoining = false;
        let silent_s = self.silence.since_last_frame_ns(arrival_ns) as f64 * 1e-9;
        let (missing, causes, how, why) = match self.counter.rejoin(frame.seq, frame.device_ticks) {
            Some(missing) => {
                let causes = LossCauses::NOT_RECEIVED.union(LossCauses::DISCONNECTED);
                (u64::from(missing), causes, "continues", "are missing by its counter")
            }
            // The counter does not cover the time between; use the host's clock, so that the take keeps time.
            None => {
                let due = self.frames_due(silent_s);
                (due, LossCauses::DISCONNECTED, "restarted", "are missing by the host's clock")
            }
        };
        let new = missing.saturating_sub(std::mem::take(&mut self.rows_away));
        // At the first row after the outage.
        let row = self.next_row + self.pending.rows() + new;
        let text =
            format!("the device is back after {silent_s:.3} s and {how}: {missing} frames {why}");
        let event = Event::new(EventKind::Host, arrival_ns, text);
        let event = Event { device_ticks: frame.device_ticks, ..event };
        self.event_at(row, event);
        self.counts.reports_offset = self.counts.seen() + new;
        self.counts.lost_to_outage(new);
        self.counts.reported_twice = missing;
        self.pending.add(new, causes);
    }

    /// Number of frames that fit between two frames with this interval.
    fn frames_due(&self, silent_s: f64) -> u64 {
        ((silent_s * self.rate_hz).round() as u64).saturating_sub(1).min(UNSEEN_MAX)
    }
}

/// Shortest silence that is an event, in seconds.
const SILENCE_S: f64 = 1.0;

/// Shortest silence that is an event, in frame intervals; it exceeds [`SILENCE_S`] at low rates.
const SILENCE_FRAMES: f64 = 10.0;

/// Silences that get an event. More of them mean a device that sends irregularly; the timeline has the time of each
/// frame.
const EVENTS_MAX: u32 = 256;

/// Arrival of the last frame, and the silences so far.
#[derive(Debug)]
pub(super) struct SilenceMonitor {
    longest_ns: u64,
    last_arrival_ns: Option<u64>,
    /// When the device last reported that all its frames had arrived.
    accounted_ns: u64,
    n_events: u32,
}

impl SilenceMonitor {
    pub(super) fn new(rate_hz: f64) -> Self {
        let longest_ns = (SILENCE_S.max(SILENCE_FRAMES / rate_hz) * 1e9) as u64;
        Self { longest_ns, last_arrival_ns: None, accounted_ns: 0, n_events: 0 }
    }

    /// Time since the last frame; 0 before the first.
    fn since_last_frame_ns(&self, now_ns: u64) -> u64 {
        self.last_arrival_ns.map_or(0, |last_ns| now_ns.saturating_sub(last_ns))
    }

    /// The device reports that all its frames have arrived.
    pub(super) fn account(&mut self, now_ns: u64) {
        self.accounted_ns = now_ns;
    }

    /// Time since the last frame or the last such report, whichever is later.
    fn unaccounted_ns(&self, now_ns: u64) -> u64 {
        self.since_last_frame_ns(now_ns).min(now_ns.saturating_sub(self.accounted_ns))
    }

    /// The length of the silence in seconds, if it is long enough for an event.
    fn long_silence_s(&mut self, now_ns: u64) -> Option<f64> {
        let silent_ns = self.since_last_frame_ns(now_ns);
        if silent_ns < self.longest_ns || self.n_events == EVENTS_MAX {
            return None;
        }
        self.n_events += 1;
        Some(silent_ns as f64 * 1e-9)
    }

    fn frame(&mut self, arrival_ns: u64) -> Option<f64> {
        let lasted = self.long_silence_s(arrival_ns);
        self.last_arrival_ns = Some(arrival_ns);
        lasted
    }
}

impl Intake {
    /// Ends a silence with a frame. `is_explained`: another event explains the silence.
    pub(super) fn end_silence(&mut self, device_ticks: u64, arrival_ns: u64, is_explained: bool) {
        if let Some(silent_s) = self.silence.frame(arrival_ns)
            && !is_explained
        {
            self.silence_event(silent_s, device_ticks, arrival_ns);
        }
    }

    /// At the end of a take: if the device is disconnected or has long been silent, the frames due since the last one,
    /// by the host's clock, count as the take's loss.
    pub(super) fn count_absence(&mut self, now_ns: u64) {
        let until_ns = self.due_until_ns.map_or(now_ns, |due_ns| due_ns.min(now_ns));
        let silent_ns = if self.is_away {
            self.silence.since_last_frame_ns(until_ns)
        } else if let Some(silent_s) = self.silence.long_silence_s(until_ns) {
            self.silence_event(silent_s, 0, until_ns);
            self.silence.unaccounted_ns(until_ns)
        } else {
            return;
        };
        // The final report accounts for every frame.
        if self.counts.ended {
            return;
        }
        let new = self.frames_due(silent_ns as f64 * 1e-9).saturating_sub(self.rows_away);
        self.rows_away += new;
        if self.is_away {
            self.counts.lost_to_outage(new);
        } else {
            self.counts.lost_to_silence(new);
        }
        self.pending.add(new, LossCauses::DISCONNECTED);
    }

    fn silence_event(&mut self, silent_s: f64, device_ticks: u64, host_ns: u64) {
        let text = format!("no frame came for {silent_s:.3} s");
        let event = Event::new(EventKind::Host, host_ns, text);
        self.event(Event { device_ticks, ..event });
    }
}

/// A short list of runs of lost rows, without allocation.
#[derive(Debug, Default)]
pub(super) struct PendingLoss {
    runs: [(u64, LossCauses); RUNS_MAX],
    n_runs: usize,
    rows: u64,
    counted: PendingRows,
}

impl PendingLoss {
    pub(super) fn add(&mut self, rows: u64, causes: LossCauses) {
        if rows == 0 {
            return;
        }
        self.rows += rows;
        let counted = if causes.contains(LossCauses::DISCONNECTED) {
            &mut self.counted.in_outages
        } else if causes.contains(LossCauses::RING_FULL) {
            &mut self.counted.ring_full
        } else {
            &mut self.counted.not_received
        };
        *counted += rows;
        match self.runs[..self.n_runs].last_mut() {
            Some(last) if last.1 == causes || self.n_runs == RUNS_MAX => {
                last.0 += rows;
                last.1 = last.1.union(causes);
            }
            _ => {
                self.runs[self.n_runs] = (rows, causes);
                self.n_runs += 1;
            }
        }
    }

    pub(super) fn rows(&self) -> u64 {
        self.rows
    }

    /// The lost rows by counter.
    pub(super) fn counted(&self) -> PendingRows {
        self.counted
    }

    /// Removes the first `rows` rows, and returns them.
    pub(super) fn split_off_first(&mut self, rows: u64) -> Self {
        let all = std::mem::take(self);
        let (mut first, mut left) = (Self::default(), rows);
        for &(n_rows, causes) in &all.runs[..all.n_runs] {
            let n_first = n_rows.min(left);
            left -= n_first;
            first.add(n_first, causes);
            self.add(n_rows - n_first, causes);
        }
        // Runs of several causes do not say which row has which: every counter is divided so that both sums are exact.
        let mut missing = self.rows;
        let counters = |pending: &Self| {
            let PendingRows { not_received, ring_full, in_outages } = pending.counted;
            [not_received, ring_full, in_outages]
        };
        let mut rest = counters(self);
        for (rest, all) in rest.iter_mut().zip(counters(&all)) {
            *rest = (*rest).min(all);
            missing -= *rest;
        }
        for (rest, all) in rest.iter_mut().zip(counters(&all)) {
            let more = missing.min(all - *rest);
            *rest += more;
            missing -= more;
        }
        let of = |[not_received, ring_full, in_outages]: [u64; 3]| PendingRows {
            not_received,
            ring_full,
            in_outages,
        };
        let [a, b, c] = counters(&all);
        first.counted = of([a - rest[0], b - rest[1], c - rest[2]]);
        self.counted = of(rest);
        first
    }

    /// Removes the runs, oldest first.
    pub(super) fn drain(&mut self) -> impl Iterator<Item = (u64, LossCauses)> + use<> {
        let runs = std::mem::take(&mut self.runs);
        self.rows = 0;
        self.counted = PendingRows::default();
        runs.into_iter().take(std::mem::take(&mut self.n_runs))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_merge_and_nothing_is_lost() {
        let mut pending = PendingLoss::default();
        for i in 0..40 {
            let causes = if i % 2 == 0 { LossCauses::NOT_RECEIVED } else { LossCauses::RING_FULL };
            pending.add(3, causes);
        }
        assert_eq!((pending.rows(), pending.n_runs), (120, RUNS_MAX));
        let runs: Vec<_> = pending.drain().collect();
        assert_eq!(runs.iter().map(|run| run.0).sum::<u64>(), 120);
        assert_eq!(runs[7].1, LossCauses::NOT_RECEIVED.union(LossCauses::RING_FULL));
        assert_eq!((pending.rows(), pending.n_runs), (0, 0));
    }
    #[test]
    fn divided_losses_have_the_same_sums() {
        let causes = [
            LossCauses::NOT_RECEIVED,
            LossCauses::RING_FULL,
            LossCauses::DISCONNECTED,
            LossCauses::NOT_RECEIVED.union(LossCauses::DISCONNECTED),
        ];
        // Few runs, and more than are kept apart.
        for n_runs in [1, 3, 40] {
            let build = || {
                let mut pending = PendingLoss::default();
                (0..n_runs).for_each(|i| pending.add(1 + i % 3, causes[i as usize % 4]));
                pending
            };
            let all = build().rows();
            for at in 0..=all + 1 {
                let (mut rest, whole) = (build(), build().counted);
                let mut first = rest.split_off_first(at);
                assert_eq!((first.rows(), rest.rows()), (at.min(all), all - at.min(all)));
                let (a, b) = (first.counted(), rest.counted());
                let sum = |n: PendingRows| n.not_received + n.ring_full + n.in_outages;
                assert_eq!((sum(a), sum(b)), (first.rows(), rest.rows()), "{n_runs}, {at}");
                assert_eq!(a.not_received + b.not_received, whole.not_received);
                assert_eq!(a.ring_full + b.ring_full, whole.ring_full);
                assert_eq!(a.in_outages + b.in_outages, whole.in_outages);
                let rows =
                    |pending: &mut PendingLoss| pending.drain().map(|run| run.0).sum::<u64>();
                assert_eq!((rows(&mut first), rows(&mut rest)), (at.min(all), all - at.min(all)));
            }
        }
    }
}

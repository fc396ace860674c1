//! The ledger of a recovered take, from the last ledger of the damaged file and from the stretches after it.

use crate::{
    damage::LostRows,
    record::Ledger,
    stretch::Stretch,
    timeline::{LossCauses, RowRun},
};

/// Rows by outcome, counted from the stretches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct RowCounts {
    recorded: u64,
    not_received: u64,
    ring_full: u64,
    disconnected: u64,
    /// Damaged in a file that this one was recovered from.
    damaged: u64,
}

impl RowCounts {
    fn add(&mut self, run: &RowRun) {
        let counter = match run.lost {
            None => &mut self.recorded,
            Some(causes) if causes.contains(LossCauses::DAMAGED) => &mut self.damaged,
            // A run with several causes does not say how many rows each cause has. It counts for the first cause here
            // that it names. The counters of a ledger are exact and are used where a ledger exists.
            Some(causes) if causes.contains(LossCauses::NOT_RECEIVED) => &mut self.not_received,
            Some(causes) if causes.contains(LossCauses::RING_FULL) => &mut self.ring_full,
            Some(_) => &mut self.disconnected,
        };
        *counter = counter.saturating_add(run.rows);
    }

    fn since(self, before: Self) -> Self {
        Self {
            recorded: self.recorded - before.recorded,
            not_received: self.not_received - before.not_received,
            ring_full: self.ring_full - before.ring_full,
            disconnected: self.disconnected - before.disconnected,
            damaged: self.damaged - before.damaged,
        }
    }

    fn sum(self) -> u64 {
        let lost = [self.not_received, self.ring_full, self.disconnected, self.damaged];
        lost.iter().fold(self.recorded, |sum, &n| sum.saturating_add(n))
    }
}

/// Counts rows and samples while the file is read.
#[derive(Debug, Clone, Default)]
pub(crate) struct LedgerTally {
    rows: RowCounts,
    announced: u64,
    present: u64,
    /// The counts at the last ledger.
    at_ledger: RowCounts,
}

impl LedgerTally {
    /// Adds a stretch that is kept, with the number of channels announced and of samples decoded.
    pub(super) fn add_stretch(&mut self, stretch: &Stretch<'_>, n_channels: usize, samples: u64) {
        let recorded = [RowRun { rows: stretch.span.n_rows.into(), lost: None }];
        let runs = stretch.timeline.as_ref().map_or(&recorded[..], |timeline| &timeline.runs);
        self.add_runs(runs, n_channels, samples);
    }

    /// Adds runs of rows in which `n_channels` channels are announced and have `samples` samples.
    pub(crate) fn add_runs(&mut self, runs: &[RowRun], n_channels: usize, samples: u64) {
        let before = self.rows.recorded;
        runs.iter().for_each(|run| self.rows.add(run));
        let recorded = self.rows.recorded - before;
        self.announced = self.announced.saturating_add(recorded.saturating_mul(n_channels as u64));
        self.present = self.present.saturating_add(samples);
    }

    /// Remembers the counts at a ledger.
    pub(super) fn mark_ledger(&mut self) {
        self.at_ledger = self.rows;
    }

    /// Recorded frames in the stretches that are kept.
    pub(super) fn recorded(&self) -> u64 {
        self.rows.recorded
    }

    /// The ledger of what is kept, given the `last` ledger of the file and the rows `lost` to damage in it.
    ///
    /// The last ledger's counts are kept, except that frames it counts as recorded but that are not kept count as
    /// lost. Damaged rows after it count as lost, too.
    pub(crate) fn close(&self, last: Option<&Ledger>, lost: &[LostRows]) -> Ledger {
        let (mut ledger, before) = (last.cloned().unwrap_or_default(), self.at_ledger);
        let rows_then = ledger.frames_sent;
        let since = self.rows.since(before);
        let lost_then = ledger.recorded.saturating_sub(before.recorded);
        let rows_after_ledger = |lost: &LostRows| {
            let end = lost.first_row.saturating_add(lost.rows);
            end.saturating_sub(lost.first_row.max(rows_then))
        };
        let lost_since = if ledger.finished { 0 } else { lost.iter().map(rows_after_ledger).sum() };

        let add = |counter: &mut u64, by: u64| *counter = counter.saturating_add(by);
        add(&mut ledger.frames_sent, since.sum());
        add(&mut ledger.frames_sent, lost_since);
        add(&mut ledger.lost_on_link, since.not_received);
        add(&mut ledger.lost_ring_full, since.ring_full);
        add(&mut ledger.unknown_after_disconnect, since.disconnected);
        add(&mut ledger.lost_other, since.damaged);
        add(&mut ledger.lost_other, lost_then);
        add(&mut ledger.lost_other, lost_since);
        ledger.recorded = self.rows.recorded;
        ledger.samples_announced = self.announced.max(self.present);
        ledger.samples_present = self.present;
        ledger.samples_occluded = ledger.samples_announced - self.present;
        ledger.samples_not_finite = ledger.samples_not_finite.min(ledger.samples_occluded);
        ledger.finished = true;
        ledger
    }
}

//! Rows lost since the last recorded one, waiting for the next.

use mocapd_take::timeline::Causes;

use crate::pipeline::{counts::PendingRows, plan::RUNS_MAX};

/// A short list of runs, in place.
#[derive(Debug, Default)]
pub(super) struct Pending {
    runs: [(u64, Causes); RUNS_MAX],
    n_runs: usize,
    rows: u64,
    counted: PendingRows,
}

impl Pending {
    pub(super) fn add(&mut self, rows: u64, causes: Causes) {
        if rows == 0 {
            return;
        }
        self.rows += rows;
        let counted = if causes.contains(Causes::DISCONNECTED) {
            &mut self.counted.in_outages
        } else if causes.contains(Causes::RING_FULL) {
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

    /// The same, by what counted them.
    pub(super) fn counted(&self) -> PendingRows {
        self.counted
    }

    /// The runs, oldest first; none are left.
    pub(super) fn drain(&mut self) -> impl Iterator<Item = (u64, Causes)> + use<> {
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
        let mut pending = Pending::default();
        for i in 0..40 {
            let causes = if i % 2 == 0 { Causes::NOT_RECEIVED } else { Causes::RING_FULL };
            pending.add(3, causes);
        }
        assert_eq!((pending.rows(), pending.n_runs), (120, RUNS_MAX));
        let runs: Vec<_> = pending.drain().collect();
        assert_eq!(runs.iter().map(|run| run.0).sum::<u64>(), 120);
        assert_eq!(runs[7].1, Causes::NOT_RECEIVED.union(Causes::RING_FULL));
        assert_eq!((pending.rows(), pending.n_runs), (0, 0));
    }
}

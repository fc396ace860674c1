//! The verdict on a take that was read to its end, for `verify` and for the service's check.

use std::fmt;

use mocapd_take::{damage::Problem, record::Ledger};

use crate::{clock::LineDeviation, inspect::Summary};

/// The result of checking a take.
#[derive(Debug)]
pub struct Verdict<'a> {
    /// What is damaged or missing; empty for an intact take.
    pub problems: Vec<Finding<'a>>,
    /// Statements of the take about itself that its own data contradicts, one sentence each, in bytes that are intact.
    pub contradictions: Vec<String>,
    /// How far the stored clock line is from the line fitted to the stored observations.
    pub clock: Option<LineDeviation>,
}

/// One defect of a take.
#[derive(Debug)]
pub enum Finding<'a> {
    /// A damaged part.
    Damage(&'a Problem),
    /// The last ledger does not close.
    LedgerOpen,
    /// The last ledger of a group of sampled channels does not close.
    SampleLedgerOpen {
        /// Number of the group.
        group: u32,
    },
    /// The last ledger states another number of samples than the take holds.
    Samples {
        /// Samples that the ledger states.
        stated: u64,
        /// Samples found in the take.
        found: u64,
    },
}

impl fmt::Display for Finding<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Damage(problem) => problem.fmt(f),
            Self::LedgerOpen => f.write_str("the ledger does not close"),
            Self::SampleLedgerOpen { group } => {
                write!(f, "the ledger of the samples of group {group} does not close")
            }
            Self::Samples { stated, found } => {
                write!(f, "the ledger states {stated} samples, but the take holds {found}")
            }
        }
    }
}

impl<'a> Verdict<'a> {
    /// Checks a take that was read.
    #[must_use]
    pub fn of(summary: &'a Summary) -> Self {
        let take = &summary.take;
        // Problems of the ledger come before damage: a long list of damage is shown in part.
        let mut problems = Vec::new();
        if take.ledger.as_ref().is_some_and(|ledger| !Ledger::closes(ledger)) {
            problems.push(Finding::LedgerOpen);
        }
        let groups = take.sample_ledger.iter().flat_map(|ledger| &ledger.groups);
        let open = groups.filter(|group| !group.closes());
        problems.extend(open.map(|group| Finding::SampleLedgerOpen { group: group.group }));
        // In an undamaged take every ledger was compared already, and a difference is a contradiction.
        if let Some(&Ledger { samples_present: stated, .. }) = take.ledger.as_ref()
            && (take.finished && take.damaged)
            && stated != summary.samples()
        {
            problems.push(Finding::Samples { stated, found: summary.samples() });
        }
        problems.extend(take.problems.iter().map(Finding::Damage));
        let mut contradictions = summary.contradictions().to_vec();
        let clock = summary.clock_deviation();
        if let Some(LineDeviation { offset_us, drift_ppm, agrees: false }) = &clock {
            contradictions.push(format!(
                "the clock line differs by {offset_us:.1} us and {drift_ppm:.3} ppm from the line fitted to its observations"
            ));
        }
        Self { problems, contradictions, clock }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problems_of(summary: &Summary) -> Vec<String> {
        Verdict::of(summary).problems.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_ledger_that_does_not_close_is_a_problem_before_the_end_too() {
        let mut summary = Summary::default();
        assert_eq!(problems_of(&summary), [""; 0], "no ledger");
        summary.take.ledger = Some(Ledger { recorded: 1, ..Ledger::default() });
        for finished in [false, true] {
            summary.take.finished = finished;
            assert_eq!(problems_of(&summary), ["the ledger does not close"]);
        }
        assert!(Verdict::of(&summary).contradictions.is_empty());
        // Regardless of other damage.
        let damage = Problem::MissingBefore { row: 7 };
        summary.take.problems = vec![damage.clone(); 2];
        let damage = damage.to_string();
        assert_eq!(problems_of(&summary), ["the ledger does not close", &damage, &damage]);
    }

    #[test]
    fn the_samples_of_a_damaged_take_are_compared_with_its_ledger() {
        let mut summary = Summary::default();
        let ledger = Ledger { samples_announced: 3, samples_present: 3, ..Ledger::default() };
        summary.take.ledger = Some(ledger);
        assert_eq!(problems_of(&summary), [""; 0]);
        (summary.take.finished, summary.take.damaged) = (true, true);
        assert_eq!(problems_of(&summary), ["the ledger states 3 samples, but the take holds 0"]);
    }
}

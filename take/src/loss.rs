//! Rows that stood in a take and are not to be had any more.

use crate::{stretch::Stretch, timeline::Causes};

/// Consecutive rows of which nothing is left.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LostRows {
    /// The first.
    pub first_row: u64,
    /// How many.
    pub rows: u64,
    /// Why.
    pub why: Why,
}

/// Why rows are lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Why {
    /// Their stretch is missing or damaged here, or depends on one that is.
    Damaged,
    /// They were damaged in the file that this take was recovered from.
    BeforeRecovery,
}

/// Follows the stretches of a take that could be read, and keeps the rows between them.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Losses {
    lost: Vec<LostRows>,
    end_row: u64,
    rows_min: u64,
}

impl Losses {
    /// A stretch that was decoded. Gives the rows that are lost before it, or by its own account.
    pub fn stretch(&mut self, stretch: &Stretch<'_>) -> u64 {
        let from_row = stretch.from_row();
        let mut sum = self.push(from_row, Why::Damaged);
        self.end_row = self.end_row.max(from_row);
        let runs = stretch.timeline.iter().flat_map(|timeline| &timeline.runs);
        let mut at = from_row;
        for run in runs {
            let end = at.saturating_add(run.rows);
            if run.lost.is_some_and(|causes| causes.contains(Causes::DAMAGED)) {
                self.end_row = self.end_row.max(at);
                sum += self.push(end, Why::BeforeRecovery);
            }
            at = end;
        }
        self.end_row = self.end_row.max(stretch.span.end_row());
        sum
    }

    /// The take has so many rows at least: those of a stretch that was not decoded, or by its footer.
    pub fn at_least(&mut self, rows: u64) {
        self.rows_min = self.rows_min.max(rows);
    }

    /// No more stretches come. Gives the rows that are known to be lost behind the last.
    pub fn finish(&mut self) -> u64 {
        let lost = self.push(self.rows_min, Why::Damaged);
        self.end_row = self.end_row.max(self.rows_min);
        lost
    }

    /// The row after the last stretch that was decoded.
    #[must_use]
    pub fn end_row(&self) -> u64 {
        self.end_row
    }

    /// The row after the last stretch, decoded or not, as far as is known.
    #[must_use]
    pub fn rows_min(&self) -> u64 {
        self.end_row.max(self.rows_min)
    }

    /// What is lost, in order.
    #[must_use]
    pub fn lost(&self) -> &[LostRows] {
        &self.lost
    }

    /// Rows in all of these.
    #[must_use]
    pub fn rows(&self) -> u64 {
        self.lost.iter().fold(0, |sum, lost| sum.saturating_add(lost.rows))
    }

    /// The rows from the end of what is known to `end`.
    fn push(&mut self, end: u64, why: Why) -> u64 {
        let rows = end.saturating_sub(self.end_row);
        if rows > 0 {
            self.lost.push(LostRows { first_row: self.end_row, rows, why });
        }
        rows
    }
}

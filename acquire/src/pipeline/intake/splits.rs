//! Where a recording is divided into takes.

use crate::pipeline::SplitAt;

/// The next place at which the recording is divided.
#[derive(Debug, Clone, Copy)]
pub(super) enum SplitSchedule {
    Never,
    /// At row `next`, and every so many rows after it, as long as that is before `end`.
    Rows {
        every: u64,
        next: u64,
        end: u64,
    },
    /// Whenever the writer asks.
    OnRequest,
}

impl SplitSchedule {
    pub(super) fn new(at: SplitAt) -> Self {
        match at {
            SplitAt::Rows { rows, end_row } => {
                let every = rows.max(1);
                Self::Rows { every, next: every, end: end_row.unwrap_or(u64::MAX) }
            }
            SplitAt::Bytes(_) => Self::OnRequest,
        }
    }

    /// Whether a division is due at or before this row; by size, the writer decides.
    pub(super) fn is_due(self, row: u64) -> bool {
        matches!(self, Self::Rows { next, end, .. } if row >= next && next < end)
    }

    /// If a frame of this row begins a new take: that take's first row, which lies before `row` if lost frames lie
    /// between. `is_asked`: the writer has asked for a new take.
    pub(super) fn take_due(&mut self, row: u64, is_asked: bool) -> Option<u64> {
        let is_due = self.is_due(row);
        match self {
            Self::Never => None,
            Self::Rows { every, next, .. } => is_due.then(|| {
                let first_row = *next;
                // Skips divisions that lie within a loss: a take without a frame would be empty.
                *next = (row / *every).saturating_add(1).saturating_mul(*every);
                first_row
            }),
            Self::OnRequest => is_asked.then_some(row),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn takes_end_at_multiples_and_none_is_empty() {
        let mut splits = SplitSchedule::new(SplitAt::Rows { rows: 10, end_row: Some(60) });
        let firsts = |splits: &mut SplitSchedule, rows: &[u64]| -> Vec<Option<u64>> {
            rows.iter().map(|&row| splits.take_due(row, true)).collect()
        };
        assert_eq!(firsts(&mut splits, &[0, 9, 10, 11]), [None, None, Some(10), None]);
        // Three places lie in a gap: the first counts, and the next is after the frame.
        assert_eq!(firsts(&mut splits, &[19, 47, 49, 50]), [None, Some(20), None, Some(50)]);
        assert_eq!(firsts(&mut splits, &[60, 75]), [None, None], "the recording ends there");
        let mut never = SplitSchedule::Never;
        assert_eq!(firsts(&mut never, &[0, 10]), [None, None]);
        let mut asked = SplitSchedule::new(SplitAt::Bytes(1));
        assert_eq!([asked.take_due(7, false), asked.take_due(8, true)], [None, Some(8)]);
    }
}

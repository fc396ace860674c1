//! Dividing a recording into takes that follow each other, with each frame in exactly one of them.
//!
//! The reader decides where: at a row, or, for a limit of bytes, at the first end of a stretch after the writer has
//! found the take long enough. It sends a boundary behind the last row of the take, and the next stretch is a key. When
//! the writer reaches the boundary, it ends the take and begins the next one.
//!
//! That costs the disk a new file and a few syncs, and no frame: meanwhile up to 64 encoded stretches wait
//! (`ENCODED_STRETCHES` in `plan.rs`), as when a disk stalls. At two stretches a second that is 32 s. Each take adds a
//! boundary and a short stretch, so with takes of one second it is 16 s.

use std::fmt;

use crossbeam_channel::Sender;

use super::{NewTake, TakeResult};

/// When a take of a divided recording is long enough.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SplitAt {
    /// At each multiple of a number of rows, lost ones included. If no frame came between two of them, the take
    /// continues to the next: no take is without a frame.
    Rows {
        /// Rows of a take, at least those of a stretch.
        rows: u64,
        /// From this row on, nothing is divided: the recording ends there, and frames that come until the device has
        /// stopped belong to the last take.
        end_row: Option<u64>,
    },
    /// At the first end of a stretch at which the file has this many bytes. Stretches that are being encoded at that
    /// moment still belong to it: usually one.
    Bytes(u64),
}

/// A take of a divided recording.
#[derive(Debug)]
pub struct NextTake {
    /// The take.
    pub take: NewTake,
    /// Its name, which the ending of the take before it states.
    pub name: String,
    /// Receives its result; has room for it.
    pub ended: Sender<TakeResult>,
    /// A message for the user about it.
    pub notice: Option<String>,
}

/// Creates the takes of a divided recording, in order.
pub trait TakeSeries: Send {
    /// Creates the take that begins at this row of the recording. Runs on the writer's thread: it may wait for the
    /// disk, but for nothing else.
    ///
    /// # Errors
    /// When its file cannot be created. The take before it then continues, and the next one is tried when that is due.
    fn next_take(&mut self, first_row: u64) -> anyhow::Result<NextTake>;
}

impl fmt::Debug for dyn TakeSeries {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("TakeSeries")
    }
}

/// How to divide a recording.
#[derive(Debug)]
pub struct Split {
    /// When a take is long enough.
    pub at: SplitAt,
    /// Creates the takes.
    pub takes: Box<dyn TakeSeries>,
}

/// The next place at which the recording is divided.
#[derive(Debug, Clone, Copy)]
pub(super) enum SplitSchedule {
    Never,
    /// At row `next`, and every `every` rows after it, as long as that is before `end`.
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
    fn takes_end_at_multiples_and_are_never_empty() {
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

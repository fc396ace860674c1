//! The time line: when each row was exposed and when it reached the host, or why it is empty.

mod coder;
mod predict;
#[cfg(test)]
mod tests;

pub use self::coder::TimelineEncoder;
pub(crate) use self::coder::{TimelineDecoder, take_times};

/// Why rows are empty: a set, because one stretch of loss can have several causes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Causes(pub u8);

impl Causes {
    /// Never arrived: lost on the link, or dropped by the device (the ledger tells which).
    pub const NOT_RECEIVED: Self = Self(1);
    /// Arrived when a ring was full.
    pub const RING_FULL: Self = Self(2);
    /// The device was gone.
    pub const DISCONNECTED: Self = Self(4);
    /// They were recorded, and damaged in the file that this take was recovered from.
    pub const DAMAGED: Self = Self(8);

    /// Whether all of `other` are among these.
    #[must_use]
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// Consecutive rows of one fate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Run {
    /// How many rows.
    pub rows: u64,
    /// Why they are empty; `None` when they were recorded.
    pub lost: Option<Causes>,
}

/// When one recorded row happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RowTime {
    /// Device clock at exposure.
    pub device_ticks: u64,
    /// Host monotonic clock at arrival, in units of 10 microseconds. In a take it is kept to within half
    /// of its step: 80 to 320 microseconds.
    pub arrival_10us: u64,
    /// Hours, minutes, seconds, frames.
    pub timecode: Option<[u8; 4]>,
}

/// The rows from the end of one stretch to the end of the next.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Timeline {
    /// First row, recorded or lost.
    pub first_row: u64,
    /// What became of the rows, in order.
    pub runs: Vec<Run>,
    /// The recorded ones.
    pub times: Vec<RowTime>,
}

impl Timeline {
    /// Empties it for reuse.
    pub fn restart(&mut self, first_row: u64) {
        self.first_row = first_row;
        self.runs.clear();
        self.times.clear();
    }

    /// Adds one recorded row.
    pub fn push(&mut self, time: RowTime) {
        self.extend_run(1, None);
        self.times.push(time);
    }

    /// Adds lost rows.
    pub fn push_lost(&mut self, rows: u64, causes: Causes) {
        self.extend_run(rows, Some(causes));
    }

    /// Adds a run of rows that were damaged before a recovery; of none, too, which says that only numbers are.
    pub(crate) fn push_damaged(&mut self, rows: u64) {
        self.runs.push(Run { rows, lost: Some(Causes::DAMAGED) });
    }

    /// Rows in all.
    #[must_use]
    pub fn n_rows(&self) -> u64 {
        self.runs.iter().fold(0, |sum, run| sum.saturating_add(run.rows))
    }

    /// Recorded rows in all.
    #[must_use]
    pub fn n_recorded(&self) -> u64 {
        let recorded = self.runs.iter().filter(|run| run.lost.is_none());
        recorded.fold(0, |sum, run| sum.saturating_add(run.rows))
    }

    /// The recorded rows with their numbers.
    pub fn recorded(&self) -> impl Iterator<Item = (u64, RowTime)> + Clone + '_ {
        let mut at = self.first_row;
        let rows = self.runs.iter().flat_map(move |run| {
            let first = at;
            at = at.saturating_add(run.rows);
            first..if run.lost.is_none() { at } else { first }
        });
        rows.zip(self.times.iter().copied())
    }

    fn extend_run(&mut self, rows: u64, lost: Option<Causes>) {
        match self.runs.last_mut() {
            Some(last) if last.lost == lost => last.rows += rows,
            _ if rows > 0 => self.runs.push(Run { rows, lost }),
            _ => {}
        }
    }
}

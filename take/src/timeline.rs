//! The time line: the exposure and arrival of each row, or the cause of its loss.

mod coder;
mod predict;
#[cfg(test)]
mod tests;

pub use self::coder::TimelineEncoder;
pub(crate) use self::{
    coder::{TimelineDecoder, take_times},
    predict::ResidualModel,
};

/// Causes of lost rows; a set, because a run of lost rows can have several.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LossCauses(pub u8);

impl LossCauses {
    /// Never arrived: lost on the link or dropped by the device; the ledger has the counts of each.
    pub const NOT_RECEIVED: Self = Self(1);
    /// Arrived while a ring buffer was full.
    pub const RING_FULL: Self = Self(2);
    /// The device was disconnected.
    pub const DISCONNECTED: Self = Self(4);
    /// Recorded, but damaged in the file that this take was recovered from.
    pub const DAMAGED: Self = Self(8);
    /// Dropped by the device, by its numbers of batches. Of samples only: 16 is reserved.
    pub const DROPPED_BY_DEVICE: Self = Self(32);

    /// Whether all causes in `other` are among these.
    #[must_use]
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// All causes of both sets.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// Consecutive rows with the same outcome.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RowRun {
    /// Number of rows.
    pub rows: u64,
    /// The causes of the loss; `None` for recorded rows.
    pub lost: Option<LossCauses>,
}

/// The times of one recorded row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RowTime {
    /// Device time at exposure, in ticks.
    pub device_ticks: u64,
    /// Host monotonic time of arrival, in units of 10 microseconds. A take stores it to within half a quantisation
    /// step: 80 to 320 microseconds.
    pub arrival_10us: u64,
    /// Timecode: hours, minutes, seconds, frames.
    pub timecode: Option<[u8; 4]>,
}

/// The time line of the rows from the end of one stretch to the end of the next.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Timeline {
    /// First row, recorded or lost.
    pub first_row: u64,
    /// Runs of recorded and lost rows, in order.
    pub runs: Vec<RowRun>,
    /// The times of the recorded rows.
    pub times: Vec<RowTime>,
}

impl Timeline {
    /// Clears the time line for reuse.
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
    pub fn push_lost(&mut self, rows: u64, causes: LossCauses) {
        self.extend_run(rows, Some(causes));
    }

    /// Adds a run of rows that were damaged before a recovery; none if only stretch numbers are missing.
    pub(crate) fn push_damaged(&mut self, rows: u64) {
        if rows > 0 {
            self.runs.push(RowRun { rows, lost: Some(LossCauses::DAMAGED) });
        }
    }

    /// Number of rows.
    #[must_use]
    pub fn n_rows(&self) -> u64 {
        self.runs.iter().fold(0, |sum, run| sum.saturating_add(run.rows))
    }

    /// Number of recorded rows.
    #[must_use]
    pub fn n_recorded(&self) -> u64 {
        let recorded = self.runs.iter().filter(|run| run.lost.is_none());
        recorded.fold(0, |sum, run| sum.saturating_add(run.rows))
    }

    /// Numbers and times of the recorded rows.
    pub fn recorded(&self) -> impl Iterator<Item = (u64, RowTime)> + Clone + '_ {
        let mut at = self.first_row;
        let rows = self.runs.iter().flat_map(move |run| {
            let first = at;
            at = at.saturating_add(run.rows);
            first..if run.lost.is_none() { at } else { first }
        });
        rows.zip(self.times.iter().copied())
    }

    /// The time line of the rows `rows` only.
    pub(crate) fn part(&self, rows: std::ops::Range<u64>) -> Self {
        let mut part = Self { first_row: self.first_row.max(rows.start), ..Self::default() };
        let mut at = self.first_row;
        for run in &self.runs {
            let end = at.saturating_add(run.rows);
            let inside = end.min(rows.end).saturating_sub(at.max(rows.start));
            if inside > 0 {
                part.runs.push(RowRun { rows: inside, lost: run.lost });
            }
            at = end;
        }
        let inside = self.recorded().filter(|(row, _)| rows.contains(row));
        part.times.extend(inside.map(|(_, time)| time));
        part
    }

    fn extend_run(&mut self, rows: u64, lost: Option<LossCauses>) {
        match self.runs.last_mut() {
            Some(last) if last.lost == lost => last.rows += rows,
            _ if rows > 0 => self.runs.push(RowRun { rows, lost }),
            _ => {}
        }
    }
}

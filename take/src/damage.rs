//! What is wrong with a take: its problems, and the rows that are not to be had any more.

use crate::{index::IndexEntry, record::Ledger, stretch::Stretch, timeline::Causes};

/// Problems that are kept. A take that a disk has ruined has one a stretch; a file that was made to have more would
/// have one every few bytes.
pub const PROBLEMS_MAX: usize = 10_000;

/// Something that is missing, damaged, or not as the take says.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// The magic was damaged, and [put right](crate::recovery::mend_start).
    #[error("the eight bytes that a take begins with were damaged")]
    Magic,
    /// A byte of the header at this file offset was damaged, and [put right](crate::recovery::mend_start).
    #[error("byte {0}, in the header, was damaged; the checksum told what it was")]
    HeaderByte(u64),
    /// Bytes that are no chunk, or a chunk whose content is wrong.
    #[error("{len} bytes at byte {offset}: {message}")]
    Damaged {
        /// File offset.
        offset: u64,
        /// How many bytes.
        len: u64,
        /// What is wrong.
        message: String,
    },
    /// Type or length of a chunk were damaged, and put right.
    #[error("the head of the chunk at byte {offset} is damaged; its content is whole")]
    Mended {
        /// File offset of the chunk.
        offset: u64,
    },
    /// Entries of the channel table are lost.
    #[error("the names of {markers} markers are lost")]
    NamesLost {
        /// Of how many markers.
        markers: usize,
    },
    /// Stretches are missing, and no damaged bytes are in their place.
    #[error("stretches before frame {row} are missing")]
    MissingBefore {
        /// First row of the stretch behind them.
        row: u64,
    },
    /// The same, and the stretch behind them does not say where it lies.
    #[error("stretches from frame {row} on are missing")]
    MissingFrom {
        /// The first row that they may have had.
        row: u64,
    },
    /// A stretch that goes on from one that is lost: nobody knows which rows it has.
    #[error(
        "a stretch of {n_rows} frames, from frame {from_row} or later: it depends on a damaged one"
    )]
    Unplaced {
        /// How many rows it has.
        n_rows: u32,
        /// The first row that it may have.
        from_row: u64,
    },
    /// A stretch that is there, and whose rows are not to be had.
    #[error("the stretch of frames {first_row} to {}: {refusal}",
        first_row.saturating_add(u64::from(*n_rows)).saturating_sub(1))]
    Refused {
        /// Its first row.
        first_row: u64,
        /// How many it has.
        n_rows: u32,
        /// Why.
        refusal: Refusal,
    },
    /// The index tells of another row where a key stretch is.
    #[error("the index tells of frame {told} where the stretch of frame {found} is")]
    IndexRow {
        /// Its first row, as the index says.
        told: u64,
        /// As it says itself.
        found: u64,
    },
    /// The footer tells of another number of rows.
    #[error("the footer tells of {told} frames, {found} were found")]
    FooterRows {
        /// Rows, as it says.
        told: u64,
        /// Rows that were found.
        found: u64,
    },
    /// The last ledger tells of other numbers than a whole take has.
    #[error("its ledger tells of {} frames and {} samples, in the file are {} and {}: it is counted again",
        told.frames, told.samples, found.frames, found.samples)]
    LedgerCounts {
        /// As it says.
        told: Counts,
        /// As they were found.
        found: Counts,
    },
    /// A foreign part that was left out.
    #[error("{kind}: more foreign data than a take can hold")]
    ForeignTooLong {
        /// What it is.
        kind: String,
    },
    /// There are more than [`PROBLEMS_MAX`].
    #[error("there are more problems than these {PROBLEMS_MAX}")]
    More,
    /// It was finished, and there is no ledger.
    #[error("the ledger is missing")]
    NoLedger,
    /// There is no footer.
    #[error("the take was cut off: its end is missing")]
    CutOff,
}

/// Why the rows of a stretch that is there are not to be had.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Another stretch had its rows.
    #[error("it comes twice")]
    Twice,
    /// It goes on from one whose rows are not to be had.
    #[error("it depends on a damaged one")]
    DependsOnLost,
    /// Its blocks cannot be decoded.
    #[error("{0}")]
    Undecodable(String),
}

/// What ledgers count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Counts {
    /// Recorded frames.
    pub frames: u64,
    /// Samples in them.
    pub samples: u64,
}

impl Counts {
    pub(crate) fn of(ledger: &Ledger) -> Self {
        Self { frames: ledger.recorded, samples: ledger.samples_present }
    }
}

impl Problem {
    /// Whether it may show only when samples are decoded.
    pub(crate) fn is_of_decoding(&self) -> bool {
        matches!(
            self,
            Self::Refused { refusal: Refusal::DependsOnLost | Refusal::Undecodable(_), .. }
        )
    }
}

/// Adds a problem, if there are not too many already; the last one then says that there are more. That a take was cut
/// off is added in any case.
pub(crate) fn note(problems: &mut Vec<Problem>, problem: Problem) {
    if problems.len() < PROBLEMS_MAX || problem == Problem::CutOff {
        problems.push(problem);
    } else if problems.len() == PROBLEMS_MAX {
        problems.push(Problem::More);
    }
}

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

/// Follows the stretches of a take that could be read, and the rows between them.
#[derive(Debug)]
pub(crate) struct Losses {
    /// What is lost, where that is kept.
    pub(crate) lost: Option<Vec<LostRows>>,
    /// The row after the last stretch that was read.
    pub(crate) end_row: u64,
    /// The key that was sought, and not met yet: what lies before it was passed over.
    pub(crate) sought: Option<IndexEntry>,
    rows_min: u64,
}

impl Losses {
    /// Of a take from its start; the rows between are kept if `lost` is a list.
    pub(crate) fn new(lost: Option<Vec<LostRows>>) -> Self {
        Self { lost, end_row: 0, sought: None, rows_min: 0 }
    }

    /// What comes next is a key stretch.
    pub(crate) fn seek(&mut self, key: IndexEntry) {
        self.sought = Some(key);
        self.at_least(key.first_row);
    }

    /// Whether the stretch at file offset `offset` has rows that were read or passed over, or accounts for such rows as lost.
    ///
    /// How far the account of those passed over went is known to the sought key itself, which tells of rows lost before it.
    pub(crate) fn has(&mut self, offset: u64, stretch: &Stretch<'_>) -> bool {
        let from_row = stretch.from_row();
        if self.sought.is_some_and(|key| key.offset == offset) && stretch.span.key {
            self.sought = None;
            self.end_row = self.end_row.max(from_row);
        }
        let is_passed = |key: IndexEntry| stretch.span.first_row < key.first_row;
        from_row < self.end_row || self.sought.is_some_and(is_passed)
    }

    /// A stretch that was read. Gives the rows that are lost before it, or by its own account.
    pub(crate) fn stretch(&mut self, stretch: &Stretch<'_>) -> u64 {
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

    /// The take has so many rows at least: those of a stretch that was not read, or by its footer.
    pub(crate) fn at_least(&mut self, rows: u64) {
        self.rows_min = self.rows_min.max(rows);
    }

    /// No more stretches come. Gives the rows that are known to be lost behind the last.
    pub(crate) fn finish(&mut self) -> u64 {
        let lost = self.push(self.rows_min, Why::Damaged);
        self.end_row = self.end_row.max(self.rows_min);
        lost
    }

    /// The row after the last stretch, read or not, as far as is known.
    pub(crate) fn rows_min(&self) -> u64 {
        self.end_row.max(self.rows_min)
    }

    /// The rows from the end of what is known to `end`.
    fn push(&mut self, end: u64, why: Why) -> u64 {
        let rows = end.saturating_sub(self.end_row);
        let Some(lost) = self.lost.as_mut().filter(|_| rows > 0) else { return rows };
        match lost.last_mut() {
            // A file of two bytes a run could else claim a list of twelve times its size.
            Some(last) if last.first_row + last.rows == self.end_row && last.why == why => {
                last.rows += rows;
            }
            _ => lost.push(LostRows { first_row: self.end_row, rows, why }),
        }
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_ends_and_says_so() {
        let mut problems = Vec::new();
        (0..2 * PROBLEMS_MAX as u64).for_each(|i| note(&mut problems, Problem::HeaderByte(i)));
        assert_eq!(problems.len(), PROBLEMS_MAX + 1);
        assert_eq!(problems[PROBLEMS_MAX - 1], Problem::HeaderByte(PROBLEMS_MAX as u64 - 1));
        assert_eq!(problems[PROBLEMS_MAX], Problem::More);
    }
}

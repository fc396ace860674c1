//! The problems of a damaged take, and its lost rows.

use crate::{
    index::IndexEntry,
    interchange::c3d::columns::RESIDUALS,
    record::Ledger,
    sampled::{LostSamples, is_recorded, part_name},
    stretch::Stretch,
    timeline::LossCauses,
};

/// Maximum number of problems that a list keeps. A take on a failing disk has one problem per stretch; a crafted file
/// could have one every few bytes.
pub const PROBLEMS_MAX: usize = 10_000;

/// Something missing, damaged or inconsistent in a take.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// The magic was damaged and has been [repaired](crate::recovery::repair_start).
    #[error("the signature of the take was damaged; it has been repaired")]
    Magic,
    /// A byte of the header, at this file offset, was damaged and has been [repaired](crate::recovery::repair_start).
    #[error("byte {0}, in the header, was damaged; the checksum restored it")]
    HeaderByte(u64),
    /// Bytes that are not a chunk, or a chunk with invalid content.
    #[error("{len} bytes at byte {offset}: {message}")]
    Damaged {
        /// File offset.
        offset: u64,
        /// Number of bytes.
        len: u64,
        /// The reason.
        message: String,
    },
    /// The type or length of a chunk was damaged and has been restored.
    #[error("the head of the chunk at byte {offset} is damaged; its content is intact")]
    Repaired {
        /// File offset of the chunk.
        offset: u64,
    },
    /// Entries of the channel table are lost.
    #[error("the names of {markers} markers are lost")]
    NamesLost {
        /// Number of markers concerned.
        markers: usize,
    },
    /// The order of the markers in the source, which the summary states, is missing.
    #[error(
        "the order of the markers in the source is lost: they are in the order in which they were coded; \
         `mocapd recover` restores it"
    )]
    OrderLost,
    /// The summary states another order of the markers.
    #[error("the summary states another order of the markers than the take has")]
    OrderContradicted,
    /// Stretches are missing, with no damaged bytes in their place.
    #[error("stretches before frame {row} are missing")]
    MissingBefore {
        /// First row of the stretch after them.
        row: u64,
    },
    /// Stretches are missing before a stretch that does not state its row.
    #[error("stretches from frame {row} on are missing")]
    MissingFrom {
        /// The first row that may be missing.
        row: u64,
    },
    /// A stretch that continues a lost one, so that its rows are unknown.
    #[error(
        "a stretch of {n_rows} frames, from frame {from_row} or later: it depends on a damaged one"
    )]
    Unplaced {
        /// Number of its rows.
        n_rows: u32,
        /// The first row that it may have.
        from_row: u64,
    },
    /// A stretch whose rows are unavailable.
    #[error("cannot read the stretch of frames {first_row} to {}: {refusal}",
        first_row.saturating_add(u64::from(*n_rows)).saturating_sub(1))]
    Refused {
        /// Its first row.
        first_row: u64,
        /// Number of its rows.
        n_rows: u32,
        /// The reason.
        refusal: Refusal,
    },
    /// The index gives another row for a key stretch.
    #[error("the index gives frame {stated} for the stretch that begins at frame {found}")]
    IndexRow {
        /// First row according to the index.
        stated: u64,
        /// First row according to the stretch.
        found: u64,
    },
    /// The footer gives another number of rows.
    #[error("the footer states {stated} frames, but {found} were found")]
    FooterRows {
        /// Rows according to the footer.
        stated: u64,
        /// Rows found.
        found: u64,
    },
    /// The last ledger of an undamaged take contradicts its content.
    #[error("the ledger states {} frames and {} samples, but the file has {} and {}; they were recounted",
        stated.frames, stated.samples, found.frames, found.samples)]
    LedgerCounts {
        /// Counts in the ledger.
        stated: LedgerTotals,
        /// Counts in the file.
        found: LedgerTotals,
    },
    /// A foreign part was left out.
    #[error("{kind}: more foreign data than a take can hold")]
    ForeignTooLong {
        /// Its kind.
        kind: String,
    },
    /// Samples of sampled channels that are missing, or cannot be decoded.
    #[error("samples {first} to {} of {}, channels {} to {}, are lost; {}",
        first.saturating_add(*n).saturating_sub(1), part_name(kind), channels[0], channels[1], in_place_of_lost(kind))]
    SamplesLost {
        /// The kind of the foreign part.
        kind: String,
        /// The first and the last channel, from 1.
        channels: [u64; 2],
        /// Number of the first sample, from 0.
        first: u64,
        /// Number of samples of each channel.
        n: u64,
    },
    /// A group of sampled channels that a part lacks, so that the part cannot be read.
    #[error("{kind} cannot be read: the description of its channels {} to {} is lost", channels[0], channels[1])]
    DescriptionLost {
        /// The kind of the foreign part.
        kind: String,
        /// The first and the last channel, from 1.
        channels: [u64; 2],
    },
    /// A foreign part whose groups do not fit together.
    #[error(
        "{kind} cannot be read: the descriptions of its channels are incomplete, or do not fit together"
    )]
    PartUnreadable {
        /// Its kind.
        kind: String,
    },
    /// The parameters of an imported file are missing, but its analog samples are not.
    #[error(
        "the parameters of the C3D file are missing: names, units and scales of analog channels are those that the take \
         states for each of them; force plates and all other parameters are lost"
    )]
    ParametersLost,
    /// Samples of a group whose description is lost.
    #[error(
        "{chunks} chunks of sampled channels cannot be read: the description of the channels is lost, or there are more \
         channels or longer names than a reader remembers"
    )]
    SamplesOrphaned {
        /// Number of chunks.
        chunks: u64,
    },
    /// There are more than [`PROBLEMS_MAX`] problems.
    #[error("there are more problems than the {PROBLEMS_MAX} listed")]
    More,
    /// A closed take has no ledger.
    #[error("the ledger is missing")]
    NoLedger,
    /// There is no footer.
    #[error("the take was cut off: its end is missing")]
    CutOff,
}

/// What an export writes in place of lost samples.
fn in_place_of_lost(kind: &str) -> &'static str {
    match kind {
        RESIDUALS => "an export has 0 there",
        kind if is_recorded(kind) => "readers have NaN there",
        _ => "an export has NaN there",
    }
}

/// Why the rows of a stretch are unavailable.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Another stretch has the same rows.
    #[error("it comes twice")]
    Twice,
    /// The stretch continues one whose rows are unavailable.
    #[error("it depends on a damaged one")]
    DependsOnLost,
    /// The blocks cannot be decoded.
    #[error("{0}")]
    Undecodable(String),
}

/// Counts that a ledger and the stretches must agree on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LedgerTotals {
    /// Recorded frames.
    pub frames: u64,
    /// Samples in them.
    pub samples: u64,
}

impl LedgerTotals {
    pub(crate) fn from_ledger(ledger: &Ledger) -> Self {
        Self { frames: ledger.recorded, samples: ledger.samples_present }
    }
}

impl Problem {
    /// Samples of a part that are lost.
    pub(crate) fn of_samples(kind: &str, lost: &LostSamples) -> Self {
        let LostSamples { channels, first, n, .. } = *lost;
        Self::SamplesLost { kind: kind.to_owned(), channels, first, n }
    }

    /// Whether only decoding can reveal the problem.
    pub(crate) fn is_decoding_problem(&self) -> bool {
        let Self::Refused { refusal, .. } = self else { return false };
        matches!(refusal, Refusal::DependsOnLost | Refusal::Undecodable(_))
    }
}

/// Appends a problem. After [`PROBLEMS_MAX`] it appends [`Problem::More`] once, and then only the cut-off.
pub(crate) fn push_problem(problems: &mut Vec<Problem>, problem: Problem) {
    if problems.len() < PROBLEMS_MAX || problem == Problem::CutOff {
        problems.push(problem);
    } else if problems.len() == PROBLEMS_MAX {
        problems.push(Problem::More);
    }
}

/// Consecutive rows that are lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LostRows {
    /// First row.
    pub first_row: u64,
    /// Number of rows.
    pub rows: u64,
    /// The cause.
    pub origin: DamageOrigin,
}

/// What damaged the rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DamageOrigin {
    /// Their stretch is missing or damaged in this file, or depends on such a stretch.
    Damaged,
    /// They were damaged in the file that this take was recovered from.
    BeforeRecovery,
}

/// Tracks the stretches that were read, and the rows lost between them.
#[derive(Debug)]
pub(crate) struct LossTracker {
    /// The lost rows; `None` if they are not collected.
    pub(crate) lost: Option<Vec<LostRows>>,
    /// The row after the last stretch that was read.
    pub(crate) end_row: u64,
    /// The key stretch of a seek, until it is reached; earlier stretches were skipped.
    pub(crate) seek_key: Option<IndexEntry>,
    rows_min: u64,
}

impl LossTracker {
    /// A tracker at the start of a take; it appends lost rows to `lost` if that is a list.
    pub(crate) fn new(lost: Option<Vec<LostRows>>) -> Self {
        Self { lost, end_row: 0, seek_key: None, rows_min: 0 }
    }

    /// The next stretch is this key stretch.
    pub(crate) fn seek(&mut self, key: IndexEntry) {
        self.seek_key = Some(key);
        self.raise_rows_min(key.first_row);
    }

    /// Whether the stretch at file offset `offset` overlaps rows that were read or skipped, or declares such rows lost.
    ///
    /// After a seek, only the key stretch itself states where the rows before it end, because it records the rows lost
    /// before it.
    pub(crate) fn is_repeated(&mut self, offset: u64, stretch: &Stretch<'_>) -> bool {
        let from_row = stretch.from_row();
        if self.seek_key.is_some_and(|key| key.offset == offset) && stretch.span.key {
            self.seek_key = None;
            self.end_row = self.end_row.max(from_row);
        }
        let is_skipped = |key: IndexEntry| stretch.span.first_row < key.first_row;
        from_row < self.end_row || self.seek_key.is_some_and(is_skipped)
    }

    /// Adds a stretch that was read. Returns the rows lost before it, or lost by its own record.
    pub(crate) fn add_stretch(&mut self, stretch: &Stretch<'_>) -> u64 {
        let from_row = stretch.from_row();
        let mut sum = self.push(from_row, DamageOrigin::Damaged);
        self.end_row = self.end_row.max(from_row);
        let runs = stretch.timeline.iter().flat_map(|timeline| &timeline.runs);
        let mut at = from_row;
        for run in runs {
            let end = at.saturating_add(run.rows);
            if run.lost.is_some_and(|causes| causes.contains(LossCauses::DAMAGED)) {
                self.end_row = self.end_row.max(at);
                sum += self.push(end, DamageOrigin::BeforeRecovery);
            }
            at = end;
        }
        self.end_row = self.end_row.max(stretch.span.end_row());
        sum
    }

    /// Raises the least number of rows of the take, from a stretch that was not read or from the footer.
    pub(crate) fn raise_rows_min(&mut self, rows: u64) {
        self.rows_min = self.rows_min.max(rows);
    }

    /// Ends the take. Returns the rows known to be lost after the last stretch.
    pub(crate) fn finish(&mut self) -> u64 {
        let lost = self.push(self.rows_min, DamageOrigin::Damaged);
        self.end_row = self.end_row.max(self.rows_min);
        lost
    }

    /// The row after the last known stretch, read or not.
    pub(crate) fn rows_min(&self) -> u64 {
        self.end_row.max(self.rows_min)
    }

    /// Counts the rows up to `end` as lost.
    fn push(&mut self, end: u64, origin: DamageOrigin) -> u64 {
        let rows = end.saturating_sub(self.end_row);
        let Some(lost) = self.lost.as_mut().filter(|_| rows > 0) else { return rows };
        match lost.last_mut() {
            // Merging keeps the list short: a crafted run of two bytes would otherwise cost twelve times its size.
            Some(last) if last.first_row + last.rows == self.end_row && last.origin == origin => {
                last.rows += rows;
            }
            _ => lost.push(LostRows { first_row: self.end_row, rows, origin }),
        }
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_list_ends_with_more() {
        let mut problems = Vec::new();
        (0..2 * PROBLEMS_MAX as u64)
            .for_each(|i| push_problem(&mut problems, Problem::HeaderByte(i)));
        assert_eq!(problems.len(), PROBLEMS_MAX + 1);
        assert_eq!(problems[PROBLEMS_MAX - 1], Problem::HeaderByte(PROBLEMS_MAX as u64 - 1));
        assert_eq!(problems[PROBLEMS_MAX], Problem::More);
    }
}

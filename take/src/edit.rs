//! Editing takes: [`cut`] copies a range of frames into a new take, [`concat()`] joins takes, [`repack()`] writes a take in
//! fewer bytes. No sample changes.
//!
//! Stretches are copied wherever they do not depend on one that is left out. The rows of a stretch that is only partly
//! kept, or that continues one that is not kept, are encoded again where that gives the same floats, as for whole spans
//! behind a key and rows in which nothing moves; else they are stored as the floats that they decode to
//! (`docs/decisions/0012-the-ends-of-a-cut-are-stored-exactly.md`).

mod concat;
mod cut;
mod foreign;
mod poses;
mod recorded;
mod repack;
mod seam;
#[cfg(test)]
mod tests;

use std::{
    io::{self, Read, Seek},
    sync::Arc,
};

use crate::{
    TakeError, TakeEvent, TakeMap, TakeTraversal,
    chunk::types,
    damage::Problem,
    foreign::content::ScratchFile,
    record::{Clock, SeriesPlace},
    timeline::RowTime,
    traversal::{Decode, LocatedEvent, Progress},
};

pub use self::{
    concat::{ConcatReport, Mismatch, check_joinable, concat},
    cut::{CutReport, cut},
    repack::{REPACK, RepackReport, RepackSettings, check_repacked, repack},
    seam::Seam,
};

/// The key in the settings of HEADER that marks a take cut from another.
pub const CUT: &str = "cut";

/// The key in the settings of HEADER that marks a take joined of others.
pub const CONCAT: &str = "concat";

/// What the caller of an edit provides.
pub struct EditContext<'a> {
    /// Names the program in the new take.
    pub software: &'a str,
    /// Creates the file for foreign parts that are too large for memory.
    pub new_scratch: &'a dyn Fn() -> io::Result<Arc<dyn ScratchFile>>,
    /// Receives the number of rows after each stretch, for a progress display.
    pub on_rows: &'a dyn Fn(u64),
}

impl std::fmt::Debug for EditContext<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("EditContext").field("software", &self.software).finish_non_exhaustive()
    }
}

/// The error for a take that is not whole.
fn damaged(problem: &Problem) -> TakeError {
    TakeError::InvalidArgument(format!(
        "only complete takes can be cut, joined or repacked: use the take that `mocapd recover` writes ({problem})"
    ))
}

/// The number of channels from a row on.
#[derive(Debug, Clone, Copy)]
struct TableSize {
    row: u64,
    n_channels: usize,
}

/// A whole take, without its samples: what an edit knows before it writes.
#[derive(Debug, Default)]
pub struct SourceTake {
    map: TakeMap,
    clocks: Vec<Clock>,
    tables: Vec<TableSize>,
    /// The first and the last recorded row with their times; `None` in an import.
    ends: Option<[(u64, RowTime); 2]>,
    /// Whether a stretch has a time line, as those of a recovered import may.
    has_time_lines: bool,
    /// Types of chunks that this version does not know.
    unknown_chunks: Vec<u8>,
    n_stretches: u64,
}

impl SourceTake {
    /// Reads a take and checks every checksum, without decoding samples.
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`; `InvalidArgument` for a take that is damaged or was cut off.
    pub fn read(input: &mut (impl Read + Seek)) -> Result<Self, TakeError> {
        let source = Self::scan(input)?;
        match source.map.problems.first() {
            Some(problem) => Err(damaged(problem)),
            None => Ok(source),
        }
    }

    /// Reads a take like [`read`](Self::read), but keeps its problems in the map instead of refusing it.
    fn scan(input: &mut (impl Read + Seek)) -> Result<Self, TakeError> {
        let mut source = Self::default();
        let traversal = TakeTraversal::without_decoding(input);
        let Progress { take, .. } = traversal.run(|found, progress| {
            source.visit(found, progress);
            Ok(())
        })?;
        Ok(Self { map: take, ..source })
    }

    /// Everything in the take but its samples.
    #[must_use]
    pub fn map(&self) -> &TakeMap {
        &self.map
    }

    fn visit(&mut self, found: &LocatedEvent<'_>, progress: &Progress) {
        match &found.event {
            TakeEvent::Header(_) | TakeEvent::Channels(_) => self
                .tables
                .push(TableSize { row: progress.end_row(), n_channels: progress.channels().len() }),
            TakeEvent::Clock(clock) => self.clocks.push((**clock).clone()),
            TakeEvent::Stretch(stretch) => {
                self.n_stretches += 1;
                let Some(timeline) = &stretch.timeline else { return };
                self.has_time_lines = true;
                let (first, last) = (timeline.recorded().next(), timeline.recorded().last());
                if let Some((first, last)) = first.zip(last) {
                    let first = self.ends.map_or(first, |ends| ends[0]);
                    self.ends = Some([first, last]);
                }
            }
            TakeEvent::Skipped { kind }
                if *kind != types::INDEX && !self.unknown_chunks.contains(kind) =>
            {
                self.unknown_chunks.push(*kind);
            }
            _ => {}
        }
    }

    /// The size of the channel table for the stretch from `row` on.
    fn channels_at(&self, row: u64) -> usize {
        let n_sizes = self.tables.partition_point(|size| size.row <= row);
        self.tables[..n_sizes].last().map_or(0, |size| size.n_channels)
    }

    /// The number of the first row in the file that the take was imported from.
    fn first_frame(&self) -> u64 {
        self.map.header.source.as_ref().map_or(0, |source| source.first_frame)
    }

    /// Its rows in a divided recording; `None` in other takes.
    fn place(&self) -> Option<SeriesPlace> {
        SeriesPlace::of(&self.map.header, self.map.n_rows)
    }

    /// What an edit leaves out of any take: content whose rows are unknown to this version.
    fn left_out(&self) -> impl Iterator<Item = String> + '_ {
        self.unknown_chunks.iter().map(|kind| format!("chunks of the unknown type {kind:02x}"))
    }

    /// The rows `rows`, extended to stretches that can be copied: from the last key stretch at or before the first row
    /// to the end of the stretch with the last row.
    ///
    /// # Errors
    /// Those of [`TakeTraversal::next_stretch`].
    pub fn whole_stretches(
        &self,
        input: impl Read + Seek,
        rows: &std::ops::Range<u64>,
    ) -> Result<std::ops::Range<u64>, TakeError> {
        let keys = self.map.keys.iter().map(|key| key.first_row);
        let start = keys.take_while(|row| *row <= rows.start).last().unwrap_or(0);
        let mut traversal = TakeTraversal::from_map(input, &self.map, Decode::Groups(Vec::new()))?;
        traversal.seek(rows.end.saturating_sub(1))?;
        while let Some(span) = traversal.next_stretch()? {
            if span.end_row() >= rows.end {
                // The rows lost before a stretch belong to it: they need none of its blocks.
                let end = if span.first_row >= rows.end { rows.end } else { span.end_row() };
                return Ok(start..end);
            }
        }
        Ok(start..rows.end)
    }
}

//! Tables of trajectories in text files: one row per frame with three cells for each marker. TRC, TSV and CSV share
//! this code; they differ in the header, the separator, and the mark for a missing sample.

use std::io;

use super::{
    InterchangeError, Result, counted,
    row_timing::RowTiming,
    text_frames::{RowWriter, TextFrames},
    units::ToMillimetres,
};
use crate::{
    foreign::content::NewScratch,
    motion::{GAP, Position},
};

/// Maximum number of positions to allocate per byte of text: one wide row among many short ones must not cost unbounded
/// memory.
pub(super) const MAX_POSITIONS_PER_BYTE: u64 = 4;

/// The warning for a file whose last number may lack digits.
pub(super) const CUT_OFF: &str = "The file ends in the middle of a line; its last number may be cut off, so that sample is a gap.";

/// The assumed rate of a file with one frame and no stated rate; a C3D file without a rate gets the same.
const RATE_OF_ONE_FRAME_HZ: f64 = 100.0;

/// The rate to assume for a single frame, with a warning.
pub(super) fn rate_of_one_frame(warnings: &mut Vec<String>) -> f64 {
    warnings.push(format!("A single frame has no rate; {RATE_OF_ONE_FRAME_HZ} Hz was assumed."));
    RATE_OF_ONE_FRAME_HZ
}

/// Warns of samples that became gaps because their cells are not three numbers.
pub(super) fn report_damaged(n: usize, warnings: &mut Vec<String>) {
    if n > 0 {
        warnings
            .push(format!("Not three numbers, read as missing: {}.", counted(n as u64, "sample")));
    }
}

/// The content of the three cells of a sample.
pub(super) enum SampleCells {
    /// Three numbers.
    Position([f64; 3]),
    /// All cells are empty.
    Empty,
    /// At least one cell is neither empty nor a number, or only some are empty.
    Damaged,
}

/// Parses the next three cells; cells past the end of the row count as empty.
pub(super) fn parse_sample(cells: &mut dyn Iterator<Item = &[u8]>) -> SampleCells {
    let mut position = [0.0; 3];
    let (mut n_empty, mut is_damaged) = (0, false);
    for value in &mut position {
        match cells.next().map(<[u8]>::trim_ascii) {
            None | Some([]) => n_empty += 1,
            Some(cell) => match super::text::number(cell) {
                Some(number) => *value = number,
                None => is_damaged = true,
            },
        }
    }
    match (is_damaged, n_empty) {
        (true, _) | (false, 1 | 2) => SampleCells::Damaged,
        (false, 0) => SampleCells::Position(position),
        (false, _) => SampleCells::Empty,
    }
}

/// A table under construction, row by row.
pub(super) struct Table<'a> {
    format: &'static str,
    millimetres: ToMillimetres,
    /// Whether `0 0 0` means a missing sample.
    zeros_are_gaps: bool,
    /// The current row.
    row: Vec<Position>,
    /// The last row that ended; it is written after the next one, because its last number may be cut off.
    last: Option<Vec<Position>>,
    rows: RowWriter<'a>,
    n_rows: u64,
    /// The positions of all rows, which may differ in width.
    n_positions: u64,
    /// Bytes of the whole file.
    text_bytes: u64,
    timing: RowTiming,
    /// For each row the number of frames without a row just before it; empty if there are none.
    missing_before: Vec<u64>,
    damaged: usize,
}

impl<'a> Table<'a> {
    pub(super) fn new(
        format: &'static str,
        new_scratch: NewScratch<'a>,
        millimetres: ToMillimetres,
    ) -> Self {
        Self {
            format,
            millimetres,
            zeros_are_gaps: false,
            row: Vec::new(),
            last: None,
            rows: RowWriter::new(new_scratch),
            n_rows: 0,
            n_positions: 0,
            text_bytes: 0,
            timing: RowTiming::default(),
            missing_before: Vec::new(),
            damaged: 0,
        }
    }

    /// Reads `0 0 0` as a missing sample.
    pub(super) fn with_zeros_as_gaps(self) -> Self {
        Self { zeros_are_gaps: true, ..self }
    }

    /// Begins a row with its cells for frame number and time; either may be empty.
    pub(super) fn begin_row(&mut self, number: &[u8], time: &[u8]) {
        self.timing.push(number, time);
    }

    /// Reads the next three cells of the row as a sample. Returns whether they are a position.
    pub(super) fn read_sample(&mut self, cells: &mut dyn Iterator<Item = &[u8]>) -> bool {
        let position = match parse_sample(cells) {
            SampleCells::Position([0.0, 0.0, 0.0]) if self.zeros_are_gaps => Some(GAP),
            SampleCells::Position(stored) => Some(self.millimetres.position(stored)),
            SampleCells::Empty => None,
            SampleCells::Damaged => {
                self.damaged += 1;
                None
            }
        };
        self.row.push(position.unwrap_or(GAP));
        position.is_some()
    }

    /// Reads all remaining cells of the row, without empty and damaged samples at its end. Returns the number of
    /// markers that the row has.
    pub(super) fn read_samples(&mut self, cells: &mut dyn Iterator<Item = &[u8]>) -> usize {
        let mut filled = 0;
        let mut cells = cells.peekable();
        while cells.peek().is_some() {
            if self.read_sample(&mut cells) {
                filled = self.row.len();
            }
        }
        self.row.truncate(filled);
        filled
    }

    /// Ends the current row.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn end_row(&mut self) -> io::Result<()> {
        self.n_rows += 1;
        self.n_positions += self.row.len() as u64;
        let last = self.last.get_or_insert_default();
        std::mem::swap(last, &mut self.row);
        if self.n_rows > 1 {
            self.rows.write(&self.row)?;
        }
        self.row.clear();
        Ok(())
    }

    /// States the number of bytes of the whole file, which limits the number of positions.
    pub(super) fn end(&mut self, text_bytes: u64) {
        self.text_bytes = text_bytes;
    }

    /// Makes the sample of a marker in the last row a gap, because its number may be cut off.
    pub(super) fn drop_truncated(&mut self, column: usize) {
        if let Some(cut) = self.last.as_mut().and_then(|row| row.get_mut(column)) {
            *cut = GAP;
        }
    }

    /// Warns of samples that are not finite.
    pub(super) fn report_not_finite(&self, warnings: &mut Vec<String>) {
        self.millimetres.report(warnings);
    }

    /// Warns of samples whose cells are not numbers.
    pub(super) fn report_damaged(&self, warnings: &mut Vec<String>) {
        report_damaged(self.damaged, warnings);
    }

    /// Moves each row to the frame that its number and time give; frames without a row are empty. Returns the rate: the
    /// stated one, or the one that follows from the times. The size of the file and the number of markers (`width`)
    /// limit the number of frames without a row.
    pub(super) fn place(
        &mut self,
        stated_hz: Option<f64>,
        width: usize,
        warnings: &mut Vec<String>,
    ) -> Option<f64> {
        let frames_max = usize::try_from(self.positions_max()).unwrap_or(usize::MAX) / width.max(1);
        let placed = self.timing.place(stated_hz, frames_max, warnings);
        self.missing_before = placed.missing_before;
        placed.rate_hz.or_else(|| (self.n_rows == 1).then(|| rate_of_one_frame(warnings)))
    }

    /// The number of the first frame, if rows have numbers.
    pub(super) fn first_frame(&self) -> Option<u64> {
        self.timing.first()
    }

    /// The number of frames: of rows, and of frames without a row.
    pub(super) fn n_frames(&self) -> u64 {
        self.missing_before.iter().fold(self.n_rows, |n, missing| n.saturating_add(*missing))
    }

    /// The number of announced frames that the file does not have. Warns if it has another number than announced.
    pub(super) fn count_missing(&self, announced: Option<u64>, warnings: &mut Vec<String>) -> u64 {
        let n_frames = self.n_frames();
        let Some(announced) = announced.filter(|&n| n != n_frames) else { return 0 };
        let frames = counted(announced, "frame");
        warnings.push(format!("The header announces {frames}, the file has {n_frames}."));
        announced.saturating_sub(n_frames)
    }

    /// The frames, `width` markers wide; shorter rows are filled up with gaps.
    ///
    /// # Errors
    /// `Malformed` if they have more than [`MAX_POSITIONS_PER_BYTE`] positions per byte of the file; those of the
    /// scratch file.
    pub(super) fn into_frames(mut self, width: usize) -> Result<TextFrames> {
        let n_frames = self.n_frames();
        let total = n_frames.saturating_mul(width as u64);
        if total != self.n_positions && total > self.positions_max() {
            let message = format!(
                "{n_frames} rows of {width} markers (the widest row) are too many for a file of {} bytes; split the file",
                self.text_bytes
            );
            return Err(InterchangeError::malformed(self.format, "data", message));
        }
        if let Some(last) = &self.last {
            self.rows.write(last)?;
        }
        Ok(TextFrames::of_rows(self.rows.finish()?, (n_frames, width), self.missing_before))
    }

    fn positions_max(&self) -> u64 {
        self.text_bytes.saturating_mul(MAX_POSITIONS_PER_BYTE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interchange::rotation::Rotation;

    #[test]
    fn one_wide_row_among_many_short_ones_does_not_claim_memory() {
        let new_scratch = || Err(io::ErrorKind::Unsupported.into());
        let millimetres = ToMillimetres::new(1.0, Rotation::IDENTITY);
        let mut table = Table::new("trc", &new_scratch, millimetres);
        for _ in 0..1000 {
            table.end_row().unwrap();
        }
        assert!(table.read_sample(&mut [&b"0"[..]; 3].into_iter()));
        table.end_row().unwrap();
        table.end(8000);
        assert!(table.into_frames(100_000).is_err());
    }
}

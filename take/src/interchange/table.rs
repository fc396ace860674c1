//! Tables of trajectories in text files: one row a frame with three cells for each marker. TRC, TSV and CSV share this
//! code; they differ in the header, the separator, and the mark for a missing sample.

use super::{InterchangeError, Result, counted, row_timing::RowTiming, units::ToMillimetres};
use crate::motion::{GAP, Position};

/// Most positions to allocate per byte of text: one wide row among many short ones must not cost unbounded memory.
pub(super) const MAX_POSITIONS_PER_BYTE: usize = 4;

/// The warning for a file whose last number may lack digits.
pub(super) const CUT_OFF: &str = "The file ends in the middle of a line; its last number may be cut off, so that sample is a gap.";

/// The assumed rate of a file with one frame and no stated rate; a C3D file without a rate gets the same.
const RATE_OF_ONE_FRAME_HZ: f64 = 100.0;

/// The rate to assume for a single frame, with a warning.
pub(super) fn rate_of_one_frame(warnings: &mut Vec<String>) -> f64 {
    warnings.push(format!("A single frame has no rate; {RATE_OF_ONE_FRAME_HZ} Hz was assumed."));
    RATE_OF_ONE_FRAME_HZ
}

/// Warns of samples that became gaps because their cells are not numbers.
pub(super) fn report_damaged(n: usize, warnings: &mut Vec<String>) {
    if n > 0 {
        warnings.push(format!("Not a number, read as missing: {}.", counted(n as u64, "sample")));
    }
}

/// The content of the three cells of a sample.
pub(super) enum SampleCells {
    /// Three numbers.
    Position([f64; 3]),
    /// At least one cell is empty, and the others are numbers.
    Empty,
    /// At least one cell is neither empty nor a number.
    Damaged,
}

/// Parses the next three cells; cells past the end of the row count as empty.
pub(super) fn parse_sample(cells: &mut dyn Iterator<Item = &[u8]>) -> SampleCells {
    let mut position = [0.0; 3];
    let (mut is_empty, mut is_damaged) = (false, false);
    for value in &mut position {
        match cells.next().map(<[u8]>::trim_ascii) {
            None | Some([]) => is_empty = true,
            Some(cell) => match super::text::number(cell) {
                Some(number) => *value = number,
                None => is_damaged = true,
            },
        }
    }
    match (is_damaged, is_empty) {
        (true, _) => SampleCells::Damaged,
        (false, true) => SampleCells::Empty,
        (false, false) => SampleCells::Position(position),
    }
}

/// A table under construction, row by row.
pub(super) struct Table<'a> {
    format: &'static str,
    /// The whole file.
    pub(super) bytes: &'a [u8],
    millimetres: ToMillimetres,
    /// Whether `0 0 0` means a missing sample.
    zeros_are_gaps: bool,
    /// The positions of all rows, which may differ in width.
    positions: Vec<Position>,
    /// For each row the index in `positions` at which it ends.
    ends: Vec<usize>,
    timing: RowTiming,
    damaged: usize,
}

impl<'a> Table<'a> {
    pub(super) fn new(format: &'static str, bytes: &'a [u8], millimetres: ToMillimetres) -> Self {
        Self {
            format,
            bytes,
            millimetres,
            zeros_are_gaps: false,
            positions: Vec::new(),
            ends: Vec::new(),
            timing: RowTiming::default(),
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
        self.positions.push(position.unwrap_or(GAP));
        position.is_some()
    }

    /// Reads all remaining cells of the row, without empty and damaged samples at its end. Returns the number of
    /// markers that the row has.
    pub(super) fn read_samples(&mut self, cells: &mut dyn Iterator<Item = &[u8]>) -> usize {
        let start = self.positions.len();
        let mut filled = start;
        let mut cells = cells.peekable();
        while cells.peek().is_some() {
            if self.read_sample(&mut cells) {
                filled = self.positions.len();
            }
        }
        self.positions.truncate(filled);
        filled - start
    }

    /// Ends the current row.
    pub(super) fn end_row(&mut self) {
        self.ends.push(self.positions.len());
    }

    /// Makes the sample of a marker in the last row a gap, because its number may be cut off.
    pub(super) fn drop_truncated(&mut self, column: usize) {
        let n_before = self.ends.len().checked_sub(2).and_then(|row| self.ends.get(row));
        let place = n_before.copied().unwrap_or(0).saturating_add(column);
        if let Some(cut) = self.positions.get_mut(place) {
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

    /// Moves each row to the frame that its number and time give, and inserts empty rows for frames without a row.
    /// Returns the rate: the stated one, or the one that follows from the times. The size of the file and the number of
    /// markers (`width`) limit the number of rows.
    pub(super) fn place(
        &mut self,
        stated_hz: Option<f64>,
        width: usize,
        warnings: &mut Vec<String>,
    ) -> Option<f64> {
        let frames_max = self.bytes.len().saturating_mul(MAX_POSITIONS_PER_BYTE) / width.max(1);
        let placed = self.timing.place(stated_hz, frames_max, warnings);
        let rate_hz =
            placed.rate_hz.or_else(|| (self.ends.len() == 1).then(|| rate_of_one_frame(warnings)));
        if !placed.missing_before.is_empty() {
            let mut start = 0;
            let mut ends = Vec::with_capacity(self.ends.len());
            for (index, &end) in self.ends.iter().enumerate() {
                let n_empty = placed.missing_before.get(index).copied().unwrap_or(0);
                ends.extend((0..n_empty).map(|_| start));
                ends.push(end);
                start = end;
            }
            self.ends = ends;
        }
        rate_hz
    }

    /// The number of the first frame, if rows have numbers.
    pub(super) fn first_frame(&self) -> Option<u64> {
        self.timing.first()
    }

    /// The number of rows, which is that of frames.
    pub(super) fn n_frames(&self) -> u64 {
        self.ends.len() as u64
    }

    /// The number of announced frames that the file does not have. Warns if it has another number than announced.
    pub(super) fn count_missing(&self, announced: Option<u64>, warnings: &mut Vec<String>) -> u64 {
        let n_frames = self.n_frames();
        let Some(announced) = announced.filter(|&n| n != n_frames) else { return 0 };
        let frames = counted(announced, "frame");
        warnings.push(format!("The header announces {frames}, the file has {n_frames}."));
        announced.saturating_sub(n_frames)
    }

    /// The positions as a rectangle `width` markers wide; shorter rows are filled up with gaps.
    ///
    /// # Errors
    /// `Malformed` if the rectangle has more than [`MAX_POSITIONS_PER_BYTE`] positions per byte of the file.
    pub(super) fn into_positions(self, width: usize) -> Result<Vec<Position>> {
        let total = width.saturating_mul(self.ends.len());
        if total == self.positions.len() {
            return Ok(self.positions);
        }
        if total > self.bytes.len().saturating_mul(MAX_POSITIONS_PER_BYTE) {
            let message = format!(
                "{} rows of {width} markers (the widest row) are too many for a file of {} bytes; split the file",
                self.ends.len(),
                self.bytes.len()
            );
            return Err(InterchangeError::malformed(self.format, "data", message));
        }
        let mut rectangle = Vec::with_capacity(total);
        let mut start = 0;
        for end in self.ends {
            let row = self.positions.get(start..end).unwrap_or(&[]);
            rectangle.extend_from_slice(row.get(..width).unwrap_or(row));
            rectangle.extend(std::iter::repeat_n(GAP, width.saturating_sub(row.len())));
            start = end;
        }
        Ok(rectangle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interchange::rotation::Rotation;

    #[test]
    fn one_wide_row_among_many_short_ones_does_not_claim_memory() {
        let bytes = [b' '; 8000];
        let mut table = Table::new("trc", &bytes, ToMillimetres::new(1.0, Rotation::IDENTITY));
        for _ in 0..1000 {
            table.end_row();
        }
        assert!(table.read_sample(&mut [&b"0"[..]; 3].into_iter()));
        table.end_row();
        assert!(table.into_positions(100_000).is_err());
    }
}

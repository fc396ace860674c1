//! Tables of trajectories in text: rows of three cells a marker, and the frame that each row is. TRC, TSV and CSV differ
//! in what stands above the rows, between the cells, and for a missing sample.

use super::{InterchangeError, Result, line_frames::LineFrames, units::Millimetres};
use crate::motion::{GAP, Position};

/// Positions a byte of text may claim: a short row next to a wide one must not earn unbounded memory.
pub(super) const MAX_POSITIONS_PER_BYTE: usize = 4;

/// Said of a file whose last number may lack digits.
pub(super) const CUT_OFF: &str =
    "The file ends within its last line; the sample whose number may be cut off there is a gap.";

/// Rate of a file of one frame that states none, as of a C3D file that states none.
const RATE_OF_ONE_FRAME_HZ: f64 = 100.0;

/// What is taken where one frame tells no rate.
pub(super) fn rate_of_one_frame(warnings: &mut Vec<String>) -> f64 {
    warnings.push(format!("One frame tells no rate; {RATE_OF_ONE_FRAME_HZ} Hz was taken."));
    RATE_OF_ONE_FRAME_HZ
}

/// Says how many samples became gaps because their cells are no numbers.
pub(super) fn report_damaged(n: usize, warnings: &mut Vec<String>) {
    if n > 0 {
        warnings.push(format!("{n} samples have cells that are not numbers; they are gaps."));
    }
}

/// What three cells of a row say.
pub(super) enum Cells {
    /// A number in each.
    Position([f64; 3]),
    /// At least one of them is empty, and no other is damaged.
    Empty,
    /// A cell that is neither empty nor a number.
    Damaged,
}

/// Reads the next three cells; missing cells count as empty.
pub(super) fn three_cells(cells: &mut dyn Iterator<Item = &[u8]>) -> Cells {
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
        (true, _) => Cells::Damaged,
        (false, true) => Cells::Empty,
        (false, false) => Cells::Position(position),
    }
}

/// A table as it is read, row after row.
pub(super) struct Table<'a> {
    format: &'static str,
    /// The whole file.
    pub(super) bytes: &'a [u8],
    millimetres: Millimetres,
    /// Whether three zeros stand for a missing sample.
    zeros_are_gaps: bool,
    /// Row after row; rows may differ in width.
    positions: Vec<Position>,
    /// Where in them each row ends.
    ends: Vec<usize>,
    lines: LineFrames,
    damaged: usize,
}

impl<'a> Table<'a> {
    /// Of a file of these bytes.
    pub(super) fn new(format: &'static str, bytes: &'a [u8], millimetres: Millimetres) -> Self {
        Self {
            format,
            bytes,
            millimetres,
            zeros_are_gaps: false,
            positions: Vec::new(),
            ends: Vec::new(),
            lines: LineFrames::default(),
            damaged: 0,
        }
    }

    /// Of a format that writes zeros where a sample is missing.
    pub(super) fn with_zeros_as_gaps(self) -> Self {
        Self { zeros_are_gaps: true, ..self }
    }

    /// Begins a row, by its cells of the frame's number and time; empty where there are none.
    pub(super) fn begin_row(&mut self, number: &[u8], time: &[u8]) {
        self.lines.line(number, time);
    }

    /// Reads the next three cells of the row; whether they are a position.
    pub(super) fn read_sample(&mut self, cells: &mut dyn Iterator<Item = &[u8]>) -> bool {
        let position = match three_cells(cells) {
            Cells::Position([0.0, 0.0, 0.0]) if self.zeros_are_gaps => Some(GAP),
            Cells::Position(stored) => Some(self.millimetres.position(stored)),
            Cells::Empty => None,
            Cells::Damaged => {
                self.damaged += 1;
                None
            }
        };
        self.positions.push(position.unwrap_or(GAP));
        position.is_some()
    }

    /// Reads all cells to come. Empty and damaged ones at the end of the row are nothing, not gaps. Returns how many
    /// columns the row fills.
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

    /// Ends the row under way.
    pub(super) fn end_row(&mut self) {
        self.ends.push(self.positions.len());
    }

    /// The position of a column in the last row becomes a gap.
    pub(super) fn drop_cut(&mut self, column: usize) {
        let n_before = self.ends.len().checked_sub(2).and_then(|row| self.ends.get(row));
        let place = n_before.copied().unwrap_or(0).saturating_add(column);
        if let Some(cut) = self.positions.get_mut(place) {
            *cut = GAP;
        }
    }

    /// Says how many samples are not finite.
    pub(super) fn report_not_finite(&self, warnings: &mut Vec<String>) {
        self.millimetres.report(warnings);
    }

    /// Says how many samples have cells that are not numbers.
    pub(super) fn report_damaged(&self, warnings: &mut Vec<String>) {
        report_damaged(self.damaged, warnings);
    }

    /// Puts each row where its number and time say, with empty rows for frames that have none, and says the rate: the
    /// stated one, or the one that the times tell. `width` markers, of which the file's bytes can mean so many rows.
    pub(super) fn place(
        &mut self,
        stated_hz: Option<f64>,
        width: usize,
        warnings: &mut Vec<String>,
    ) -> Option<f64> {
        let frames_max = self.bytes.len().saturating_mul(MAX_POSITIONS_PER_BYTE) / width.max(1);
        let placed = self.lines.place(stated_hz, frames_max, warnings);
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

    /// Number of the first frame, where rows have numbers.
    pub(super) fn first_frame(&self) -> Option<u64> {
        self.lines.first()
    }

    /// Rows, which are frames.
    pub(super) fn n_frames(&self) -> u64 {
        self.ends.len() as u64
    }

    /// How many of the frames that the file announces are missing; notes another number than there is.
    pub(super) fn n_missing(&self, announced: Option<u64>, warnings: &mut Vec<String>) -> u64 {
        let n_frames = self.n_frames();
        let Some(announced) = announced.filter(|&n| n != n_frames) else { return 0 };
        warnings.push(format!("{announced} frames announced, {n_frames} present."));
        announced.saturating_sub(n_frames)
    }

    /// All rows `width` positions wide: gaps where a row is shorter.
    ///
    /// # Errors
    /// `Malformed` when that is more than so many bytes of text can mean.
    pub(super) fn into_positions(self, width: usize) -> Result<Vec<Position>> {
        let total = width.saturating_mul(self.ends.len());
        if total == self.positions.len() {
            return Ok(self.positions);
        }
        if total > self.bytes.len().saturating_mul(MAX_POSITIONS_PER_BYTE) {
            let message = format!(
                "{} rows as wide as the widest, {width} markers, are more than {} bytes of text can mean; split the file",
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
    use crate::interchange::turn::Turn;

    #[test]
    fn one_wide_row_among_many_short_ones_does_not_earn_memory() {
        let bytes = [b' '; 8000];
        let mut table = Table::new("trc", &bytes, Millimetres::new(1.0, Turn::NONE));
        for _ in 0..1000 {
            table.end_row();
        }
        assert!(table.read_sample(&mut [&b"0"[..]; 3].into_iter()));
        table.end_row();
        assert!(table.into_positions(100_000).is_err());
    }
}

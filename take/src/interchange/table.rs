//! Tables of trajectories in text files: one row per frame with three cells for each marker. TRC, TSV and CSV share
//! this code; they differ in the header, the separator, and the mark for a missing sample.
//!
//! The frame numbers and times in the rows assign the rows to frames, and determine the rate. A missing row becomes a
//! frame without samples; closing the gap would shift all later rows in time. Times are rounded (a spreadsheet shows
//! 0.008, 0.017, 0.025 for 120 Hz), so no single interval gives the rate. All of them together do: the rate is the number
//! of frames from the first time to the last, divided by that time span, and its relative uncertainty is the rounding
//! divided by the span.

use std::io;

use super::{
    InterchangeError, Result, counted,
    text::{self, RowWriter, TextFrames},
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
            Some(cell) => match text::number(cell) {
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

/// Largest deviation of an interval from the period, as a share of it and beyond the rounding, that counts as even.
const EVEN_SHARE: f64 = 0.01;
/// An interval longer than this many periods, beyond the rounding, contains lost frames; a shorter one is a late frame.
const GAP_PERIODS: f64 = 1.5;
/// Largest relative difference between the stated rate and the rate from the times that needs no warning.
const RATE_MISMATCH_MAX: f64 = 0.01;
/// Largest relative uncertainty of the rate that needs no warning.
const RATE_UNCERTAINTY_MAX: f64 = 1e-3;
/// With at least this many steps, a common step of several frame numbers means a decimated file; with fewer, gaps.
const DECIMATED_MIN: usize = 3;
/// Maximum number of decimals of a rate: 59.94006.
const RATE_DIGITS_MAX: i32 = 6;

/// The frame numbers and times of the rows read so far: 16 bytes per row, and 64 with the data that
/// [`place`](RowTiming::place) derives. An hour at 240 Hz has 864 000 rows.
#[derive(Debug, Default)]
pub(super) struct RowTiming {
    n_rows: usize,
    numbers: Vec<u64>,
    times: Vec<f64>,
    rounding: Rounding,
}

/// The rounding of times: one unit in the last digit of the longest one.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Rounding {
    digits: usize,
    has_exponents: bool,
}

impl Rounding {
    /// Accounts for one more time.
    pub(super) fn add(&mut self, cell: &[u8]) {
        self.has_exponents |= cell.iter().any(|b| b.eq_ignore_ascii_case(&b'e'));
        self.digits = self.digits.max(text::decimals(cell.trim_ascii()));
    }

    /// The largest error of a difference of two times: one unit, half from each time. 0 if the rounding is unknown.
    fn seconds(self) -> f64 {
        if self.has_exponents { 0.0 } else { 10f64.powi(-(self.digits.min(300) as i32)) }
    }
}

/// The rate of `steps` frames in `span_s` seconds, with the fewest digits that agree with it within the rounding of the
/// times; `None` if it is not a positive number.
pub(super) fn rate_of(steps: f64, span_s: f64, rounding: Rounding) -> Option<f64> {
    let rate = steps / span_s;
    if !(rate.is_finite() && rate > 0.0) {
        return None;
    }
    let slack = rate * (rounding.seconds() / span_s).max(1e-9);
    let rounded = (0..=RATE_DIGITS_MAX).map(|digits| {
        let scale = 10f64.powi(digits);
        (rate * scale).round() / scale
    });
    let mut fitting = rounded.filter(|rounded| (rounded - rate).abs() <= slack && *rounded > 0.0);
    Some(fitting.next().unwrap_or(rate))
}

/// The rate, and the frames that have no row.
#[derive(Debug, Default, PartialEq)]
pub(super) struct RowPlacement {
    /// Frames a second; `None` if it is neither stated nor follows from times.
    pub(super) rate_hz: Option<f64>,
    /// For each row the number of frames without a row just before it. Empty if no frame lacks a row.
    pub(super) missing_before: Vec<u64>,
}

impl RowTiming {
    /// Adds a row by its cells for frame number and time; either may be empty.
    pub(super) fn push(&mut self, number: &[u8], time: &[u8]) {
        self.n_rows += 1;
        self.numbers.extend(text::whole_number(number));
        if let Some(seconds) = text::number(time).filter(|seconds| seconds.is_finite()) {
            self.times.push(seconds);
            self.rounding.add(time);
        }
    }

    /// The number of the first frame.
    pub(super) fn first(&self) -> Option<u64> {
        self.numbers.first().copied()
    }

    /// Assigns rows to frames, and determines the rate if the file states none. Falls back to successive frames if
    /// there would be more than `frames_max`.
    pub(super) fn place(
        &self,
        stated_hz: Option<f64>,
        frames_max: usize,
        warnings: &mut Vec<String>,
    ) -> RowPlacement {
        let by_number = self.steps_by_number(warnings);
        let by_time = self.steps_by_time(stated_hz, by_number.as_deref(), warnings);
        let rate_hz = stated_hz.or_else(|| {
            let steps = by_time.as_deref().map(|steps| steps.iter().map(|&step| step as f64).sum());
            let steps = steps.unwrap_or(self.times.len().saturating_sub(1) as f64);
            rate_of(steps, self.times.last()? - self.times.first()?, self.rounding)
        });
        let without_gaps = RowPlacement { rate_hz, ..RowPlacement::default() };
        let Some(steps) = by_time.or(by_number) else { return without_gaps };
        let missing: u64 = steps.iter().map(|step| step - 1).fold(0, u64::saturating_add);
        if missing == 0 {
            return without_gaps;
        }
        if missing.saturating_add(self.n_rows as u64) > frames_max as u64 {
            warnings.push(format!(
                "Frame numbers and times skip {}, too many for a file of this size; they were ignored.",
                counted(missing, "frame")
            ));
            return without_gaps;
        }
        warnings.push(format!("Without a row, read as gaps: {}.", counted(missing, "frame")));
        let missing_before = std::iter::once(0).chain(steps.iter().map(|step| step - 1)).collect();
        RowPlacement { rate_hz, missing_before }
    }

    /// Steps in frames from each row to the next, from the frame numbers; `None` if they do not rise. In a file with
    /// every n-th frame only, those are the frames.
    fn steps_by_number(&self, warnings: &mut Vec<String>) -> Option<Vec<u64>> {
        if self.numbers.len() != self.n_rows || self.n_rows < 2 {
            return None;
        }
        let falls = self.numbers.array_windows().filter(|[a, b]| b <= a).count();
        if falls > 0 {
            warnings.push(format!(
                "Frame numbers do not increase in {}; rows were read as successive frames.",
                counted(falls as u64, "place")
            ));
            return None;
        }
        let steps: Vec<u64> = self.numbers.array_windows().map(|[a, b]| b - a).collect();
        let common = steps.iter().copied().fold(0, greatest_common_divisor).max(1);
        let every = if steps.len() < DECIMATED_MIN { 1 } else { common };
        if every > 1 {
            warnings.push(format!(
                "Only one in {every} frame numbers is present; those were read as successive frames."
            ));
        }
        Some(steps.into_iter().map(|step| step / every).collect())
    }

    /// Steps in frames from each row to the next, from the times, or from the frame numbers if the times agree with
    /// them; `None` if the times do not rise.
    fn steps_by_time(
        &self,
        stated_hz: Option<f64>,
        by_number: Option<&[u64]>,
        warnings: &mut Vec<String>,
    ) -> Option<Vec<u64>> {
        if self.times.len() != self.n_rows || self.n_rows < 2 {
            return None;
        }
        let intervals: Vec<f64> = self.times.array_windows().map(|[a, b]| b - a).collect();
        let typical = typical_interval(&intervals)?;
        let rounding_s = self.rounding.seconds().min(typical.spread_s);
        let measured_hz = 1.0 / typical.mean_s;
        if let Some(stated_hz) = stated_hz
            && (typical.mean_s * stated_hz - 1.0).abs() > RATE_MISMATCH_MAX + rounding_s * stated_hz
        {
            warnings.push(format!(
                "The file states {stated_hz} Hz, but its times give {measured_hz:.3} Hz; {stated_hz} Hz was used."
            ));
        }
        let step = |&interval_s: &f64| {
            let is_gap = interval_s > GAP_PERIODS * typical.mean_s + rounding_s;
            if is_gap { (interval_s / typical.mean_s).round().max(1.0) as u64 } else { 1 }
        };
        let by_time: Vec<u64> = intervals.iter().map(step).collect();
        let n_off = |steps: &[u64], slack_s: f64| {
            let steps = steps.iter().zip(&intervals);
            steps.filter(|&(&step, &s)| (s - step as f64 * typical.mean_s).abs() > slack_s).count()
        };
        if let Some(by_number) = by_number {
            let disagree = n_off(by_number, 0.5 * typical.mean_s + rounding_s);
            if disagree == 0 {
                return Some(by_number.to_vec());
            }
            warnings.push(format!(
                "Frame numbers and times disagree in {}; the times were used.",
                counted(disagree as u64, "place")
            ));
        }
        let uneven = n_off(&by_time, EVEN_SHARE * typical.mean_s + rounding_s + 2e-6);
        if uneven > 0 {
            warnings.push(format!(
                "{uneven} of {} intervals differ from the typical {:.6} s; frames were read as evenly spaced.",
                intervals.len(),
                typical.mean_s
            ));
        }
        let span_s = self.times.last()? - self.times.first()?;
        if stated_hz.is_none() && rounding_s / span_s > RATE_UNCERTAINTY_MAX {
            warnings.push(format!(
                "Times are rounded to {rounding_s} s, so the rate is only known to within {:.2} Hz.",
                measured_hz * rounding_s / span_s
            ));
        }
        Some(by_time)
    }
}

/// The intervals between rows of successive frames.
struct TypicalInterval {
    mean_s: f64,
    /// The longest minus the shortest.
    spread_s: f64,
}

/// `None` if times do not rise.
fn typical_interval(intervals: &[f64]) -> Option<TypicalInterval> {
    let mut sorted = intervals.to_vec();
    sorted.sort_by(f64::total_cmp);
    let median = *sorted.get(sorted.len().checked_sub(1)? / 2)?;
    if !(median > 0.0 && *sorted.first()? >= 0.0) {
        return None;
    }
    let typical = sorted.get(..sorted.partition_point(|&s| s <= GAP_PERIODS * median))?;
    let mean_s = typical.iter().sum::<f64>() / typical.len() as f64;
    Some(TypicalInterval { mean_s, spread_s: typical.last()? - typical.first()? })
}

fn greatest_common_divisor(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::up_axis::Rotation;

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

    /// The rows of these frames, with times of `digits` decimals.
    fn rows(frames: &[u64], rate_hz: f64, digits: usize) -> RowTiming {
        let mut rows = RowTiming::default();
        for frame in frames {
            rows.push(b"", format!("{:.digits$}", *frame as f64 / rate_hz).as_bytes());
        }
        rows
    }

    #[test]
    fn rounded_times_together_give_the_exact_rate() {
        for (rate_hz, digits, n) in
            [(120.0, 3, 50), (120.0, 2, 500), (59.94, 4, 2000), (10.0, 1, 20), (100.0, 9, 4)]
        {
            let frames: Vec<u64> = (0..n).collect();
            let placed = rows(&frames, rate_hz, digits).place(None, 10_000, &mut Vec::new());
            assert_eq!(placed.rate_hz, Some(rate_hz), "{rate_hz} Hz to {digits} digits");
            assert_eq!(placed.missing_before, [0; 0], "{rate_hz} Hz to {digits} digits");
        }
    }

    #[test]
    fn a_missing_row_is_a_frame() {
        for (rate_hz, digits) in [(120.0, 3), (100.0, 2), (10.0, 1), (240.0, 6)] {
            let frames: Vec<u64> =
                (0..60).filter(|frame| ![7, 20, 21, 22].contains(frame)).collect();
            let mut warnings = Vec::new();
            let placed = rows(&frames, rate_hz, digits).place(None, 1000, &mut warnings);
            assert_eq!(placed.rate_hz, Some(rate_hz), "{warnings:?}");
            let missing: Vec<_> =
                placed.missing_before.iter().enumerate().filter(|(_, n)| **n > 0).collect();
            assert_eq!(missing, [(7, &1), (19, &3)], "{rate_hz} Hz: {warnings:?}");
            assert!(warnings.iter().any(|warning| warning.contains("4 frames")), "{warnings:?}");
        }
    }

    #[test]
    fn numbers_count_unless_times_contradict_them() {
        let of = |cells: &[(&str, &str)]| {
            let mut rows = RowTiming::default();
            cells.iter().for_each(|(number, time)| rows.push(number.as_bytes(), time.as_bytes()));
            let mut warnings = Vec::new();
            (rows.place(None, 100, &mut warnings), warnings)
        };
        // Without times, and every second frame.
        let (placed, _) = of(&[("1", ""), ("3", ""), ("7", ""), ("9", "")]);
        assert_eq!((placed.rate_hz, placed.missing_before), (None, vec![0, 0, 1, 0]));
        // Renumbered after a gap.
        let (placed, warnings) = of(&[("1", "0"), ("2", "0.1"), ("3", "0.2"), ("4", "0.5")]);
        assert_eq!((placed.rate_hz, placed.missing_before), (Some(10.0), vec![0, 0, 0, 2]));
        assert_eq!(warnings.len(), 2, "{warnings:?}");
        // Nothing that rises.
        let (placed, warnings) = of(&[("2", "0.1"), ("1", "0.1"), ("2", "0.1")]);
        assert_eq!((placed, warnings.len()), (RowPlacement::default(), 1));
        // A typing error is not a day without frames.
        let (placed, warnings) = of(&[("1", "0.1"), ("2", "0.2"), ("9000000", "900000.0")]);
        assert_eq!((placed.missing_before.len(), warnings.len()), (0, 1), "{warnings:?}");
    }
}

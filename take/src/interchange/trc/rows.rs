//! The rows of a TRC file.

use super::read::{Head, malformed};
use super::separator::Separator;
use crate::interchange::InterchangeError;
use crate::interchange::line_frames::LineFrames;
use crate::interchange::text::{self, CUT_OFF, Rows};
use crate::interchange::units::Millimetres;

/// Cells in front of the positions: frame number and time.
const LEAD_CELLS: usize = 2;

/// The data as read.
pub(super) struct Data {
    pub(super) rows: Rows,
    /// Markers of the widest row.
    pub(super) width: usize,
    pub(super) lines: LineFrames,
    /// What stands between the cells of a row.
    pub(super) separator: Separator,
}

/// Reads everything below the labels.
pub(super) fn read_rows(
    bytes: &[u8],
    head: &Head,
    millimetres: &Millimetres,
    warnings: &mut Vec<String>,
) -> Result<Data, InterchangeError> {
    let separator = separator_of_rows(bytes, head);
    let exact_width = match separator {
        Separator::Byte(_) => None,
        Separator::Spaces => exact_width(bytes, head)?,
    };
    let mut data = Data {
        rows: Rows::default(),
        width: exact_width.unwrap_or(0),
        lines: LineFrames::default(),
        separator,
    };
    let mut skipped = Skipped::default();
    let mut n_cells = 0;
    for (at, line) in text::lines(bytes).skip(head.labels_line) {
        if frame_number(line, separator).is_none() {
            // The line X1 Y1 Z1... and empty lines.
            let own = Separator::of(line);
            let is_empty = own.cells(line).next().is_none_or(|cell| cell.trim_ascii().is_empty());
            if !is_empty && !is_axes(own, line) {
                skipped.line(at);
            }
            continue;
        }
        let mut lead = separator.cells(line);
        let (number, time) = (lead.next().unwrap_or(&[]), lead.next().unwrap_or(&[]));
        data.lines.line(number, time);
        n_cells = separator.cells(line).count();
        if !is_aligned(line, separator, exact_width) {
            skipped.row(at);
            data.rows.end_row();
            continue;
        }
        let mut cells = separator.cells(line).skip(LEAD_CELLS);
        let columns = data
            .rows
            .read_row(&mut cells, &mut skipped.cells, |stored| millimetres.position(stored));
        data.width = data.width.max(columns);
    }
    let cells = |line| separator.cells(line);
    if n_cells > LEAD_CELLS && text::ends_within_a_number(bytes, head.labels_line + 1, cells) {
        data.rows.drop_cut((n_cells - LEAD_CELLS - 1) / 3);
        warnings.push(CUT_OFF.to_owned());
    }
    skipped.report(warnings);
    millimetres.report(warnings);
    Ok(data)
}

/// The number that a row begins with, also where something else than in other rows stands between its cells; `None` for
/// other lines.
fn frame_number(line: &[u8], separator: Separator) -> Option<u64> {
    let of = |separator: Separator| text::whole_number(separator.cells(line).next()?);
    of(separator).or_else(|| of(Separator::of(line)))
}

/// One separator for all rows: that of the labels where a row has it, else that of the first row.
fn separator_of_rows(bytes: &[u8], head: &Head) -> Separator {
    let of_labels = head.separator;
    let mut first = None;
    for (_, line) in text::lines(bytes).skip(head.labels_line) {
        let own = Separator::of(line);
        if frame_number(line, own).is_none() {
            continue;
        }
        if of_labels == Separator::Spaces {
            return own;
        }
        if of_labels.is_in(line) {
            return of_labels;
        }
        first.get_or_insert(own);
    }
    first.unwrap_or(of_labels)
}

/// How many markers rows between spaces have: no cell is empty there, so that the row of a frame in which a marker is
/// missing is shorter, and does not tell which one. As `NumMarkers` or the labels say, whichever more rows agree with.
/// `None` where neither does: points of an unlabelled cloud are nobody's, and rows differ in length.
///
/// # Errors
/// `Malformed` when no row agrees.
fn exact_width(bytes: &[u8], head: &Head) -> Result<Option<usize>, InterchangeError> {
    let announced = head.n_markers.and_then(|n| usize::try_from(n).ok());
    let stated = [announced, Some(head.labels.len())].map(|n| n.filter(|&n| n > 0));
    let mut agreeing = [0usize; 2];
    let mut n_rows = 0usize;
    for (_, line) in text::lines(bytes).skip(head.labels_line) {
        if frame_number(line, Separator::Spaces).is_none() {
            continue;
        }
        n_rows += 1;
        let width = width_of(line);
        for (count, stated) in agreeing.iter_mut().zip(stated) {
            *count += usize::from(stated.is_some() && stated == width);
        }
    }
    let [by_number, by_labels] = agreeing;
    let [of_number, of_labels] = stated;
    let preferred = if by_labels > by_number { of_labels } else { of_number.or(of_labels) };
    let Some(width) = preferred else { return Ok(None) };
    if n_rows > 0 && by_number.max(by_labels) == 0 {
        return Err(malformed(
            "data",
            &format!(
                "expected rows of {} cells between spaces (frame, time, and three for each of {width} markers), found none: \
                 a missing marker has no cells there, and which one is missing is not known; separate the cells by tabs",
                width.saturating_mul(3).saturating_add(LEAD_CELLS)
            ),
        ));
    }
    Ok(Some(width))
}

/// Markers of a row between spaces; `None` for a part of one.
fn width_of(line: &[u8]) -> Option<usize> {
    let n_cells = Separator::Spaces.cells(line).count().checked_sub(LEAD_CELLS)?;
    n_cells.is_multiple_of(3).then_some(n_cells / 3)
}

/// Whether each cell of a row stands in the column of its marker.
fn is_aligned(line: &[u8], separator: Separator, exact_width: Option<usize>) -> bool {
    match separator {
        Separator::Spaces => match (width_of(line), exact_width) {
            (Some(width), Some(exact)) => width == exact,
            (width, None) => width.is_some(),
            (None, Some(_)) => false,
        },
        // A number alone is a frame without a position.
        Separator::Byte(_) => separator.is_in(line) || text::whole_number(line).is_some(),
    }
}

/// Whether a line holds nothing but `X1 Y1 Z1 X2...`, three cells at least.
fn is_axes(separator: Separator, line: &[u8]) -> bool {
    let is_axis = |cell: &[u8]| match cell.trim_ascii().split_first() {
        Some((axis, number)) => b"XYZxyz".contains(axis) && number.iter().all(u8::is_ascii_digit),
        None => true,
    };
    separator.cells(line).nth(2).is_some() && separator.cells(line).all(is_axis)
}

/// What could not be read.
#[derive(Default)]
struct Skipped {
    first_line: usize,
    lines: usize,
    first_row: usize,
    rows: usize,
    cells: usize,
}

impl Skipped {
    fn line(&mut self, number: usize) {
        if self.lines == 0 {
            self.first_line = number;
        }
        self.lines += 1;
    }

    /// A row whose cells do not stand in the columns of their markers.
    fn row(&mut self, number: usize) {
        if self.rows == 0 {
            self.first_row = number;
        }
        self.rows += 1;
    }

    fn report(&self, warnings: &mut Vec<String>) {
        if self.lines > 0 {
            warnings.push(format!(
                "{} lines do not begin with a frame number and were left out, the first is line {}.",
                self.lines, self.first_line
            ));
        }
        if self.rows > 0 {
            warnings.push(format!(
                "{} rows do not have the cells of all markers, or another separator than the others; which cell is whose \
                 is not known, and they are gaps. The first is line {}.",
                self.rows, self.first_row
            ));
        }
        if self.cells > 0 {
            warnings.push(format!(
                "{} samples have cells that are not numbers; they are gaps.",
                self.cells
            ));
        }
    }
}

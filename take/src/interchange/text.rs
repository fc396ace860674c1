//! What the text formats share: lines, cells, numbers, labels.

use std::borrow::Cow;
use std::collections::{HashMap, HashSet};

use super::InterchangeError;
use crate::motion::{GAP, Marker, MotionInfo, Position};

/// Positions a byte of text may claim: a short row next to a wide one must not earn unbounded memory.
pub(super) const MAX_POSITIONS_PER_BYTE: usize = 4;

/// Said of a file whose last number may lack digits.
pub(super) const CUT_OFF: &str =
    "The file ends within its last line; the sample whose number may be cut off there is a gap.";

/// Most frames of so many markers that so many bytes may mean.
pub(super) fn frames_max(n_bytes: usize, n_markers: usize) -> usize {
    n_bytes.saturating_mul(MAX_POSITIONS_PER_BYTE) / n_markers.max(1)
}

/// The lines of a text with their 1-based numbers, without a byte order mark and without line ends (LF or CRLF).
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let bytes = bytes.strip_suffix(b"\n").unwrap_or(bytes);
    bytes
        .split(|&b| b == b'\n')
        .map(|line| line.strip_suffix(b"\r").unwrap_or(line))
        .enumerate()
        .map(|(index, line)| (index + 1, line))
}

/// Text of unknown encoding: UTF-8 where it is valid, Latin-1 otherwise, so that no label is lost.
pub(super) fn decode(bytes: &[u8]) -> String {
    match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().map(|&b| char::from(b)).collect(),
    }
}

/// A cell's number; `None` when it is empty or not a number.
pub(super) fn number(cell: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(cell.trim_ascii()).ok()?;
    text.parse().ok()
}

/// A cell's whole number, also when it is written `12.0`.
pub(super) fn whole_number(cell: &[u8]) -> Option<u64> {
    let value = number(cell)?;
    (value.fract() == 0.0 && (0.0..=9_007_199_254_740_992.0).contains(&value))
        .then_some(value as u64)
}

/// Digits behind the point.
pub(super) fn decimals(cell: &[u8]) -> usize {
    let point = cell.iter().position(|&b| b == b'.');
    let behind = point.and_then(|point| cell.get(point + 1..)).unwrap_or(&[]);
    behind.iter().take_while(|b| b.is_ascii_digit()).count()
}

/// Whether the last number of a text was cut off: no line end stands behind it, and every other number of its column has
/// more digits behind the point. `cells` are those of a line; lines from `first_line` on are compared.
pub(super) fn ends_within_a_number<'a, I: Iterator<Item = &'a [u8]>>(
    bytes: &'a [u8],
    first_line: usize,
    cells: impl Fn(&'a [u8]) -> I,
) -> bool {
    if bytes.ends_with(b"\n") {
        return false;
    }
    let mut lines = lines(bytes).skip(first_line.saturating_sub(1)).map(|(_, line)| line);
    let Some(last) = lines.by_ref().last() else { return false };
    let Some((column, cut)) = cells(last).enumerate().last() else { return false };
    let others = self::lines(bytes).skip(first_line.saturating_sub(1));
    let others = others.filter(|(_, line)| !std::ptr::eq(line.as_ptr(), last.as_ptr()));
    let fewest = others
        .filter_map(|(_, line)| cells(line).nth(column))
        .filter(|cell| number(cell).is_some())
        .map(|cell| decimals(cell.trim_ascii()))
        .min();
    number(cut).is_some() && fewest.is_some_and(|fewest| decimals(cut.trim_ascii()) < fewest)
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
    let mut empty = false;
    let mut damaged = false;
    for value in &mut position {
        match cells.next().map(<[u8]>::trim_ascii) {
            None | Some([]) => empty = true,
            Some(cell) => match number(cell) {
                Some(number) => *value = number,
                None => damaged = true,
            },
        }
    }
    if damaged {
        Cells::Damaged
    } else if empty {
        Cells::Empty
    } else {
        Cells::Position(position)
    }
}

/// The name of a column without one: `u001` for the first.
pub(super) fn unlabelled_name(column: usize) -> String {
    format!("u{:03}", column + 1)
}

/// A marker by the text found in its column: empty, or the very name an unlabelled column has, is unlabelled.
pub(super) fn marker(label: &str, column: usize) -> Marker {
    let unlabelled = unlabelled_name(column);
    if label.is_empty() || label == unlabelled {
        return Marker { label: unlabelled, labelled: false };
    }
    Marker { label: label.to_owned(), labelled: true }
}

/// Most bytes of header lines that are given back: as many markers as a C3D file has, with labels of 60 bytes.
const HEADER_BYTES_MAX: u64 = 1 << 22;

/// The header lines that an importer kept as `kind`; none where there are none, or more than any header has.
pub(super) fn kept_header(info: &MotionInfo, kind: &str) -> std::io::Result<Vec<u8>> {
    let part = info.foreign.iter().find(|part| part.kind == kind);
    let lines = part.map(|part| part.data.to_vec(HEADER_BYTES_MAX)).transpose()?.flatten();
    Ok(lines.unwrap_or_default())
}

/// A name for each column: the marker's label; `#2`, `#3`... is added where a column before it has that name.
#[must_use]
pub fn column_labels(info: &MotionInfo) -> Vec<String> {
    let mut taken = HashSet::new();
    let mut next_number = HashMap::new();
    let mut names = Vec::with_capacity(info.markers.len());
    for (column, marker) in info.markers.iter().enumerate() {
        let empty = marker.label.trim().is_empty();
        let label = if empty { unlabelled_name(column) } else { marker.label.clone() };
        let mut name = label.clone();
        while !taken.insert(name.clone()) {
            let number = next_number.entry(label.clone()).or_insert(2u32);
            name = format!("{label}#{number}");
            *number += 1;
        }
        names.push(name);
    }
    names
}

/// A text as a cell between tabs: a tab or a line end would shift what follows it.
pub(super) fn plain(text: &str) -> Cow<'_, str> {
    if text.contains(['\t', '\n', '\r']) {
        return Cow::Owned(text.replace(['\t', '\n', '\r'], " "));
    }
    Cow::Borrowed(text)
}

/// The value behind a name and a tab, in lines of such pairs.
pub(super) fn value_of(kept: &[u8], name: &str) -> Option<String> {
    let value = |(_, line): (usize, &[u8])| {
        let value = line.strip_prefix(name.as_bytes())?.strip_prefix(b"\t")?;
        let value = decode(value.trim_ascii());
        (!value.is_empty()).then_some(value)
    };
    lines(kept).find_map(value)
}

/// Rows of different widths: positions as they were read, one list a row.
#[derive(Default)]
pub(super) struct Rows {
    positions: Vec<Position>,
    ends: Vec<usize>,
}

impl Rows {
    /// Appends a position to the row under way.
    pub(super) fn push(&mut self, position: Position) {
        self.positions.push(position);
    }

    /// Ends the row under way.
    pub(super) fn end_row(&mut self) {
        self.ends.push(self.positions.len());
    }

    /// Reads the cells of a row, three a position, and ends it. Empty and damaged cells are gaps where a position
    /// follows, and nothing at the end of the row. Returns how many columns the row fills.
    pub(super) fn read_row(
        &mut self,
        cells: &mut dyn Iterator<Item = &[u8]>,
        damaged: &mut usize,
        position: impl Fn([f64; 3]) -> Position,
    ) -> usize {
        let mut cells = cells.peekable();
        let mut column = 0;
        let mut waiting = 0;
        while cells.peek().is_some() {
            match three_cells(&mut cells) {
                Cells::Position(stored) => {
                    (0..waiting).for_each(|_| self.push(GAP));
                    self.push(position(stored));
                    column += waiting + 1;
                    waiting = 0;
                }
                Cells::Empty => waiting += 1,
                Cells::Damaged => {
                    *damaged += 1;
                    waiting += 1;
                }
            }
        }
        self.end_row();
        column
    }

    /// The position of a column in the last row becomes a gap.
    pub(super) fn drop_cut(&mut self, column: usize) {
        let n_before = self.ends.len().checked_sub(2).and_then(|row| self.ends.get(row));
        let place = n_before.copied().unwrap_or(0).saturating_add(column);
        if let Some(cut) = self.positions.get_mut(place) {
            *cut = GAP;
        }
    }

    /// Puts empty rows before rows, as many as are told for each.
    pub(super) fn put_empty(&mut self, before: &[u64]) {
        if before.is_empty() {
            return;
        }
        let mut start = 0;
        let mut ends = Vec::with_capacity(self.ends.len());
        for (index, &end) in self.ends.iter().enumerate() {
            let n_empty = before.get(index).copied().unwrap_or(0);
            ends.extend((0..n_empty).map(|_| start));
            ends.push(end);
            start = end;
        }
        self.ends = ends;
    }

    /// Number of rows.
    pub(super) fn len(&self) -> usize {
        self.ends.len()
    }

    /// All rows `width` positions wide: gaps where a row is shorter. `Err` when that is more than `n_bytes` of
    /// text can mean.
    pub(super) fn into_rectangle(
        self,
        width: usize,
        n_bytes: usize,
        format: &'static str,
    ) -> Result<Vec<Position>, InterchangeError> {
        let total = width.saturating_mul(self.ends.len());
        if total == self.positions.len() {
            return Ok(self.positions);
        }
        if total > n_bytes.saturating_mul(MAX_POSITIONS_PER_BYTE) {
            return Err(InterchangeError::Malformed {
                format,
                place: "data".to_owned(),
                message: format!(
                    "{} rows as wide as the widest, {width} markers, are more than {n_bytes} bytes of text can \
                     mean; split the file",
                    self.ends.len()
                ),
            });
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

    #[test]
    fn lines_end_in_lf_or_crlf_and_a_byte_order_mark_is_skipped() {
        let found: Vec<_> = lines(b"\xEF\xBB\xBFa\r\nb\n\nc").collect();
        assert_eq!(found, [(1, &b"a"[..]), (2, b"b"), (3, b""), (4, b"c")]);
    }

    #[test]
    fn labels_that_are_not_utf_8_are_read_as_latin_1() {
        assert_eq!(decode(b"kn\xE9e"), "knée");
        assert_eq!(decode("knée".as_bytes()), "knée");
    }

    #[test]
    fn one_wide_row_among_many_short_ones_does_not_earn_memory() {
        let mut rows = Rows::default();
        for _ in 0..1000 {
            rows.end_row();
        }
        rows.push([0.0; 3]);
        rows.end_row();
        assert!(rows.into_rectangle(100_000, 8000, "trc").is_err());
    }
}

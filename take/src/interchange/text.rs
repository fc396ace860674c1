//! What the text formats share: the parsing and formatting of lines, cells, numbers and labels, and the parsed frames, in
//! memory, or in a scratch file if there are many.
//!
//! Frames are not parsed again in each pass, because parsing takes most of the time of a text import; as binary numbers
//! they take less than half of the file's size.

use std::{
    borrow::Cow,
    collections::{HashMap, HashSet},
    io::{self, Read},
};

use super::{
    Result,
    origin::{OriginGaps, OriginScan},
    units::{FileUnit, MotionExtent},
};
use crate::{
    foreign::content::{Content, ContentCursor, ContentWriter, NewScratch},
    motion::{Ambiguity, GAP, Marker, MotionInfo, Notes, Position, is_gap},
    record::Channel,
};

/// The lines of a text with their numbers from 1, without the byte order mark and the line ends (LF or CRLF).
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let bytes = bytes.strip_suffix(b"\n").unwrap_or(bytes);
    let lines = bytes.split(|&b| b == b'\n').map(|line| line.strip_suffix(b"\r").unwrap_or(line));
    (1_usize..).zip(lines)
}

/// Decodes text of unknown encoding: as UTF-8 if it is valid, otherwise as Latin-1, so that every label survives.
pub(super) fn decode(bytes: &[u8]) -> String {
    match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().map(|&b| char::from(b)).collect(),
    }
}

/// Parses a cell as a number; `None` if it is empty or not a number.
pub(super) fn number(cell: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(cell.trim_ascii()).ok()?;
    text.parse().ok()
}

/// A number with its decimal comma replaced by a point; `None` if the cell is not such a number.
pub(super) fn with_point(cell: &[u8]) -> Option<Vec<u8>> {
    let mut number = cell.trim_ascii().to_vec();
    let comma = number.iter().position(|&b| b == b',')?;
    number.get(comma + 1)?.is_ascii_digit().then_some(())?;
    *number.get_mut(comma)? = b'.';
    self::number(&number).map(|_| number)
}

/// Parses a cell as a whole number from 0 to 2^53; `12.0` counts as one.
pub(super) fn whole_number(cell: &[u8]) -> Option<u64> {
    let value = number(cell)?;
    (value.fract() == 0.0 && (0.0..=(1_u64 << 53) as f64).contains(&value)).then_some(value as u64)
}

/// Parses a cell as a rate: a finite number above 0.
pub(super) fn rate(cell: &[u8]) -> Option<f64> {
    number(cell).filter(|&rate| is_rate(rate))
}

/// Whether a number can be a rate: finite and above 0.
pub(super) fn is_rate(number: f64) -> bool {
    number.is_finite() && number > 0.0
}

/// Maximum number of characters of a cell that a message quotes: a line of a terminal.
const QUOTED_MAX: usize = 80;

/// The beginning of a cell, for messages.
pub(super) fn shortened(cell: &str) -> String {
    let mut text: String = cell.chars().take(QUOTED_MAX).collect();
    if text.len() < cell.len() {
        text.push_str("...");
    }
    text
}

/// The number of decimals of a number in a cell.
pub(super) fn decimals(cell: &[u8]) -> usize {
    let point = cell.iter().position(|&b| b == b'.');
    let decimals = point.and_then(|point| cell.get(point + 1..)).unwrap_or(&[]);
    decimals.iter().take_while(|b| b.is_ascii_digit()).count()
}

/// The separator between the cells of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Separator {
    /// One byte between two cells: a tab, a comma or a semicolon. Cells may be empty.
    Byte(u8),
    /// One or more white-space characters. No cell can be empty.
    Spaces,
}

impl Separator {
    pub(super) const COMMA: Self = Self::Byte(b',');
    pub(super) const TAB: Self = Self::Byte(b'\t');

    /// Detects the separator of a line: tab, comma or semicolon, whichever occurs, in this order of preference; else
    /// spaces.
    pub(super) fn of(line: &[u8]) -> Self {
        let found = [b'\t', b',', b';'].into_iter().find(|byte| line.contains(byte));
        found.map_or(Self::Spaces, Self::Byte)
    }

    /// Whether the separator occurs in a line.
    pub(super) fn is_in(self, line: &[u8]) -> bool {
        match self {
            Self::Byte(byte) => line.contains(&byte),
            Self::Spaces => true,
        }
    }

    /// The cells of a line.
    pub(super) fn cells(self, line: &[u8]) -> impl Iterator<Item = &[u8]> {
        let is_between = move |byte: &u8| match self {
            Self::Byte(separator) => *byte == separator,
            Self::Spaces => byte.is_ascii_whitespace(),
        };
        let line = if self == Self::Spaces { line.trim_ascii() } else { line };
        line.split(is_between).filter(move |cell| self != Self::Spaces || !cell.is_empty())
    }
}

/// The marker of a column by its label. A label that is empty or the default name of that column is an unlabelled
/// marker.
pub(super) fn marker(label: &str, column: usize) -> Marker {
    let unlabelled = Channel::unlabelled_name(column);
    if label.is_empty() || label == unlabelled {
        return Marker { label: unlabelled, labelled: false };
    }
    Marker { label: label.to_owned(), labelled: true }
}

/// The markers of `width` columns by their labels.
pub(super) fn markers(labels: &[String], width: usize) -> Vec<Marker> {
    (0..width).map(|column| marker(labels.get(column).map_or("", String::as_str), column)).collect()
}

/// Maximum number of bytes of header lines to restore: enough for 65535 markers, the maximum of a C3D file, with labels
/// of 60 bytes.
const HEADER_BYTES_MAX: u64 = 1 << 22;

/// The header lines that the importer kept as `kind`; empty if there are none or more than [`HEADER_BYTES_MAX`].
pub(super) fn kept_header(info: &MotionInfo, kind: &str) -> io::Result<Vec<u8>> {
    let part = info.foreign.iter().find(|part| part.kind == kind);
    let lines = part.map(|part| part.data.to_vec(HEADER_BYTES_MAX)).transpose()?.flatten();
    Ok(lines.unwrap_or_default())
}

/// A unique name for each column: the marker's label, with `#2`, `#3`... appended if an earlier column has that name.
#[must_use]
pub fn column_labels(info: &MotionInfo) -> Vec<String> {
    unique_names(info.markers.iter().enumerate().map(|(column, marker)| {
        let empty = marker.label.trim().is_empty();
        if empty { Channel::unlabelled_name(column) } else { marker.label.clone() }
    }))
}

/// The names with `#2`, `#3`... appended to those that repeat.
pub(super) fn unique_names(names: impl Iterator<Item = String>) -> Vec<String> {
    let mut taken = HashSet::new();
    let mut next_number = HashMap::new();
    let mut unique = Vec::new();
    for given in names {
        let mut name = given.clone();
        while !taken.insert(name.clone()) {
            let number = next_number.entry(given.clone()).or_insert(2u32);
            name = format!("{given}#{number}");
            *number += 1;
        }
        unique.push(name);
    }
    unique
}

/// A text without tabs and line ends, which would shift the cells after it.
pub(super) fn without_tabs(text: &str) -> Cow<'_, str> {
    if text.contains(['\t', '\n', '\r']) {
        return Cow::Owned(text.replace(['\t', '\n', '\r'], " "));
    }
    Cow::Borrowed(text)
}

/// The value of a name in lines of a name, a tab and a value.
pub(super) fn value_of(kept: &[u8], name: &str) -> Option<String> {
    let value = |(_, line): (usize, &[u8])| {
        let value = line.strip_prefix(name.as_bytes())?.strip_prefix(b"\t")?;
        let value = decode(value.trim_ascii());
        (!value.is_empty()).then_some(value)
    };
    lines(kept).find_map(value)
}

/// Bytes of a stored position.
pub(super) const POSITION_BYTES: usize = 12;

/// This NaN, which no position has, is stored as 0, so that zeros are a sample that was never written.
const NEVER_WRITTEN: u32 = 0x7fc0_0001;

/// A position as it is stored.
pub(super) fn stored(position: Position) -> [u8; POSITION_BYTES] {
    let mut bytes = [0; POSITION_BYTES];
    for (bytes, value) in bytes.as_chunks_mut().0.iter_mut().zip(position) {
        *bytes = (value.to_bits() ^ NEVER_WRITTEN).to_le_bytes();
    }
    bytes
}

fn restored(bytes: [u8; POSITION_BYTES]) -> Position {
    let mut position = GAP;
    for (value, &bytes) in position.iter_mut().zip(bytes.as_chunks().0) {
        *value = f32::from_bits(u32::from_le_bytes(bytes) ^ NEVER_WRITTEN);
    }
    if is_gap(position) { GAP } else { position }
}

/// Writes rows of any length: each its number of positions as a `u32`, and these.
pub(super) struct RowWriter<'a> {
    out: ContentWriter<'a>,
    row: Vec<u8>,
}

impl<'a> RowWriter<'a> {
    pub(super) fn new(new_scratch: NewScratch<'a>) -> Self {
        Self { out: ContentWriter::new(new_scratch), row: Vec::new() }
    }

    /// Appends a row. Gaps at its end take no bytes.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn write(&mut self, row: &[Position]) -> io::Result<()> {
        let n_filled = row.iter().rposition(|&at| !is_gap(at)).map_or(0, |last| last + 1);
        self.row.clear();
        // A line has fewer bytes than a `u32` counts.
        self.row.extend((n_filled as u32).to_le_bytes());
        self.row.extend(row.iter().take(n_filled).flat_map(|&position| stored(position)));
        self.out.write(&self.row)
    }

    /// All rows.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn finish(self) -> io::Result<Content> {
        self.out.finish()
    }
}

/// What samples exactly at the origin mean in a format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum AtOrigin {
    /// Positions.
    Positions,
    /// Positions, which the program that wrote the file may have meant as missing samples.
    Doubtful,
    /// Missing samples, if the motion does not pass through the origin.
    Missing,
}

/// The frames of a text file, one after another.
#[derive(Debug)]
pub(super) struct TextFrames {
    stored: ContentCursor,
    n_frames: u64,
    n_markers: usize,
    /// Whether all rows are complete, and have no length.
    is_rectangle: bool,
    /// For each row the number of frames without a row just before it; empty if there are none.
    missing_before: Vec<u64>,
    origin_gaps: Option<OriginGaps>,
    /// Number of the next frame, and of the next row.
    next: u64,
    next_row: usize,
    /// Frames to deliver before the next row; `None` if they are not counted yet.
    n_empty: Option<u64>,
    bytes: Vec<u8>,
}

impl TextFrames {
    /// The frames of [written](RowWriter) rows: `n_frames` of `n_markers`.
    pub(super) fn of_rows(
        rows: Content,
        (n_frames, n_markers): (u64, usize),
        missing_before: Vec<u64>,
    ) -> Self {
        Self {
            stored: ContentCursor::new(rows),
            n_frames,
            n_markers,
            is_rectangle: false,
            missing_before,
            origin_gaps: None,
            next: 0,
            next_row: 0,
            n_empty: None,
            bytes: Vec::new(),
        }
    }

    /// The frames of `n_frames` times `n_markers` [`stored`] positions; zeros are gaps.
    pub(super) fn of_rectangle(positions: Content, (n_frames, n_markers): (u64, usize)) -> Self {
        let frames = Self::of_rows(positions, (n_frames, n_markers), Vec::new());
        Self { is_rectangle: true, ..frames }
    }

    /// Returns to the first frame.
    pub(super) fn rewind(&mut self) {
        self.stored.rewind();
        (self.next, self.next_row, self.n_empty) = (0, 0, None);
        self.origin_gaps.iter_mut().for_each(OriginGaps::rewind);
    }

    /// Fills `row`, one position per marker. `false` at the end.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        if self.next >= self.n_frames {
            return Ok(false);
        }
        self.next += 1;
        let missing_before = self.missing_before.get(self.next_row).copied().unwrap_or(0);
        match self.n_empty.unwrap_or(missing_before).checked_sub(1) {
            Some(n_left) => {
                self.n_empty = Some(n_left);
                row.fill(GAP);
            }
            None => {
                (self.n_empty, self.next_row) = (None, self.next_row + 1);
                self.read_row(row)?;
            }
        }
        Ok(true)
    }

    fn read_row(&mut self, row: &mut [Position]) -> io::Result<()> {
        let n_stored = if self.is_rectangle {
            self.n_markers
        } else {
            let mut n_stored = [0; 4];
            self.stored.read_exact(&mut n_stored)?;
            u32::from_le_bytes(n_stored) as usize
        };
        self.bytes.resize(n_stored * POSITION_BYTES, 0);
        self.stored.read_exact(&mut self.bytes)?;
        let mut stored = self.bytes.as_chunks().0.iter();
        for position in row.iter_mut() {
            *position = stored.next().map_or(GAP, |&bytes| restored(bytes));
        }
        if let Some(gaps) = &mut self.origin_gaps {
            gaps.apply(row);
        }
        Ok(())
    }

    /// Calls `visit` with the positions of every frame.
    fn for_each_row(&mut self, visit: &mut dyn FnMut(&[Position])) -> io::Result<()> {
        self.rewind();
        let mut row = vec![GAP; self.n_markers];
        while self.next_frame(&mut row)? {
            visit(&row);
        }
        self.rewind();
        Ok(())
    }

    /// Checks the unit against the extent of the motion, and decides whether samples at the origin are positions or
    /// gaps.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn examine(
        &mut self,
        unit: &FileUnit,
        at_origin: AtOrigin,
        notes: &mut Notes,
    ) -> Result<()> {
        // Without markers there is nothing to measure.
        let n_frames = if self.n_markers == 0 { 0 } else { self.n_frames };
        let n_frames = usize::try_from(n_frames).unwrap_or(usize::MAX);
        let mut extent = MotionExtent::new(n_frames);
        let mut scan = OriginScan::new(self.n_markers);
        self.for_each_row(&mut |row| {
            extent.add_row(row);
            if at_origin != AtOrigin::Positions {
                scan.add_row(row);
            }
        })?;
        if at_origin == AtOrigin::Missing && scan.suspects().next().is_some() {
            let gaps = OriginGaps::find(&scan, n_frames, &mut |visit| self.for_each_row(visit))?;
            let samples = gaps.n_missing();
            if samples > 0 {
                notes.ambiguous(Ambiguity::Origin { samples, gaps: true });
                self.origin_gaps = Some(gaps);
                extent = MotionExtent::new(n_frames);
                self.for_each_row(&mut |row| extent.add_row(row))?;
            }
        }
        unit.check(&mut extent, notes);
        if at_origin == AtOrigin::Doubtful {
            if scan.needs_steps() {
                self.for_each_row(&mut |row| scan.add_steps(row))?;
            }
            scan.note(notes);
        }
        Ok(())
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
    fn cells_are_split_at_the_separator_of_the_line() {
        let cells = |line: &'static str| -> Vec<&str> {
            let line = line.as_bytes();
            let cells = Separator::of(line).cells(line);
            cells.map(|cell| std::str::from_utf8(cell).unwrap_or("?")).collect()
        };
        assert_eq!(cells("1\t0,5\t\tb c"), ["1", "0,5", "", "b c"]);
        assert_eq!(cells("1,,2"), ["1", "", "2"]);
        assert_eq!(cells("  1   0.5 2 "), ["1", "0.5", "2"]);
    }
}

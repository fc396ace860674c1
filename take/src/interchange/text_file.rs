//! A text file that is read line by line, as often as needed, without being held.

use std::io::{BufRead, BufReader, Read};

use super::{
    InterchangeError, Result,
    source_file::{SourceFile, SourceReader},
    text::{self, Separator},
};
use crate::stretch::CHANNELS_MAX;

/// Maximum number of bytes of a line: of each coordinate of as many markers as a take can have, 42 bytes, twice the
/// digits of an f64. Without a bound, a file without line ends would be held as a whole.
const LINE_BYTES_MAX: usize = 1 << 23;

/// Maximum number of bytes of the lines above the data: two of the longest.
const HEADER_BYTES_MAX: usize = 2 * LINE_BYTES_MAX;

/// Bytes that are read at a time: a page of the source.
const BUFFER_BYTES: usize = 1 << 16;

/// Appends a line in the layout that the readers expect to the bytes.
pub(super) type Conversion = dyn Fn(&[u8], &mut Vec<u8>);

/// A text file.
pub(super) struct TextFile<'s, 'a> {
    format: &'static str,
    source: &'s mut SourceFile<'a>,
    conversion: Option<Box<Conversion>>,
}

/// A line, without the byte order mark and the line end (LF or CRLF).
#[derive(Debug, Clone, Copy)]
pub(super) struct Line<'l> {
    /// Its number, from 1.
    pub(super) number: usize,
    pub(super) bytes: &'l [u8],
    /// Whether the file ends before the line does.
    pub(super) is_open: bool,
}

impl<'s, 'a> TextFile<'s, 'a> {
    /// A file of a format, whose name is for messages.
    pub(super) fn new(format: &'static str, source: &'s mut SourceFile<'a>) -> Self {
        Self { format, source, conversion: None }
    }

    /// Converts each line.
    pub(super) fn convert(&mut self, conversion: Box<Conversion>) {
        self.conversion = Some(conversion);
    }

    /// Replaces decimal commas by points in lines that begin with a number or one of `names`, if cells are between tabs and
    /// no such line has a number with a point: then commas separate thousands.
    ///
    /// # Errors
    /// Those of [`Lines::next`].
    pub(super) fn use_decimal_points(&mut self, names: &'static [&'static [u8]]) -> Result<()> {
        let is_of_numbers = move |line: &[u8]| {
            let first = Separator::TAB.cells(line).next().unwrap_or_default().trim_ascii();
            text::number(first).is_some()
                || text::with_point(first).is_some()
                || names.contains(&first)
        };
        let mut has_commas = false;
        let mut lines = self.lines();
        while let Some(Line { bytes: line, .. }) = lines.next()? {
            let may_have = line.contains(&b'\t') && (line.contains(&b',') || line.contains(&b'.'));
            if !may_have || !is_of_numbers(line) {
                continue;
            }
            let has_point = |cell: &[u8]| cell.contains(&b'.') && text::number(cell).is_some();
            if Separator::TAB.cells(line).any(has_point) {
                return Ok(());
            }
            has_commas |= Separator::TAB.cells(line).any(|cell| text::with_point(cell).is_some());
        }
        if has_commas {
            self.convert(Box::new(move |line, out| {
                if !is_of_numbers(line) {
                    out.extend_from_slice(line);
                    return;
                }
                for (index, cell) in Separator::TAB.cells(line).enumerate() {
                    out.extend((index > 0).then_some(b'\t'));
                    match text::with_point(cell) {
                        Some(number) => out.extend_from_slice(&number),
                        None => out.extend_from_slice(cell),
                    }
                }
            }));
        }
        Ok(())
    }

    /// All lines. An empty file has one, which is empty.
    pub(super) fn lines(&mut self) -> Lines<'_, 'a> {
        Lines {
            input: BufReader::with_capacity(BUFFER_BYTES, self.source.reader()),
            format: self.format,
            conversion: self.conversion.as_deref(),
            raw: Vec::new(),
            converted: Vec::new(),
            number: 0,
            n_bytes: 0,
            is_open: false,
        }
    }

    /// The lines below the first `n`.
    ///
    /// # Errors
    /// Those of [`Lines::next`].
    pub(super) fn lines_below(&mut self, n: usize) -> Result<Lines<'_, 'a>> {
        let mut lines = self.lines();
        while lines.number < n && lines.next()?.is_some() {}
        Ok(lines)
    }

    /// Whether the last number of an [open](Lines::is_open) file is probably cut off: every other number of that column
    /// has more decimals. Compares the lines below the first `n_header`.
    ///
    /// # Errors
    /// Those of [`Lines::next`].
    pub(super) fn ends_mid_number(
        &mut self,
        n_header: usize,
        separator: Separator,
    ) -> Result<bool> {
        let (mut last, mut last_number) = (Vec::new(), 0);
        let mut lines = self.lines_below(n_header)?;
        while let Some(line) = lines.next()? {
            last_number = line.number;
            last.clear();
            last.extend_from_slice(line.bytes);
        }
        let Some((column, cut)) = separator.cells(&last).enumerate().last() else {
            return Ok(false);
        };
        if text::number(cut).is_none() {
            return Ok(false);
        }
        let mut fewest = None;
        let mut lines = self.lines_below(n_header)?;
        while let Some(line) = lines.next()?.filter(|line| line.number < last_number) {
            let cell = separator.cells(line.bytes).nth(column);
            let cell = cell.filter(|cell| text::number(cell).is_some());
            let decimals = cell.map(|cell| text::decimals(cell.trim_ascii()));
            fewest = fewest.into_iter().chain(decimals).min();
        }
        Ok(fewest.is_some_and(|fewest| text::decimals(cut.trim_ascii()) < fewest))
    }
}

/// The lines of a file, one after another.
pub(super) struct Lines<'l, 'a> {
    input: BufReader<SourceReader<'l, 'a>>,
    format: &'static str,
    conversion: Option<&'l Conversion>,
    raw: Vec<u8>,
    converted: Vec<u8>,
    /// Number of the last line.
    number: usize,
    n_bytes: u64,
    is_open: bool,
}

impl Lines<'_, '_> {
    /// The next line.
    ///
    /// # Errors
    /// `Malformed` if it has more than [`LINE_BYTES_MAX`]; `Io` if the file cannot be read or has changed.
    pub(super) fn next(&mut self) -> Result<Option<Line<'_>>> {
        self.raw.clear();
        let mut input = (&mut self.input).take(LINE_BYTES_MAX as u64 + 1);
        let n_read = input.read_until(b'\n', &mut self.raw)?;
        if n_read == 0 && self.number > 0 {
            return Ok(None);
        }
        self.number += 1;
        let is_ended = self.raw.ends_with(b"\n");
        if n_read > LINE_BYTES_MAX && !is_ended {
            return Err(self.too_long("the line", LINE_BYTES_MAX));
        }
        let is_first = self.number == 1;
        let mut bytes = without_ends(&self.raw, is_first);
        self.is_open = !is_ended;
        if let Some(convert) = self.conversion {
            self.converted.clear();
            convert(bytes, &mut self.converted);
            self.n_bytes += self.converted.len() as u64 + u64::from(is_ended);
            self.is_open &= !self.converted.is_empty();
            bytes = without_ends(&self.converted, is_first);
        } else {
            self.n_bytes += n_read as u64;
        }
        Ok(Some(Line { number: self.number, bytes, is_open: self.is_open }))
    }

    /// Checks that the lines of the header so far are not too long to be kept.
    ///
    /// # Errors
    /// `Malformed` if they have more than [`HEADER_BYTES_MAX`].
    pub(super) fn check_header(&self) -> Result<()> {
        if self.n_bytes <= HEADER_BYTES_MAX as u64 {
            return Ok(());
        }
        Err(self.too_long("the header", HEADER_BYTES_MAX))
    }

    /// Whether the file ends in the middle of a line; valid after the last line.
    pub(super) fn is_open(&self) -> bool {
        self.is_open
    }

    /// Bytes of the lines so far, with their ends, as converted.
    pub(super) fn n_bytes(&self) -> u64 {
        self.n_bytes
    }

    fn too_long(&self, what: &str, bytes_max: usize) -> InterchangeError {
        let mib = bytes_max >> 20;
        let message = format!(
            "{what} has more than {mib} MiB, more than {CHANNELS_MAX} markers need: not a table of trajectories, or \
             split its columns into several files"
        );
        InterchangeError::malformed(self.format, &format!("line {}", self.number), message)
    }
}

/// A line without its end, and the first one without the byte order mark.
fn without_ends(line: &[u8], is_first: bool) -> &[u8] {
    let line = line.strip_suffix(b"\n").unwrap_or(line);
    let line = line.strip_prefix(b"\xEF\xBB\xBF").filter(|_| is_first).unwrap_or(line);
    line.strip_suffix(b"\r").unwrap_or(line)
}

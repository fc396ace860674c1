//! CSV: the wide and long layouts that `export` writes, the `time,head_x,head_y,head_z,...` dialect, and Motive's
//! export.

pub(super) mod long;
mod motive;
mod rectangle;
pub(super) mod wide;

use std::borrow::Cow;

use super::{
    InterchangeError, ReadOptions, Result,
    source_file::{Conversion, Line, TextFile},
    text::{self, TextFrames},
};
use crate::{escape::to_cell, foreign::content::NewScratch, motion::MotionInfo};

/// Kind of the foreign part with the header lines, each followed by LF: those that begin with `#`, or in Motive's
/// export all lines above the data.
const HEADER: &str = "csv/header";

/// How the frames of a file are read.
#[derive(Debug, Clone, Copy)]
enum CsvLayout {
    Wide,
    /// The line of column names.
    Long(usize),
    Motive,
}

/// Detects the layout of a file, reads everything but the frames, and prepares to deliver those.
pub(super) fn open(
    file: &mut TextFile<'_, '_>,
    options: &ReadOptions,
    new_scratch: NewScratch<'_>,
) -> Result<(MotionInfo, TextFrames)> {
    if let Some(conversion) = to_commas(file)? {
        file.convert(conversion);
    }
    match layout(file)? {
        CsvLayout::Wide => wide::open(file, options, new_scratch),
        CsvLayout::Long(header_line) => long::open(file, header_line, options, new_scratch),
        CsvLayout::Motive => motive::open(file, options, new_scratch),
    }
}

/// The layout, from the first line with content.
fn layout(file: &mut TextFile<'_, '_>) -> Result<CsvLayout> {
    let mut lines = file.lines();
    while let Some(Line { number, bytes: line, .. }) = lines.next()? {
        let content = line.trim_ascii();
        if !content.is_empty() && !content.starts_with(b"#") {
            return Ok(match line {
                _ if long::is_long(line) => CsvLayout::Long(number),
                _ if motive::is_motive(line) => CsvLayout::Motive,
                _ => CsvLayout::Wide,
            });
        }
    }
    Ok(CsvLayout::Wide)
}

fn malformed(line: usize, message: &str) -> InterchangeError {
    InterchangeError::malformed("csv", &format!("line {line}"), message)
}

/// The cells of a line. A cell in quotes may hold commas, and quotes when they are doubled.
struct LineCells<'a> {
    rest: Option<&'a [u8]>,
    separator: u8,
}

impl<'a> LineCells<'a> {
    fn new(line: &'a [u8]) -> Self {
        Self::between(b',', line)
    }

    /// The cells of a line with another separator than commas.
    fn between(separator: u8, line: &'a [u8]) -> Self {
        Self { rest: Some(line), separator }
    }
}

impl<'a> Iterator for LineCells<'a> {
    type Item = Cow<'a, [u8]>;

    fn next(&mut self) -> Option<Self::Item> {
        let rest = self.rest?;
        let Some(quoted) = rest.strip_prefix(b"\"") else {
            let end = rest.iter().position(|&b| b == self.separator);
            self.rest = end.and_then(|end| rest.get(end + 1..));
            return Some(Cow::Borrowed(rest.get(..end.unwrap_or(rest.len())).unwrap_or(rest)));
        };
        let mut cell = Vec::new();
        let mut bytes = quoted.iter().copied().enumerate().peekable();
        while let Some((index, byte)) = bytes.next() {
            if byte != b'"' {
                cell.push(byte);
            } else if bytes.next_if(|&(_, next)| next == b'"').is_some() {
                cell.push(b'"');
            } else {
                let after = quoted.get(index + 1..).unwrap_or(&[]);
                let end = after.iter().position(|&b| b == self.separator);
                self.rest = end.and_then(|end| after.get(end + 1..));
                return Some(Cow::Owned(cell));
            }
        }
        self.rest = None;
        Some(Cow::Owned(cell))
    }
}

/// A text as a cell. Quotes protect separators, quotes, outer spaces and a leading `#`; escapes ([`crate::escape`])
/// stand for characters that would break the line.
#[must_use]
pub fn quote(text: &str) -> Cow<'_, str> {
    let text = to_cell(text);
    if text.contains([',', '"']) || text.trim() != text.as_ref() || text.starts_with('#') {
        return Cow::Owned(format!("\"{}\"", text.replace('"', "\"\"")));
    }
    text
}

/// A conversion of lines to commas between cells and points in numbers, as the readers expect; `None` if they have
/// them already.
///
/// # Errors
/// Those of reading the file.
fn to_commas(file: &mut TextFile<'_, '_>) -> Result<Option<Box<Conversion>>> {
    let Some(separator) = separator(file)? else { return Ok(None) };
    let has_points = has_points(separator, file)?;
    Ok(Some(Box::new(move |line, out| {
        if line.trim_ascii_start().starts_with(b"#") {
            out.extend_from_slice(line);
            return;
        }
        for (index, cell) in LineCells::between(separator, line).enumerate() {
            out.extend((index > 0).then_some(b','));
            put(&cell, has_points, out);
        }
    })))
}

fn put(cell: &[u8], has_points: bool, out: &mut Vec<u8>) {
    if text::number(cell).is_some() {
        out.extend_from_slice(cell.trim_ascii());
    } else if !has_points && let Some(number) = text::with_point(cell) {
        out.extend_from_slice(&number);
    } else {
        out.extend_from_slice(quote(&text::decode(cell.trim_ascii())).as_bytes());
    }
}

/// Whether any number has a decimal point: then commas separate thousands.
fn has_points(separator: u8, file: &mut TextFile<'_, '_>) -> Result<bool> {
    let is_with_point = |cell: &[u8]| cell.contains(&b'.') && text::number(cell).is_some();
    let mut lines = file.lines();
    while let Some(Line { bytes: line, .. }) = lines.next()? {
        if !line.starts_with(b"#")
            && line.contains(&b'.')
            && LineCells::between(separator, line).any(|cell| is_with_point(&cell))
        {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Detects the separator from the line of column names; `None` if the file has commas and no quotes around numbers.
fn separator(file: &mut TextFile<'_, '_>) -> Result<Option<u8>> {
    let mut lines = file.lines();
    let mut commas = None;
    while let Some(Line { bytes: line, .. }) = lines.next()? {
        if line.trim_ascii().is_empty() || line.starts_with(b"#") {
            continue;
        }
        if let Some(commas) = commas {
            return Ok((commas > 1 && line.starts_with(b"\"")).then_some(b','));
        }
        let count = |separator: u8| LineCells::between(separator, line).count();
        let most = [b';', b'\t'].into_iter().max_by_key(|&separator| count(separator));
        if let Some(most) = most.filter(|&most| count(most) > count(b',')) {
            return Ok(Some(most));
        }
        commas = Some(count(b','));
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn quoted_texts_round_trip(texts in proptest::collection::vec("[a-zA-Z\",# .é]{0,8}", 1..6)) {
            let line = texts.iter().map(|t| quote(t).into_owned()).collect::<Vec<_>>().join(",");
            let found: Vec<String> =
                LineCells::new(line.as_bytes()).map(|c| String::from_utf8(c.into_owned()).expect("UTF-8")).collect();
            prop_assert_eq!(found, texts);
        }
    }

    #[test]
    fn an_open_quote_ends_with_the_line() {
        let found: Vec<_> = LineCells::new(b"a,\"b,c").collect();
        assert_eq!(found, [Cow::Borrowed(&b"a"[..]), Cow::Borrowed(b"b,c")]);
    }
}

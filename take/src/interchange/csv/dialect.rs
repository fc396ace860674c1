//! Cells of a line, and how a label becomes one (RFC 4180); and what a file has between them: commas, or semicolons or tabs
//! as spreadsheets write them where the comma is the decimal point.

use std::borrow::Cow;

use crate::{escape::to_cell, interchange::text};

/// The cells of a line. A cell in quotes may hold commas, and quotes when they are doubled.
pub(super) struct LineCells<'a> {
    rest: Option<&'a [u8]>,
    separator: u8,
}

impl<'a> LineCells<'a> {
    pub(super) fn new(line: &'a [u8]) -> Self {
        Self::between(b',', line)
    }

    /// Where something else than commas stands between them.
    pub(super) fn between(separator: u8, line: &'a [u8]) -> Self {
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

/// A text as a cell: in quotes where it would not come back otherwise, with escapes where it would not stay one line of
/// text ([`crate::escape`]).
pub(super) fn quote(text: &str) -> Cow<'_, str> {
    let text = to_cell(text);
    if text.contains([',', '"']) || text.trim() != text.as_ref() || text.starts_with('#') {
        return Cow::Owned(format!("\"{}\"", text.replace('"', "\"\"")));
    }
    text
}

/// The text with commas between its cells and points in its numbers, as the readers want it; the same where it is so.
pub(super) fn with_commas(bytes: &[u8]) -> Cow<'_, [u8]> {
    let Some(separator) = separator(bytes) else { return Cow::Borrowed(bytes) };
    let has_points = has_points(separator, bytes);
    let mut out = Vec::with_capacity(bytes.len() + 64);
    for (_, line) in text::lines(bytes) {
        if line.trim_ascii_start().starts_with(b"#") {
            out.extend_from_slice(line);
        } else {
            for (index, cell) in LineCells::between(separator, line).enumerate() {
                out.extend((index > 0).then_some(b','));
                put(&cell, has_points, &mut out);
            }
        }
        out.push(b'\n');
    }
    // What ends within a line still does.
    if !bytes.ends_with(b"\n") {
        out.pop();
    }
    Cow::Owned(out)
}

fn put(cell: &[u8], has_points: bool, out: &mut Vec<u8>) {
    if text::number(cell).is_some() {
        out.extend_from_slice(cell.trim_ascii());
    } else if !has_points && let Some(number) = with_point(cell) {
        out.extend_from_slice(&number);
    } else {
        out.extend_from_slice(quote(&text::decode(cell.trim_ascii())).as_bytes());
    }
}

/// A number with a decimal comma, with a point.
fn with_point(cell: &[u8]) -> Option<Vec<u8>> {
    let mut number = cell.trim_ascii().to_vec();
    let comma = number.iter().position(|&b| b == b',')?;
    number.get(comma + 1)?.is_ascii_digit().then_some(())?;
    *number.get_mut(comma)? = b'.';
    text::number(&number).map(|_| number)
}

/// Whether a number has a point: then commas stand between thousands.
fn has_points(separator: u8, bytes: &[u8]) -> bool {
    let is_with_point = |cell: &[u8]| cell.contains(&b'.') && text::number(cell).is_some();
    text::lines(bytes).any(|(_, line)| {
        !line.starts_with(b"#")
            && line.contains(&b'.')
            && LineCells::between(separator, line).any(|cell| is_with_point(&cell))
    })
}

/// What stands between the cells, by the names of the columns; `None` for commas, unless numbers are in quotes.
fn separator(bytes: &[u8]) -> Option<u8> {
    let is_content = |line: &[u8]| !line.trim_ascii().is_empty() && !line.starts_with(b"#");
    let mut lines = text::lines(bytes).map(|(_, line)| line).filter(|line| is_content(line));
    let names = lines.next()?;
    let count = |separator: u8| LineCells::between(separator, names).count();
    let commas = count(b',');
    let most = [b';', b'\t'].into_iter().max_by_key(|&separator| count(separator))?;
    if count(most) > commas {
        return Some(most);
    }
    let first_row = lines.next()?;
    (commas > 1 && first_row.starts_with(b"\"")).then_some(b',')
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn quoted_texts_come_back(texts in proptest::collection::vec("[a-zA-Z\",# .é]{0,8}", 1..6)) {
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

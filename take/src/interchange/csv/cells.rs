//! Cells of a line, and how a label becomes one (RFC 4180).

use std::borrow::Cow;

use crate::escape::to_cell;

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

//! What a CSV file has between its cells: commas, or semicolons or tabs as spreadsheets write them where the comma is the
//! decimal point.

use std::borrow::Cow;

use super::cells::{LineCells, quote};
use crate::interchange::text;

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

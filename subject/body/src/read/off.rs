//! Geomview OFF: a keyword, three counts, one line per vertex, one line per face.

use super::surface::{Surface, put_corner};
use super::{Format, ReadError, text};

/// Reads an OFF file. Colours, normals and texture coordinates are ignored.
pub(super) fn read(bytes: &[u8]) -> Result<Surface, ReadError> {
    let mut surface = Surface::new(Format::Off);
    let mut lines = text::lines(text::without_bom(bytes))
        .map(|(number, line)| (number, text::before_comment(line)))
        .filter(|(_, line)| !line.trim_ascii().is_empty());
    let (number, line) = lines.next().unwrap_or((1, &[]));
    let mut tokens = text::tokens(line).peekable();
    let keyword = tokens.next().unwrap_or_default();
    if keyword.contains(&b'4') || keyword.contains(&b'n') {
        let what = format!("{}, of more than three dimensions,", text::quote(keyword));
        return Err(ReadError::Unsupported { format: Format::Off, what });
    }
    if tokens.peek().is_some_and(|token| token.eq_ignore_ascii_case(b"BINARY")) {
        let what = "its binary form".to_owned();
        return Err(ReadError::Unsupported { format: Format::Off, what });
    }
    // Some writers put the counts on the line of the keyword.
    let counts = if tokens.peek().is_some() {
        counts(number, &mut tokens)
    } else {
        let (number, line) = lines.next().unwrap_or((number, &[]));
        counts(number, &mut text::tokens(line))
    };
    let (n_vertices, n_faces) = counts?;
    for found in 0..n_vertices {
        let (number, line) = lines.next().ok_or_else(|| cut_off("vertices", n_vertices, found))?;
        let wrong = || Format::Off.unexpected(number, "three numbers", line);
        surface.vertex(text::position(&mut text::tokens(line)).ok_or_else(wrong)?)?;
    }
    let mut corners = Vec::new();
    for found in 0..n_faces {
        let (number, line) = lines.next().ok_or_else(|| cut_off("faces", n_faces, found))?;
        let mut tokens = text::tokens(line);
        let wrong = || Format::Off.unexpected(number, "a count and as many indices", line);
        let count = tokens.next().and_then(text::integer).ok_or_else(wrong)?;
        corners.clear();
        for _ in 0..count {
            let index = tokens.next().and_then(text::integer).ok_or_else(wrong)?;
            put_corner(&mut corners, u32::try_from(index).map_err(|_| wrong())?)?;
        }
        surface.face(&corners)?;
    }
    Ok(surface)
}

/// The counts of vertices and faces; that of edges is not needed and often 0.
fn counts(number: usize, tokens: &mut dyn Iterator<Item = &[u8]>) -> Result<(u64, u64), ReadError> {
    let mut next = || tokens.next().and_then(text::integer).and_then(|n| u64::try_from(n).ok());
    let counts = next().zip(next());
    counts.ok_or_else(|| {
        Format::Off.malformed_line(number, "expected the counts of vertices and faces")
    })
}

fn cut_off(what: &str, announced: u64, found: u64) -> ReadError {
    let reason =
        format!("expected {announced} {what}, found {found}: cut off, export the scan again");
    Format::Off.malformed("end of file", reason)
}

//! Wavefront OBJ: lines of `v x y z` and `f v/vt/vn ...`; other lines do not affect the surface.

use super::surface::{Surface, put_corner};
use super::{Format, ReadError, text};
use crate::{Note, Unit};

/// Reads an OBJ file. Indices count from 1, or backwards from the latest vertex if negative, and may name vertices that
/// follow.
pub(super) fn read(bytes: &[u8]) -> Result<Surface, ReadError> {
    let mut surface = Surface::new(Format::Obj);
    let mut corners = Vec::new();
    let mut joined = Vec::new();
    let mut curved = 0_usize;
    for (number, line) in text::lines(text::without_bom(bytes)) {
        if surface.unit.is_none() && line.first() == Some(&b'#') {
            surface.unit = Unit::from_comment(line);
        }
        let line = text::before_comment(line);
        // A backslash at the end continues the line.
        if let Some(front) = line.trim_ascii_end().strip_suffix(b"\\") {
            joined.extend_from_slice(front);
            joined.push(b' ');
            continue;
        }
        let whole;
        let line = if joined.is_empty() {
            line
        } else {
            joined.extend_from_slice(line);
            whole = std::mem::take(&mut joined);
            &whole
        };
        let mut tokens = text::tokens(line);
        match tokens.next() {
            Some(b"v") => {
                let wrong = || Format::Obj.unexpected(number, "`v` and three numbers", line);
                surface.vertex(text::position(&mut tokens).ok_or_else(wrong)?)?;
            }
            Some(b"f") => {
                corners.clear();
                for token in tokens {
                    let wrong = || Format::Obj.unexpected(number, "the index of a vertex", token);
                    let index = index(token, surface.n_vertices()).ok_or_else(wrong)?;
                    put_corner(&mut corners, index)?;
                }
                surface.face(&corners)?;
            }
            Some(b"curv" | b"curv2" | b"surf") => curved += 1,
            _ => {}
        }
    }
    if curved > 0 {
        let text = format!("left out curved surfaces: {curved}");
        surface.notes.push(Note::new("curved-surfaces", text));
    }
    Ok(surface)
}

/// Parses `7`, `7/1`, `7//3`, `7/1/3` or `-1` as an index from 0; 0 is invalid.
fn index(token: &[u8], n_vertices: usize) -> Option<u32> {
    let vertex = token.split(|&b| b == b'/').next()?;
    let number = text::integer(vertex)?;
    let index = if number < 0 { (n_vertices as i64).checked_add(number)? } else { number - 1 };
    u32::try_from(index).ok()
}

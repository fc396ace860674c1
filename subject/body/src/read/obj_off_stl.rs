//! The formats Wavefront OBJ, Geomview OFF and STL (stereolithography), and the lines, tokens and numbers that all
//! text formats share.

use std::collections::HashMap;

use super::{Format, ReadError, Surface, put_corner};
use crate::{Note, Unit};

/// Maximum number of bytes of foreign text that a message quotes.
const QUOTE_MAX: usize = 24;

/// Strips a UTF-8 byte order mark.
pub(super) fn without_bom(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(&[0xef, 0xbb, 0xbf]).unwrap_or(bytes)
}

/// Lines with their numbers from 1. Line ends are LF, CR LF, or CR alone if there is no LF.
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let end = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    bytes
        .split(move |&b| b == end)
        .enumerate()
        .map(|(i, line)| (i + 1, line.strip_suffix(b"\r").unwrap_or(line)))
}

/// Tokens separated by white space.
pub(super) fn tokens(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|token| !token.is_empty())
}

/// The line up to a `#` that begins a token.
pub(super) fn before_comment(line: &[u8]) -> &[u8] {
    let begins = |at: &usize| {
        line.get(*at) == Some(&b'#')
            && at.checked_sub(1).and_then(|at| line.get(at)).is_none_or(u8::is_ascii_whitespace)
    };
    (0..line.len()).find(begins).and_then(|at| line.get(..at)).unwrap_or(line)
}

/// Parses a number, including the ways in which programs write "not a number".
pub(super) fn number(token: &[u8]) -> Option<f64> {
    let token = std::str::from_utf8(token).ok()?;
    if let Ok(number) = token.parse() {
        return Some(number);
    }
    // Microsoft's run-time library: `-1.#IND`, `1.#QNAN`, `1.#INF`.
    let odd = token.trim_start_matches(['-', '+']);
    odd.starts_with("1.#").then_some(f64::NAN)
}

/// Parses an integer.
pub(super) fn integer(token: &[u8]) -> Option<i64> {
    std::str::from_utf8(token).ok()?.parse().ok()
}

/// The next three tokens as a position.
pub(super) fn position(tokens: &mut dyn Iterator<Item = &[u8]>) -> Option<[f64; 3]> {
    let mut next = || number(tokens.next()?);
    Some([next()?, next()?, next()?])
}

/// Quotes a piece of a file: short, and without control characters.
pub(super) fn quote(bytes: &[u8]) -> String {
    let short = bytes.get(..QUOTE_MAX).unwrap_or(bytes);
    let dots = if short.len() < bytes.len() { "..." } else { "" };
    format!("`{}{dots}`", short.escape_ascii())
}

/// Reads an OBJ file. Indices count from 1, or backwards from the latest vertex if negative, and may name vertices that
/// follow.
pub(super) fn read_obj(bytes: &[u8]) -> Result<Surface, ReadError> {
    let mut surface = Surface::new(Format::Obj);
    let mut corners = Vec::new();
    let mut joined = Vec::new();
    let mut curved = 0_usize;
    for (number, line) in lines(without_bom(bytes)) {
        if surface.unit.is_none() && line.first() == Some(&b'#') {
            surface.unit = Unit::from_comment(line);
        }
        let line = before_comment(line);
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
        let mut tokens = tokens(line);
        match tokens.next() {
            Some(b"v") => {
                let wrong = || Format::Obj.unexpected(number, "`v` and three numbers", line);
                surface.vertex(position(&mut tokens).ok_or_else(wrong)?)?;
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
    let number = integer(vertex)?;
    let index = if number < 0 { (n_vertices as i64).checked_add(number)? } else { number - 1 };
    u32::try_from(index).ok()
}

/// Reads an OFF file. Colours, normals and texture coordinates are ignored.
pub(super) fn read_off(bytes: &[u8]) -> Result<Surface, ReadError> {
    let mut surface = Surface::new(Format::Off);
    let mut lines = lines(without_bom(bytes))
        .map(|(number, line)| (number, before_comment(line)))
        .filter(|(_, line)| !line.trim_ascii().is_empty());
    let (number, line) = lines.next().unwrap_or((1, &[]));
    let mut keywords = tokens(line).peekable();
    let keyword = keywords.next().unwrap_or_default();
    if keyword.contains(&b'4') || keyword.contains(&b'n') {
        let what = format!("{}, of more than three dimensions,", quote(keyword));
        return Err(ReadError::Unsupported { format: Format::Off, what });
    }
    if keywords.peek().is_some_and(|token| token.eq_ignore_ascii_case(b"BINARY")) {
        let what = "its binary form".to_owned();
        return Err(ReadError::Unsupported { format: Format::Off, what });
    }
    // Some writers put the counts on the line of the keyword.
    let counts = if keywords.peek().is_some() {
        counts(number, &mut keywords)
    } else {
        let (number, line) = lines.next().unwrap_or((number, &[]));
        counts(number, &mut tokens(line))
    };
    let (n_vertices, n_faces) = counts?;
    for found in 0..n_vertices {
        let (number, line) = lines.next().ok_or_else(|| cut_off("vertices", n_vertices, found))?;
        let wrong = || Format::Off.unexpected(number, "three numbers", line);
        surface.vertex(position(&mut tokens(line)).ok_or_else(wrong)?)?;
    }
    let mut corners = Vec::new();
    for found in 0..n_faces {
        let (number, line) = lines.next().ok_or_else(|| cut_off("faces", n_faces, found))?;
        let mut numbers = tokens(line);
        let wrong = || Format::Off.unexpected(number, "a count and as many indices", line);
        let count = numbers.next().and_then(integer).ok_or_else(wrong)?;
        corners.clear();
        for _ in 0..count {
            let index = numbers.next().and_then(integer).ok_or_else(wrong)?;
            put_corner(&mut corners, u32::try_from(index).map_err(|_| wrong())?)?;
        }
        surface.face(&corners)?;
    }
    Ok(surface)
}

/// The counts of vertices and faces; that of edges is not needed and often 0.
fn counts(number: usize, tokens: &mut dyn Iterator<Item = &[u8]>) -> Result<(u64, u64), ReadError> {
    let mut next = || tokens.next().and_then(integer).and_then(|n| u64::try_from(n).ok());
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

/// Length of the title in a binary file.
const TITLE: usize = 80;
/// Length of the title and the count.
const HEAD: usize = TITLE + 4;
/// Length of a triangle: a normal and three corners as float32, two attribute bytes.
const RECORD: usize = 50;

/// Whether the length is exactly that of a binary file with the announced number of triangles.
pub(super) fn fits_binary_stl(bytes: &[u8]) -> bool {
    announced(bytes)
        .is_some_and(|n| n > 0 && bytes.len() as u64 == HEAD as u64 + RECORD as u64 * u64::from(n))
}

/// Reads an STL file.
pub(super) fn read_stl(bytes: &[u8]) -> Result<Surface, ReadError> {
    let mut triangles = Triangles { surface: Surface::new(Format::Stl), vertices: HashMap::new() };
    let is_text = tokens(bytes.get(..HEAD).unwrap_or(bytes)).next() == Some(b"solid");
    if is_text && !fits_binary_stl(bytes) {
        read_text_stl(bytes, &mut triangles)?;
    } else {
        read_binary_stl(bytes, &mut triangles)?;
    }
    Ok(triangles.surface)
}

fn announced(bytes: &[u8]) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(TITLE..)?.first_chunk()?))
}

fn read_binary_stl(bytes: &[u8], triangles: &mut Triangles) -> Result<(), ReadError> {
    let records = bytes.get(HEAD..).unwrap_or_default();
    let whole = records.len() / RECORD;
    let n = announced(bytes).unwrap_or(0) as usize;
    if n == 0 || whole < n {
        let reason = format!(
            "expected {n} triangles, found {whole}: cut off or not a mesh, export the scan again"
        );
        return Err(Format::Stl.malformed(format!("byte {TITLE}"), reason));
    }
    for record in records.chunks_exact(RECORD).take(n) {
        let float = |at: usize| {
            let bytes = record.get(at..).and_then(<[u8]>::first_chunk);
            bytes.map_or(f64::NAN, |&bytes| f32::from_le_bytes(bytes).into())
        };
        let corner = |k: usize| [float(12 + 12 * k), float(16 + 12 * k), float(20 + 12 * k)];
        triangles.push([corner(0), corner(1), corner(2)])?;
    }
    Ok(())
}

fn read_text_stl(bytes: &[u8], triangles: &mut Triangles) -> Result<(), ReadError> {
    let mut corners = Vec::with_capacity(4);
    let (mut in_facet, mut ended) = (false, false);
    for (number, line) in lines(bytes) {
        let mut tokens = tokens(line);
        let Some(token) = tokens.next() else { continue };
        let wrong = |expected: &str| Format::Stl.unexpected(number, expected, line);
        if token.eq_ignore_ascii_case(b"vertex") {
            if corners.len() == 3 {
                return Err(wrong("three corners a facet"));
            }
            let corner = position(&mut tokens);
            corners.push(corner.ok_or_else(|| wrong("`vertex` and three numbers"))?);
        } else if token.eq_ignore_ascii_case(b"facet") {
            if in_facet {
                return Err(wrong("`endfacet`"));
            }
            (in_facet, ended) = (true, false);
            corners.clear();
        } else if token.eq_ignore_ascii_case(b"endfacet") {
            let [a, b, c] = corners[..] else { return Err(wrong("three corners a facet")) };
            triangles.push([a, b, c])?;
            in_facet = false;
            corners.clear();
        } else if token.eq_ignore_ascii_case(b"endsolid") {
            ended = true;
        }
    }
    if in_facet || !ended {
        let reason = "expected `endsolid`, found none: cut off, export the scan again";
        return Err(Format::Stl.malformed("end of file", reason));
    }
    Ok(())
}

/// Triangles that share corners by position.
struct Triangles {
    surface: Surface,
    vertices: HashMap<[u64; 3], u32>,
}

impl Triangles {
    fn push(&mut self, corners: [[f64; 3]; 3]) -> Result<(), ReadError> {
        let mut indices = [0; 3];
        for (index, corner) in indices.iter_mut().zip(corners) {
            // Adding zero unifies both zeros.
            let key = corner.map(|c| (c + 0.0).to_bits());
            let next = self.surface.n_vertices() as u32;
            *index = *self.vertices.entry(key).or_insert(next);
            if *index == next {
                self.surface.vertex(corner)?;
            }
        }
        self.surface.face(&indices)
    }
}

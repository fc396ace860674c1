//! STL (stereolithography): separate triangles, text or binary. Corners at one position become one vertex.

use std::collections::HashMap;

use super::surface::Surface;
use super::{Format, ReadError, text};

/// Length of the title in a binary file.
const TITLE: usize = 80;
/// Length of the title and the count.
const HEAD: usize = TITLE + 4;
/// Length of a triangle: a normal and three corners as float32, two attribute bytes.
const RECORD: usize = 50;

/// Whether the length is exactly that of a binary file with the announced number of triangles.
pub(super) fn binary_fits(bytes: &[u8]) -> bool {
    announced(bytes)
        .is_some_and(|n| n > 0 && bytes.len() as u64 == HEAD as u64 + RECORD as u64 * u64::from(n))
}

/// Reads an STL file.
pub(super) fn read(bytes: &[u8]) -> Result<Surface, ReadError> {
    let mut triangles = Triangles { surface: Surface::new(Format::Stl), vertices: HashMap::new() };
    let is_text = text::tokens(bytes.get(..HEAD).unwrap_or(bytes)).next() == Some(b"solid");
    if is_text && !binary_fits(bytes) {
        read_text(bytes, &mut triangles)?;
    } else {
        read_binary(bytes, &mut triangles)?;
    }
    Ok(triangles.surface)
}

fn announced(bytes: &[u8]) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(TITLE..)?.first_chunk()?))
}

fn read_binary(bytes: &[u8], triangles: &mut Triangles) -> Result<(), ReadError> {
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

fn read_text(bytes: &[u8], triangles: &mut Triangles) -> Result<(), ReadError> {
    let mut corners = Vec::with_capacity(4);
    let (mut in_facet, mut ended) = (false, false);
    for (number, line) in text::lines(bytes) {
        let mut tokens = text::tokens(line);
        let Some(token) = tokens.next() else { continue };
        let wrong = |expected: &str| Format::Stl.unexpected(number, expected, line);
        if token.eq_ignore_ascii_case(b"vertex") {
            if corners.len() == 3 {
                return Err(wrong("three corners a facet"));
            }
            let corner = text::position(&mut tokens);
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

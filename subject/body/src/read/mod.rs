//! Mesh files: OBJ, PLY (text, binary of both byte orders), STL (text, binary) and OFF.
//!
//! The content says which format it is; the name's ending is asked only where the content leaves it open. Nothing is
//! allocated on a number that a file merely claims: every vertex and face stands in the bytes that were given.

mod obj;
mod off;
mod ply;
mod stl;
mod surface;
#[cfg(test)]
mod tests;
mod text;

use std::fmt;

use super::{Mesh, Note, Unit};

/// Bytes of a file that are read at most: five million triangles as text need less.
pub const BYTES_MAX: usize = 1 << 30;
/// Triangles of a mesh that are read at most. A body scanner gives 0.1 to 2 million.
pub const FACES_MAX: usize = 5_000_000;
/// Vertices of a mesh that are read at most: three a face, as where none are shared.
pub const VERTICES_MAX: usize = 3 * FACES_MAX;

/// A mesh as the file has it: polygons are triangles, every position is finite, every index is of a position. Whether it
/// is one clean surface is for [`repair`](super::repair) to see.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// The surface, in the file's own unit.
    pub mesh: Mesh,
    /// What the file was.
    pub format: Format,
    /// The unit, where a comment of the file tells it.
    pub unit: Option<Unit>,
    /// What a reader of the result should know of the file.
    pub notes: Vec<Note>,
}

/// Reads a whole file. `name` is that of the file: only its ending is looked at, and only as a hint.
///
/// # Errors
/// [`ReadError`], by what to do about it.
pub fn read(bytes: &[u8], name: &str) -> Result<Scan, ReadError> {
    if bytes.is_empty() {
        return Err(ReadError::Empty);
    }
    if bytes.len() > BYTES_MAX {
        return Err(ReadError::TooLarge { what: "bytes", found: bytes.len(), limit: BYTES_MAX });
    }
    let format = format(bytes, name)?;
    let surface = match format {
        Format::Obj => obj::read(bytes)?,
        Format::Ply => ply::read(bytes)?,
        Format::Stl => stl::read(bytes)?,
        Format::Off => off::read(bytes)?,
    };
    let mut scan = surface.finish()?;
    if let Some(ending) = Format::from_name(name)
        && ending != format
    {
        let text = format!("the name says {ending}, the content is {format}: read as {format}");
        scan.notes.push(Note::new("other-ending", text));
    }
    Ok(scan)
}

/// A format of meshes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Wavefront's text.
    Obj,
    /// The polygon format of Stanford, text or binary.
    Ply,
    /// Triangles of stereolithography, text or binary.
    Stl,
    /// The object file format of Geomview, text.
    Off,
}

impl Format {
    /// By the ending of a file's name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        let (_, ending) = name.rsplit_once('.')?;
        match ending.to_ascii_lowercase().as_str() {
            "obj" => Some(Self::Obj),
            "ply" => Some(Self::Ply),
            "stl" => Some(Self::Stl),
            "off" => Some(Self::Off),
            _ => None,
        }
    }

    /// That a file does not keep to this format, by where and why.
    fn malformed(self, place: impl Into<String>, reason: impl Into<String>) -> ReadError {
        ReadError::Malformed { format: self, place: place.into(), reason: reason.into() }
    }

    fn malformed_line(self, number: usize, reason: impl Into<String>) -> ReadError {
        self.malformed(format!("line {number}"), reason)
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Obj => "OBJ",
            Self::Ply => "PLY",
            Self::Stl => "STL",
            Self::Off => "OFF",
        })
    }
}

/// Words that lines of an OBJ begin with.
const OBJ_KEYWORDS: [&[u8]; 11] =
    [b"v", b"vt", b"vn", b"vp", b"f", b"o", b"g", b"s", b"l", b"mtllib", b"usemtl"];
/// Lines in which the first word of an OBJ must stand: comments of exporters are shorter.
const OBJ_LINES: usize = 1000;

fn format(bytes: &[u8], name: &str) -> Result<Format, ReadError> {
    let bytes = text::without_bom(bytes);
    if matches!(bytes, [b'p', b'l', b'y', b'\r' | b'\n', ..]) {
        return Ok(Format::Ply);
    }
    // Before the others: a binary STL may begin with any text at all.
    if stl::binary_fits(bytes) {
        return Ok(Format::Stl);
    }
    let mut lines = text::lines(bytes)
        .take(OBJ_LINES)
        .filter_map(|(_, line)| text::tokens(text::before_comment(line)).next());
    let first = lines.next().unwrap_or_default();
    if first.ends_with(b"OFF") && first.len() <= 9 && first.iter().all(u8::is_ascii_alphanumeric) {
        return Ok(Format::Off);
    }
    if first.eq_ignore_ascii_case(b"solid") {
        return Ok(Format::Stl);
    }
    if OBJ_KEYWORDS.contains(&first) || lines.any(|token| OBJ_KEYWORDS.contains(&token)) {
        return Ok(Format::Obj);
    }
    Format::from_name(name).ok_or_else(|| ReadError::Unknown { found: describe(bytes).to_owned() })
}

/// What people give instead.
fn describe(bytes: &[u8]) -> &'static str {
    match bytes {
        [0x1f, 0x8b, ..] => "a gzip file: unpack it first",
        [b'P', b'K', 3, 4, ..] => "a ZIP archive, perhaps 3MF: unpack it first",
        [b'g', b'l', b'T', b'F', ..] => "a binary glTF",
        [b'K', b'a', b'y', b'd', b'a', b'r', b'a', ..] => "an FBX",
        [b'#', b'V', b'R', b'M', b'L', ..] => "a VRML world",
        [b'<', ..] => "an XML document",
        [b'{', ..] => "a JSON document",
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => "a text in UTF-16: save it as UTF-8",
        _ => "its beginning is of no known format",
    }
}

/// A file that was not read, by what to do about it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// No bytes at all.
    #[error("the file is empty: export the scan again")]
    Empty,
    /// None of the formats.
    #[error("not a mesh that can be read ({found}): export it as OBJ, PLY, STL or OFF")]
    Unknown {
        /// What it seems to be.
        found: String,
    },
    /// The file does not keep to its format, or is cut off.
    #[error("{format}, {place}: {reason}")]
    Malformed {
        /// The format.
        format: Format,
        /// `line 12`, `byte 4096`, `face 7`.
        place: String,
        /// What was expected, and what was found.
        reason: String,
    },
    /// In the format, but of a kind that is not read.
    #[error("{format}: {what} is not read: export it as plain text or binary triangles")]
    Unsupported {
        /// The format.
        format: Format,
        /// The kind.
        what: String,
    },
    /// Beyond what memory is kept for.
    #[error("{found} {what}, at most {limit} are read: decimate the mesh in the scanner's program")]
    TooLarge {
        /// Of what: `faces`.
        what: &'static str,
        /// How many there are, or more.
        found: usize,
        /// How many are read.
        limit: usize,
    },
    /// Points, and no surface.
    #[error("{format}: {vertices} vertices and no face: export a mesh, not a cloud of points")]
    NoSurface {
        /// The format.
        format: Format,
        /// Its vertices.
        vertices: usize,
    },
    /// Too many coordinates are no numbers.
    #[error(
        "{found} of {vertices} vertices are no finite positions (NaN, infinite, or beyond 1e9): export the scan again"
    )]
    NotFinite {
        /// Such vertices.
        found: usize,
        /// All vertices.
        vertices: usize,
    },
}

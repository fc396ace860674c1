//! Readers of mesh files: OBJ, PLY (text and binary of both byte orders), STL (text and binary) and OFF.
//!
//! The content determines the format; the file name's extension counts only if the content leaves it open. Counts in a
//! file are never trusted for allocation: every vertex and face comes from bytes that exist.

mod ply;
mod stl;
mod surface;
#[cfg(test)]
mod tests;
mod text;

use std::fmt;

use super::{Mesh, Note, Unit};

/// Largest file: five million triangles as text need less.
pub const BYTES_MAX: usize = 1 << 30;
/// Maximum number of triangles. A body scanner gives 0.1 to 2 million.
pub const FACES_MAX: usize = 5_000_000;
/// Maximum number of vertices: three per face, as if none were shared.
pub const VERTICES_MAX: usize = 3 * FACES_MAX;

/// A mesh as read: polygons are triangulated, every position is finite, every index valid. Whether it is one clean
/// surface is up to [`repair`](super::repair).
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// The surface, in the file's unit.
    pub mesh: Mesh,
    /// Format of the file.
    pub format: Format,
    /// The unit, if a comment in the file states it.
    pub unit: Option<Unit>,
    /// Remarks on the file.
    pub notes: Vec<Note>,
}

/// Reads a mesh file. Only the extension of `name` is used, as a hint.
///
/// # Errors
/// [`ReadError`], with what to do about it.
pub fn read(bytes: &[u8], name: &str) -> Result<Scan, ReadError> {
    if bytes.is_empty() {
        return Err(ReadError::Empty);
    }
    if bytes.len() > BYTES_MAX {
        return Err(ReadError::TooLarge { what: "bytes", found: bytes.len(), limit: BYTES_MAX });
    }
    let format = format(bytes, name)?;
    let surface = match format {
        Format::Obj => text::read_obj(bytes)?,
        Format::Ply => ply::read(bytes)?,
        Format::Stl => stl::read(bytes)?,
        Format::Off => text::read_off(bytes)?,
    };
    let mut scan = surface.finish()?;
    if let Some(ending) = Format::from_name(name)
        && ending != format
    {
        let text = format!("read as {format} by its content, though its name ends as {ending}");
        scan.notes.push(Note::new("other-ending", text));
    }
    Ok(scan)
}

/// A mesh file format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Wavefront OBJ, text.
    Obj,
    /// Stanford PLY, text or binary.
    Ply,
    /// STL (stereolithography), text or binary.
    Stl,
    /// Geomview OFF, text.
    Off,
}

impl Format {
    /// Recognises the extension of a file name.
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

    /// A [`ReadError::Malformed`] at a place, with a reason.
    fn malformed(self, place: impl Into<String>, reason: impl Into<String>) -> ReadError {
        ReadError::Malformed { format: self, place: place.into(), reason: reason.into() }
    }

    fn malformed_line(self, number: usize, reason: impl Into<String>) -> ReadError {
        self.malformed(format!("line {number}"), reason)
    }

    fn unexpected(self, number: usize, expected: &str, found: &[u8]) -> ReadError {
        self.malformed_line(number, format!("expected {expected}, found {}", text::quote(found)))
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

/// Keywords of OBJ lines.
const OBJ_KEYWORDS: [&[u8]; 11] =
    [b"v", b"vt", b"vn", b"vp", b"f", b"o", b"g", b"s", b"l", b"mtllib", b"usemtl"];
/// Maximum number of lines before the first keyword of an OBJ: exporters' comments are shorter.
const OBJ_LINES: usize = 1000;

fn format(bytes: &[u8], name: &str) -> Result<Format, ReadError> {
    let bytes = text::without_bom(bytes);
    if matches!(bytes, [b'p', b'l', b'y', b'\r' | b'\n', ..]) {
        return Ok(Format::Ply);
    }
    // Before the other formats: a binary STL may begin with any text.
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

/// Describes files that people try instead.
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
        _ => "it begins like no known format",
    }
}

/// Why a file could not be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The file is empty.
    #[error("the file is empty: export the scan again")]
    Empty,
    /// Not one of the formats.
    #[error("not a supported mesh format ({found}): export it as OBJ, PLY, STL or OFF")]
    Unknown {
        /// What it seems to be.
        found: String,
    },
    /// The file violates its format, or is cut off.
    #[error("{format}, {place}: {reason}")]
    Malformed {
        /// The format.
        format: Format,
        /// Such as `line 12`, `byte 4096` or `face 7`.
        place: String,
        /// What was expected, and what was found.
        reason: String,
    },
    /// A variant of the format that is not supported.
    #[error("{format}: {what} is not supported: export it as plain text or binary triangles")]
    Unsupported {
        /// The format.
        format: Format,
        /// The variant.
        what: String,
    },
    /// Too many vertices or faces.
    #[error("{found} {what}, the limit is {limit}: decimate the mesh in the scanner's software")]
    TooLarge {
        /// What exceeds the limit, such as `faces`.
        what: &'static str,
        /// Number found, a lower bound if reading stopped early.
        found: usize,
        /// The limit.
        limit: usize,
    },
    /// Vertices without faces.
    #[error("{format}: {vertices} vertices and no face: export a mesh, not a point cloud")]
    NoSurface {
        /// The format.
        format: Format,
        /// Number of vertices.
        vertices: usize,
    },
    /// Too many coordinates are not numbers.
    #[error(
        "{found} of {vertices} vertices have no finite position (NaN, infinite, or beyond 1e9): export the scan again"
    )]
    NotFinite {
        /// Number of such vertices.
        found: usize,
        /// Number of all vertices.
        vertices: usize,
    },
}

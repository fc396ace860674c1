//! Which format it is.

use std::fmt;

use super::{ReadError, stl, text};

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
const OBJ_WORDS: [&[u8]; 11] =
    [b"v", b"vt", b"vn", b"vp", b"f", b"o", b"g", b"s", b"l", b"mtllib", b"usemtl"];
/// Lines in which the first word of an OBJ must stand: comments of exporters are shorter.
const OBJ_LINES: usize = 1000;

pub(super) fn format(bytes: &[u8], name: &str) -> Result<Format, ReadError> {
    let bytes = text::without_mark(bytes);
    if matches!(bytes, [b'p', b'l', b'y', b'\r' | b'\n', ..]) {
        return Ok(Format::Ply);
    }
    // Before the others: a binary STL may begin with any text at all.
    if stl::binary_fits(bytes) {
        return Ok(Format::Stl);
    }
    let mut lines = text::lines(bytes)
        .take(OBJ_LINES)
        .filter_map(|(_, line)| text::words(text::before_comment(line)).next());
    let first = lines.next().unwrap_or_default();
    if first.ends_with(b"OFF") && first.len() <= 9 && first.iter().all(u8::is_ascii_alphanumeric) {
        return Ok(Format::Off);
    }
    if first.eq_ignore_ascii_case(b"solid") {
        return Ok(Format::Stl);
    }
    if OBJ_WORDS.contains(&first) || lines.any(|word| OBJ_WORDS.contains(&word)) {
        return Ok(Format::Obj);
    }
    Format::from_name(name).ok_or_else(|| ReadError::Unknown { found: guess(bytes).to_owned() })
}

/// What people give instead.
fn guess(bytes: &[u8]) -> &'static str {
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

//! Mesh files: OBJ, PLY (text, binary of both byte orders), STL (text, binary) and OFF.
//!
//! The content says which format it is; the name's ending is asked only where the content leaves it open. Nothing is
//! allocated on a number that a file merely claims: every vertex and face stands in the bytes that were given.

mod detect;
mod error;
mod obj;
mod off;
mod ply;
mod polygon;
mod stl;
mod surface;
#[cfg(test)]
mod tests;
mod text;

pub use detect::Format;
pub use error::ReadError;

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
    let format = detect::format(bytes, name)?;
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

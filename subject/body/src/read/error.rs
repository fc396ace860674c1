//! Why a file is no mesh.

use super::Format;

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

impl ReadError {
    pub(super) fn malformed(
        format: Format,
        place: impl Into<String>,
        reason: impl Into<String>,
    ) -> Self {
        Self::Malformed { format, place: place.into(), reason: reason.into() }
    }
}

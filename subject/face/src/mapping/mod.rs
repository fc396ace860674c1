//! Which marker of a take sits where on the wireframe, so that a fitted face can be drawn under its markers.
//!
//! The format is described in `docs/subject-face-format.md`.

mod align;
mod format;
#[cfg(test)]
mod tests;

pub use align::{AlignError, Alignment, Scaling};
pub use format::MappingError;

use std::collections::BTreeMap;

/// Where markers sit on a face.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mapping {
    /// One for each marker that has a place.
    pub markers: Vec<Marker>,
}

/// One marker's place.
#[derive(Debug, Clone, PartialEq)]
pub struct Marker {
    /// As the take has it.
    pub label: String,
    /// Where on the wireframe.
    pub place: Place,
    /// How much it counts when the face is laid under the markers: 0 for one that moves much, such as on the lips.
    pub weight: f64,
}

/// A place on the wireframe.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// A vertex by its name.
    Feature(String),
    /// A vertex by its number, from 0.
    Vertex(usize),
}

impl Place {
    /// The vertex, where the wireframe has it.
    pub fn vertex(&self, features: &BTreeMap<String, usize>, vertices: usize) -> Option<usize> {
        let index = match self {
            Self::Feature(name) => *features.get(name)?,
            Self::Vertex(index) => *index,
        };
        (index < vertices).then_some(index)
    }
}

impl Mapping {
    /// That of the public recording of a singing face with 37 markers (c3d.org, sample 19), whose labels run from
    /// `root-1` to `section14-3`.
    ///
    /// # Errors
    /// None, unless the program was built with a damaged file.
    pub fn singing_face() -> Result<Self, MappingError> {
        Self::from_json(include_str!("../../data/singing-face-mapping.json"))
    }
}

//! A 3-D face wireframe fitted to a photograph.
//!
//! The chain has four steps. [`photo`] decodes the picture; [`find`] detects faces; [`points`] locates the 53 points of
//! Yang et al. 2004 on each; [`model`] and [`adapt`] fit a generic wireframe to them by a shape model and radial basis
//! functions. [`fit`] runs all of it and [`fitted`] writes the result. [`paper`] and [`points::paper`] implement the
//! published method as printed, for comparison; [`proportions`] checks its points.
//!
//! A face is prepared once per subject, before a capture. This crate does not depend on takes; a take carries the face
//! as a document, and [`mapping`] places markers on it. The detector and the regressors are linear weights and small
//! decision trees learned from a few photographs and many rendered heads by the scripts in `benches/subject`.

pub mod adapt;
mod document;
pub mod find;
pub mod fit;
pub mod fitted;
pub mod mapping;
pub mod model;
mod oriented_gradients;
pub mod paper;
pub mod photo;
pub mod plane;
pub mod points;
pub mod pose;
pub mod proportions;
mod table;

pub use document::DocumentError;
pub use photo::{Photo, PhotoError};
pub use plane::Plane;

/// Shortens a reason to one line, since JSON readers quote names from the file.
pub(crate) fn shortened(reason: &str) -> String {
    const CHARACTERS: usize = 160;
    let printed = |c: char| if c.is_control() { ' ' } else { c };
    let mut line: String = reason.chars().map(printed).take(CHARACTERS).collect();
    if reason.chars().nth(CHARACTERS).is_some() {
        line.push('…');
    }
    line
}

//! A photograph of a face becomes a wireframe fitted to it (Yang et al. 2004, and past it).
//!
//! It is made before a capture, once a subject, and knows nothing of takes: a take carries it as plain data. Faces are
//! found by linear weights and trees learned from a few photographs and many drawn heads; the scripts are in
//! `benches/subject`.

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
mod vector;

pub use document::DocumentError;
pub use photo::{Photo, PhotoError};
pub use plane::Plane;

/// A reason on one line: a reader of JSON quotes whatever names a file has.
pub(crate) fn shortened(reason: &str) -> String {
    const CHARACTERS: usize = 160;
    let printed = |c: char| if c.is_control() { ' ' } else { c };
    let mut line: String = reason.chars().map(printed).take(CHARACTERS).collect();
    if reason.chars().nth(CHARACTERS).is_some() {
        line.push('…');
    }
    line
}

//! The generic face: a wireframe with named features, and the ways in which faces differ from it.
//!
//! Lengths are millimetres, nominal: the outer eye corners of the average face are [`OUTER_EYES_MM`] apart, and a
//! photograph says nothing about the true scale. x points to the face's own left, y up, z to the front; the origin lies
//! midway between the outer eye corners. `docs/subject-face-model.md` says how it was made.

mod camera;
mod feature;
mod fit;
mod parse;
mod shape;
mod solve;
mod start;
#[cfg(test)]
mod tests;

pub use camera::Camera;
pub use feature::{FeatureId, Side};
pub use fit::{FitError, FitOptions, ShapeFit};
pub use parse::ModelError;
pub use shape::{Kind, Mode, Model};

/// Distance of the outer eye corners of the average face. Adults measure 85 to 95 mm.
pub const OUTER_EYES_MM: f64 = 90.0;

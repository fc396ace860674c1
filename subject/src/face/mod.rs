//! From a photograph to a wireframe of the face (Yang et al. 2004, and past it).

pub mod adapt;
pub mod find;
pub mod fit;
pub mod fitted;
pub mod mapping;
pub mod model;
pub mod paper;
pub mod photo;
pub mod plane;
pub mod plausible;
pub mod points;
pub mod pose;
pub mod render;
mod slopes;

pub use photo::{Photo, PhotoError};
pub use plane::Plane;

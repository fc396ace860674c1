//! The wireframe pulled onto the points of a photograph, by radial basis functions (Yang et al. 2004, (6) to (14)).

mod basis;
mod depth;
mod face;
mod map;
#[cfg(test)]
mod tests;

pub use basis::Basis;
pub use depth::symmetric_depths;
pub use face::{Adapted, Depth, Settings, Unit, adapt};
pub use map::{AdaptError, RadialMap};

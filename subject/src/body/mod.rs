//! From a body scan to a skeleton (Yu et al. 2008, and past it).

pub mod generate;
mod geometry;
mod joint;
mod mesh;
mod note;
pub mod read;
pub mod repair;
mod unit;

pub use joint::{Estimate, Joint, Joints, Side};
pub use mesh::Mesh;
pub use note::Note;
pub use unit::{Unit, UnitError};
pub mod extremity;
pub mod geodesic;
pub mod level;
pub mod paper;
pub mod reeb;

mod joint;
mod mesh;
mod refusal;

pub use joint::{Estimate, Joint, Joints, Side};
pub use mesh::Mesh;
pub use refusal::Refusal;

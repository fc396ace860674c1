//! A body scan becomes a skeleton: joint centres, with how sure each is (Yu et al. 2008, and past it).
//!
//! It is made before a capture, once a subject, and knows nothing of takes: a take carries it as plain data. Joints rest
//! on weights learned from two drawn bodies; the script is `benches/subject/learn.py`.

pub mod extremity;
pub mod generate;
pub mod geodesic;
mod geometry;
mod joint;
pub mod level;
mod levels;
pub mod locate;
mod mesh;
mod note;
pub mod paper;
pub mod picture;
mod plausible;
pub mod read;
pub mod reeb;
mod refusal;
pub mod repair;
#[cfg(test)]
mod shapes;
mod size;
pub mod skeleton;
pub mod survey;
mod unit;

pub use joint::{Estimate, Joint, Joints, Side};
pub use levels::Levels;
pub use mesh::Mesh;
pub use note::Note;
pub use refusal::Refusal;
pub use repair::Repaired;
pub use survey::Survey;
pub use unit::{Unit, UnitError};

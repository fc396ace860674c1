//! A body scan becomes a skeleton: joint centres, with how sure each is (Yu et al. 2008, and past it).
//!
//! It is made before a capture, once a subject, and knows nothing of takes: a take carries it as plain data. Joints rest
//! on weights learned from two drawn bodies; the script is `benches/subject/learn.py`.

mod diagnosis;
pub mod extremity;
pub mod geodesic;
mod joint;
pub mod level;
pub mod locate;
mod mesh;
pub mod paper;
pub mod picture;
mod plausible;
pub mod read;
pub mod reeb;
pub mod repair;
pub mod skeleton;
pub mod analysis;
#[cfg(test)]
mod tests;
mod topology;
mod unit;

pub use diagnosis::{Note, Refusal};
pub use joint::{Estimate, Joint, Joints, Side};
pub use mesh::Mesh;
pub use plausible::Plausibility;
pub use reeb::Levels;
pub use repair::Repaired;
pub use analysis::Survey;
pub use unit::{Unit, UnitError};

//! Joint centres from a body scan: any pose, any orientation, no markers and no template body.
//!
//! A scan becomes a skeleton in four steps. [`read`] parses a mesh file; [`repair`] closes it into one manifold
//! surface; [`ScanAnalysis`] finds head, hands, feet and joint centres, each with its standard deviation; [`skeleton`]
//! combines one scan or several into bone lengths and writes JSON. [`picture`] draws the result as SVG.
//!
//! Two methods share these steps. The default ([`locate`]) extends the one of Yu et al. 2008; [`paper`] implements
//! theirs as printed, for comparison. Both rest on geodesic distances along the surface, which hardly change with the
//! pose.
//!
//! A skeleton is prepared once per subject, before a capture. This crate does not depend on takes; a take carries
//! the skeleton as a document. The default method's weights were learned from two synthetic bodies by
//! `benches/subject/learn.py`.

pub mod analysis;
mod diagnosis;
pub mod extremity;
pub mod geodesic;
mod joint;
pub mod level;
pub mod locate;
mod mesh;
pub mod paper;
pub mod picture;
pub mod read;
pub mod reeb;
pub mod repair;
pub mod skeleton;
#[cfg(test)]
mod tests;

pub use crate::joint::Plausibility;
pub use analysis::ScanAnalysis;
pub use diagnosis::{Note, Refusal};
pub use joint::{Estimate, Joint, Joints, Side};
pub use mesh::{Mesh, Unit, UnitError};
pub use reeb::Levels;
pub use repair::Repaired;

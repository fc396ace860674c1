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

use std::fmt;

use thiserror::Error;

pub use analysis::ScanAnalysis;
pub use joint::{Estimate, Joint, Joints, Plausibility, Side};
pub use mesh::{Mesh, Unit, UnitError};
pub use reeb::Levels;
pub use repair::Repaired;

/// A remark about a mesh: what was found, and what was done about it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// Identifier for programs, such as `holes-closed`.
    pub code: &'static str,
    /// Text for people: lower case, no final dot, bounded length.
    pub text: String,
}

impl Note {
    pub(crate) fn new(code: &'static str, text: impl Into<String>) -> Self {
        Self { code, text: text.into() }
    }
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

/// Why a mesh gives no skeleton, and what to do about it.
///
/// A wrong skeleton is worse than none: an ambiguous result is refused.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum Refusal {
    /// The mesh is not a valid surface.
    #[error("the mesh has {what}: export it again, or repair it first")]
    BrokenMesh {
        /// What is wrong with it.
        what: &'static str,
    },
    /// The body is not connected.
    #[error(
        "the body is in pieces: only {reached} of {vertices} vertices are connected; close the gaps in the scan"
    )]
    InPieces {
        /// Vertices of the largest connected piece.
        reached: usize,
        /// All vertices.
        vertices: usize,
    },
    /// Fewer than five extremities protrude.
    #[error(
        "found {found} extremities, expected 5 (head, hands, feet): scan the whole body with limbs apart"
    )]
    TooFewEnds {
        /// How many protrude.
        found: usize,
    },
    /// More than five extremities protrude as far as limbs.
    #[error(
        "found {found} extremities as long as limbs, expected 5: scan one person, alone and with empty hands"
    )]
    TooManyEnds {
        /// How many protrude as far as limbs.
        found: usize,
    },
    /// The geodesic distances between the extremities are not those of a body.
    #[error(
        "the distances between the extremities are not those of a human body (misfit {misfit:.1}, at most {limit:.1}): \
         scan one whole person, limbs apart"
    )]
    NotABody {
        /// Deviation from a body, in standard deviations (root mean square).
        misfit: f64,
        /// Largest deviation that is accepted.
        limit: f64,
    },
    /// Two assignments of head, hands and feet fit about equally well.
    #[error(
        "cannot tell head, hands and feet apart with confidence: scan with limbs apart and stretched"
    )]
    Ambiguous {
        /// By how much the second best assignment fits worse, in the unit of the misfit.
        margin: f64,
    },
    /// Limbs touch and have fused in the scan.
    #[error("limbs touch and have fused in the scan{}: scan with limbs apart", loops(.handles))]
    Contact {
        /// Number of loops (handles) of the surface; a body without contact has none.
        handles: usize,
    },
    /// The published method finds other than five extremities on a body whose limbs are free.
    #[error(
        "the published method finds {found} extremities on this scan, expected 5, though its limbs are apart: it misses \
         short ones and counts points between; use the default method"
    )]
    PaperEnds {
        /// How many it finds.
        found: usize,
    },
    /// The published method mistakes another extremity for the head, on a body whose limbs are free.
    #[error(
        "the published method mistakes the end of {taken} for the head, which it finds by symmetry alone: use the \
         default method"
    )]
    PaperHead {
        /// What it is the end of.
        taken: &'static str,
    },
    /// The published method's level sets do not split into five parts, on a body whose limbs are free.
    #[error(
        "the published method's level sets do not split this scan into trunk, arms and legs, though its limbs are apart: \
         use the default method"
    )]
    PaperParts,
}

fn loops(handles: &usize) -> String {
    match handles {
        0 => String::new(),
        1 => " (a loop in the surface)".to_owned(),
        _ => format!(" ({handles} loops in the surface)"),
    }
}

impl Refusal {
    /// Stable identifier for programs.
    #[must_use]
    pub fn code(&self) -> &'static str {
        match self {
            Self::BrokenMesh { .. } => "broken-mesh",
            Self::InPieces { .. } => "in-pieces",
            Self::TooFewEnds { .. } => "too-few-ends",
            Self::TooManyEnds { .. } => "too-many-ends",
            Self::NotABody { .. } => "not-a-body",
            Self::Ambiguous { .. } => "ambiguous",
            Self::Contact { .. } => "contact",
            Self::PaperEnds { .. } => "paper-ends",
            Self::PaperHead { .. } => "paper-head",
            Self::PaperParts => "paper-parts",
        }
    }
}

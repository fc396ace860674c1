//! What is told of a scan: notes on what was found and done, and why it gives no skeleton.

use std::fmt;

use thiserror::Error;

/// One sentence about the mesh: what was found, and what was done about it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// A short name of the kind of note, for programs: `holes-closed`.
    pub code: &'static str,
    /// The sentence, for people: lower case, without a dot at the end, of a bounded length.
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

/// Why a mesh gives no skeleton, and what to do.
///
/// A wrong skeleton is worse than none: what cannot be told with confidence is refused.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum Refusal {
    /// The mesh is not a surface.
    #[error("the mesh has {what}: export it again, or repair it first")]
    BrokenMesh {
        /// What is wrong with it.
        what: &'static str,
    },
    /// The surface is in pieces where the body should be one.
    #[error(
        "the body is in pieces: only {reached} of {vertices} vertices hang together: close the gaps of the scan"
    )]
    InPieces {
        /// How many vertices the largest piece has.
        reached: usize,
        /// How many there are.
        vertices: usize,
    },
    /// Fewer ends stand out of the surface than a body has.
    #[error(
        "{found} ends stand out, and a body has 5 (head, hands, feet): scan the whole body, limbs apart"
    )]
    TooFewEnds {
        /// How many stand out.
        found: usize,
    },
    /// More ends stand out as far as limbs do than a body has.
    #[error(
        "{found} ends stand out like limbs, and a body has 5: scan one person, alone and without what is held"
    )]
    TooManyEnds {
        /// How many stand out so far.
        found: usize,
    },
    /// Ends stand out, and the ways between them are not those of a body.
    #[error(
        "the ways between the ends are not those of a human body (misfit {misfit:.1}, at most {limit:.1}): \
         scan one whole person, limbs apart"
    )]
    NotABody {
        /// How far from a body, in standard deviations a distance.
        misfit: f64,
        /// The most that is taken for a body.
        limit: f64,
    },
    /// Two ways to name the ends fit about as well.
    #[error(
        "head, hands and feet cannot be told apart with confidence: scan with limbs apart and stretched"
    )]
    Ambiguous {
        /// How much worse the second best fits, in the unit of the misfit.
        margin: f64,
    },
    /// Limbs touch, and the scan has grown together there.
    #[error("limbs touch and the scan has grown together there{}: scan with limbs apart", loops(.handles))]
    Contact {
        /// How many loops the surface has that a body has not.
        handles: usize,
    },
    /// The published method finds other than five ends, on a body with its limbs free.
    #[error(
        "the published method finds {found} ends of this scan, whose limbs are apart, where a body has 5: it misses \
         short ones, and counts what is between; use the default method"
    )]
    PaperEnds {
        /// How many.
        found: usize,
    },
    /// The published method takes another end for the head, on a body with its limbs free.
    #[error(
        "the published method takes the end of {taken} for the head: it tells the head by symmetry alone; use the \
         default method"
    )]
    PaperHead {
        /// Of what it is the end.
        taken: &'static str,
    },
    /// The published method's level sets have not five parts, on a body with its limbs free.
    #[error(
        "the published method's level sets do not part into a trunk, arms and legs on this scan, though its limbs are \
         apart: use the default method"
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
    /// A word for programs, which stays when the sentence changes.
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

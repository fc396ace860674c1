//! Editing takes: [`cut`] copies a range of frames into a new take, [`concat()`] joins takes. No sample changes.
//!
//! Stretches are copied wherever they do not depend on one that is left out. The rows of a stretch that is only partly
//! kept, or that continues one that is not kept, are stored as the floats that they decode to: the resamplers cannot
//! encode them again to the same floats otherwise
//! (`docs/decisions/0012-the-ends-of-a-cut-are-stored-exactly.md`).

mod concat;
mod cut;
mod foreign;
mod seam;
mod source;
#[cfg(test)]
mod tests;

use std::{io, sync::Arc};

pub use self::{
    concat::{ConcatReport, Mismatch, check_joinable, concat},
    cut::{CutReport, cut},
    seam::Seam,
    source::SourceTake,
};
use crate::{TakeError, damage::Problem, foreign::content::ScratchFile};

/// The key in the settings of HEADER that marks a take cut from another.
pub const CUT: &str = "cut";

/// The key in the settings of HEADER that marks a take joined of others.
pub const CONCAT: &str = "concat";

/// What the caller of an edit provides.
pub struct EditContext<'a> {
    /// Names the program in the new take.
    pub software: &'a str,
    /// Creates the file for foreign parts that are too large for memory.
    pub new_scratch: &'a dyn Fn() -> io::Result<Arc<dyn ScratchFile>>,
    /// Receives the number of rows after each stretch, for a progress display.
    pub on_rows: &'a dyn Fn(u64),
}

impl std::fmt::Debug for EditContext<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("EditContext").field("software", &self.software).finish_non_exhaustive()
    }
}

/// The error for a take that is not whole.
fn damaged(problem: &Problem) -> TakeError {
    TakeError::InvalidArgument(format!(
        "only complete takes can be cut or joined: use the take that `mocapd recover` writes ({problem})"
    ))
}

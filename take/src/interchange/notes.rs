//! What a reader found wrong or open, as it goes along.

use crate::motion::Ambiguity;

/// Warnings, and of them those that are choices.
#[derive(Debug, Default)]
pub(super) struct Notes {
    /// One sentence each.
    pub(super) warnings: Vec<String>,
    /// What can be read in another way; each stands among the warnings, too.
    pub(super) ambiguities: Vec<Ambiguity>,
}

impl Notes {
    /// Adds a choice that was made.
    pub(super) fn ambiguous(&mut self, ambiguity: Ambiguity) {
        self.warnings.push(ambiguity.to_string());
        self.ambiguities.push(ambiguity);
    }
}

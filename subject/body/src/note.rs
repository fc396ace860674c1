//! What was found and done on the way, for whoever reads the result.

use std::fmt;

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

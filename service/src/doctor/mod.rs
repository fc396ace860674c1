//! Whether this machine can record: each finding says what was looked at, and what to type where something is wrong.

mod clock;
mod devices;
mod disk;
mod service;
mod system;

use std::path::Path;

/// How much a finding matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// As it should be.
    Good,
    /// To be known; nothing is wrong.
    Note,
    /// A recording goes, and may lose more than it should.
    Warning,
    /// A recording cannot go so.
    Failure,
}

/// What was found of one thing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// `disk speed`, `serial:/dev/ttyUSB0`...
    pub what: String,
    /// How it is.
    pub verdict: Verdict,
    /// What was seen, with its figures.
    pub seen: String,
    /// What to type or to do, where something is to be done.
    pub remedy: Option<String>,
}

impl Finding {
    fn good(what: &str, seen: impl Into<String>) -> Self {
        Self { what: what.to_owned(), verdict: Verdict::Good, seen: seen.into(), remedy: None }
    }

    fn note(what: &str, seen: impl Into<String>) -> Self {
        Self { verdict: Verdict::Note, ..Self::good(what, seen) }
    }

    fn warning(what: &str, seen: impl Into<String>, remedy: impl Into<String>) -> Self {
        let remedy = Some(remedy.into());
        Self { verdict: Verdict::Warning, remedy, ..Self::good(what, seen) }
    }

    fn failure(what: &str, seen: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { verdict: Verdict::Failure, ..Self::warning(what, seen, remedy) }
    }
}

/// Looks at everything, telling each finding as it comes; takes some seconds. Takes would go to `folder`, of whose
/// disk so much is to stay free.
pub fn examine(folder: &Path, keep_free_bytes: u64, tell: &mut dyn FnMut(Finding)) {
    devices::examine(tell);
    disk::examine(folder, keep_free_bytes, tell);
    clock::examine(tell);
    system::examine(tell);
    service::examine(tell);
}

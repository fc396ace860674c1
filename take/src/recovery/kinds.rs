//! Chunks, counted by kind.

use crate::chunk::types;

/// What kind of chunk.
#[expect(missing_docs, reason = "docs/take-format.md has the table")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Header,
    Channels,
    Stretch,
    Event,
    Ledger,
    Clock,
    Subject,
    Foreign,
    Summary,
    Index,
    Footer,
    /// A type that this version does not write, or bytes that do not say what they were.
    Other,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Self; 12] = [
        Self::Header,
        Self::Channels,
        Self::Stretch,
        Self::Event,
        Self::Ledger,
        Self::Clock,
        Self::Subject,
        Self::Foreign,
        Self::Summary,
        Self::Index,
        Self::Footer,
        Self::Other,
    ];

    /// Of a chunk's type, if it has one.
    #[must_use]
    pub fn of(kind: Option<u8>) -> Self {
        match kind {
            Some(types::HEADER) => Self::Header,
            Some(types::CHANNELS) => Self::Channels,
            Some(types::STRETCH) => Self::Stretch,
            Some(types::EVENT) => Self::Event,
            Some(types::LEDGER) => Self::Ledger,
            Some(types::CLOCK) => Self::Clock,
            Some(types::SUBJECT) => Self::Subject,
            Some(types::FOREIGN) => Self::Foreign,
            Some(types::SUMMARY) => Self::Summary,
            Some(types::INDEX) => Self::Index,
            Some(types::FOOTER) => Self::Footer,
            _ => Self::Other,
        }
    }

    /// For people and documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Header => "header",
            Self::Channels => "channel table",
            Self::Stretch => "stretch",
            Self::Event => "event",
            Self::Ledger => "ledger",
            Self::Clock => "clock",
            Self::Subject => "subject",
            Self::Foreign => "foreign",
            Self::Summary => "summary",
            Self::Index => "index",
            Self::Footer => "footer",
            Self::Other => "unknown",
        }
    }

    /// Whether it stands behind the last ledger of a take that was closed.
    #[must_use]
    pub(super) fn is_at_the_end(self) -> bool {
        matches!(self, Self::Summary | Self::Index | Self::Footer)
    }

    /// Whether a recovery makes it anew, so that a damaged one costs nothing.
    #[must_use]
    pub fn is_made_anew(self) -> bool {
        matches!(self, Self::Index | Self::Footer)
    }
}

/// Chunks of one kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KindCount {
    /// Which.
    pub kind: Kind,
    /// Whole ones that were found.
    pub recovered: u64,
    /// Damaged ones, and those that cannot be read without a damaged one. Bytes that cannot be read count as one
    /// of the kind that they begin like, however many they were.
    pub discarded: u64,
}

/// The counts, in the order of [`Kind::ALL`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Kinds([KindCount; Kind::ALL.len()]);

impl Default for Kinds {
    fn default() -> Self {
        Self(Kind::ALL.map(|kind| KindCount { kind, recovered: 0, discarded: 0 }))
    }
}

impl Kinds {
    pub(super) fn all(&self) -> &[KindCount] {
        &self.0
    }

    pub(super) fn recovered(&mut self, kind: Kind) {
        self.of(kind).recovered += 1;
    }

    pub(super) fn discarded(&mut self, kind: Kind) {
        self.of(kind).discarded += 1;
    }

    fn of(&mut self, kind: Kind) -> &mut KindCount {
        &mut self.0[kind as usize]
    }
}

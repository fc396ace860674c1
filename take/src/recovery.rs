//! A take again of what can be read of a damaged one: its good chunks unchanged, with what stands for the others,
//! a ledger that closes, index and footer.
//!
//! First the file is read and decoded once ([`Survey::read`]), then its good chunks are copied ([`Survey::write`]).
//! A stretch is never coded again: what its encoder proved of it stays proven.

mod account;
mod start;
mod survey;
mod write;

pub use self::{
    start::{MendedStart, mend_start},
    survey::{ChannelCount, Survey},
};

use crate::{chunk::types, record::Channel, stretch::Span};

/// The setting in HEADER that tells of a recovery.
pub const RECOVERED: &str = "recovered";

/// What the new take is made of, in order.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Piece {
    /// A chunk of the old one.
    Chunk {
        offset: u64,
        len: u64,
        kind: u8,
        /// Of a stretch.
        span: Option<Span>,
    },
    /// Entries of the channel table in the place of lost ones.
    Channels(Vec<Channel>),
    /// A stretch of no rows in the place of those that are lost.
    Lost { first_row: u64, rows: u64, number: u8 },
}

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

/// Every kind, the type of its chunks, and its name for people and documents.
const KINDS: [(Kind, Option<u8>, &str); 12] = [
    (Kind::Header, Some(types::HEADER), "header"),
    (Kind::Channels, Some(types::CHANNELS), "channel table"),
    (Kind::Stretch, Some(types::STRETCH), "stretch"),
    (Kind::Event, Some(types::EVENT), "event"),
    (Kind::Ledger, Some(types::LEDGER), "ledger"),
    (Kind::Clock, Some(types::CLOCK), "clock"),
    (Kind::Subject, Some(types::SUBJECT), "subject"),
    (Kind::Foreign, Some(types::FOREIGN), "foreign"),
    (Kind::Summary, Some(types::SUMMARY), "summary"),
    (Kind::Index, Some(types::INDEX), "index"),
    (Kind::Footer, Some(types::FOOTER), "footer"),
    (Kind::Other, None, "unknown"),
];

impl Kind {
    /// Of a chunk's type, if it has one.
    #[must_use]
    pub fn of(kind: Option<u8>) -> Self {
        let found = KINDS.iter().find(|(_, of, _)| kind.is_some() && *of == kind);
        found.map_or(Self::Other, |(kind, ..)| *kind)
    }

    /// For people and documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        KINDS.iter().find(|(kind, ..)| *kind == self).map_or("unknown", |(.., name)| name)
    }

    /// Whether it stands behind the last ledger of a take that was closed.
    fn is_at_the_end(self) -> bool {
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

//! Recovers a damaged take: the new file has the valid chunks unchanged, records of what is lost in place of the
//! others, a ledger that closes, an index and a footer.
//!
//! [`RecoveryScan::read`] reads and decodes the file once; [`RecoveryScan::write`] then copies its valid chunks. No stretch is
//! encoded again, so every error bound that its encoder proved still holds.

mod ledger_tally;
mod samples;
mod scan;
mod start;
mod write;

pub(crate) use self::ledger_tally::LedgerTally;
pub use self::{
    scan::{ChannelCount, RecoveryScan},
    start::{RepairedStart, repair_start},
};

use crate::{
    chunk::types,
    record::{Channel, Event},
    sampled::SampleSpan,
    stretch::Span,
};

/// The key in the settings of HEADER that marks a recovered take.
pub const RECOVERED: &str = "recovered";

/// One element of the new take.
#[derive(Debug, Clone, PartialEq, Eq)]
enum OutputChunk {
    /// A chunk copied from the damaged file.
    Copied {
        offset: u64,
        len: u64,
        kind: u8,
        /// For a stretch.
        span: Option<Span>,
    },
    /// Channel table entries in place of lost ones.
    Channels(Vec<Channel>),
    /// A stretch without rows in place of lost stretches.
    Lost { first_row: u64, rows: u64, number: u8 },
    /// Samples of a group of sampled channels, recorded as lost.
    LostSamples { span: SampleSpan, event: Event },
}

/// The kind of a chunk.
#[expect(missing_docs, reason = "docs/take-format.md has the table")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChunkKind {
    Header,
    Channels,
    Stretch,
    Event,
    Ledger,
    Clock,
    Subject,
    Foreign,
    SampledGroup,
    Samples,
    Summary,
    Index,
    Footer,
    /// A type that this version does not write, or bytes whose type is unknown.
    Other,
}

/// Every kind with its chunk type and its name in reports.
const KINDS: [(ChunkKind, Option<u8>, &str); 14] = [
    (ChunkKind::Header, Some(types::HEADER), "header"),
    (ChunkKind::Channels, Some(types::CHANNELS), "channel table"),
    (ChunkKind::Stretch, Some(types::STRETCH), "stretch"),
    (ChunkKind::Event, Some(types::EVENT), "event"),
    (ChunkKind::Ledger, Some(types::LEDGER), "ledger"),
    (ChunkKind::Clock, Some(types::CLOCK), "clock"),
    (ChunkKind::Subject, Some(types::SUBJECT), "subject"),
    (ChunkKind::Foreign, Some(types::FOREIGN), "foreign"),
    (ChunkKind::SampledGroup, Some(types::SAMPLED_GROUP), "sampled group"),
    (ChunkKind::Samples, Some(types::SAMPLES), "samples"),
    (ChunkKind::Summary, Some(types::SUMMARY), "summary"),
    (ChunkKind::Index, Some(types::INDEX), "index"),
    (ChunkKind::Footer, Some(types::FOOTER), "footer"),
    (ChunkKind::Other, None, "unknown"),
];

impl ChunkKind {
    /// The kind with this chunk type.
    #[must_use]
    pub fn of(kind: Option<u8>) -> Self {
        let found = KINDS.iter().find(|(_, of, _)| kind.is_some() && *of == kind);
        found.map_or(Self::Other, |(kind, ..)| *kind)
    }

    /// The name in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        KINDS.iter().find(|(kind, ..)| *kind == self).map_or("unknown", |(.., name)| name)
    }

    /// Whether chunks of this kind follow the last ledger of a closed take.
    fn follows_last_ledger(self) -> bool {
        matches!(self, Self::Summary | Self::Index | Self::Footer)
    }

    /// Whether a recovery rebuilds chunks of this kind, so that a damaged one loses nothing.
    #[must_use]
    pub fn is_rebuilt(self) -> bool {
        matches!(self, Self::Index | Self::Footer)
    }
}

/// Counts of chunks of one kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChunkKindCount {
    /// The kind.
    pub kind: ChunkKind,
    /// Valid chunks.
    pub recovered: u64,
    /// Damaged chunks, and chunks that need a damaged one. An unreadable region counts as one chunk of the kind in its
    /// first byte, however many it held.
    pub discarded: u64,
}

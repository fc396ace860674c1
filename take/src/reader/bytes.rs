//! What the bytes of a take are for.

use super::TakeEvent;
use crate::chunk::types;

/// Bytes by purpose: together all that were read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TakeBytes {
    /// The magic, HEADER and CHANNELS.
    pub header: u64,
    /// The blocks of the stretches, and what they share.
    pub blocks: u64,
    /// The lengths of the blocks.
    pub lengths: u64,
    /// When the rows were: runs and times.
    pub time_line: u64,
    /// What else a stretch needs: type, length, CRC, number, rows.
    pub framing: u64,
    /// LEDGER.
    pub ledgers: u64,
    /// CLOCK.
    pub clock: u64,
    /// EVENT.
    pub events: u64,
    /// SUMMARY, INDEX and FOOTER.
    pub index: u64,
    /// SUBJECT.
    pub subject: u64,
    /// FOREIGN.
    pub foreign: u64,
    /// What is damaged, unknown, or depends on what is damaged.
    pub other: u64,
}

impl TakeBytes {
    /// Counts a chunk of `len` bytes.
    pub(super) fn add(&mut self, event: &TakeEvent<'_>, len: u64) {
        let counter = match event {
            TakeEvent::Header(_) | TakeEvent::Channels(_) => &mut self.header,
            TakeEvent::Stretch(stretch) => {
                let sizes = stretch.sizes;
                self.time_line += sizes.time_line;
                self.lengths += sizes.lengths;
                self.blocks += sizes.blocks;
                self.framing += len - sizes.time_line - sizes.lengths - sizes.blocks;
                return;
            }
            TakeEvent::Ledger(_) => &mut self.ledgers,
            TakeEvent::Clock(_) => &mut self.clock,
            TakeEvent::Event(_) => &mut self.events,
            TakeEvent::Subject(_) => &mut self.subject,
            TakeEvent::Foreign(_) => &mut self.foreign,
            TakeEvent::Summary(_)
            | TakeEvent::Index(_)
            | TakeEvent::Skipped { kind: types::INDEX }
            | TakeEvent::Footer(_) => &mut self.index,
            TakeEvent::Unplaced { .. }
            | TakeEvent::Skipped { .. }
            | TakeEvent::Damaged { .. }
            | TakeEvent::Mended { .. }
            | TakeEvent::End { .. } => &mut self.other,
        };
        *counter += len;
    }

    /// All of them.
    #[must_use]
    pub fn sum(&self) -> u64 {
        let Self { header, blocks, lengths, time_line, framing, .. } = self;
        let stretches = header + blocks + lengths + time_line + framing;
        let beside = self.events + self.subject + self.foreign + self.other;
        stretches + self.ledgers + self.clock + self.index + beside
    }
}

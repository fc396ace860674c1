//! Where everything in a take lies, and what it says beside the motion: what a reader needs that starts in the
//! middle.

mod open;

use std::ops::Range;

use crate::{
    TakeEvent,
    damage::{LostRows, Problem},
    foreign::ForeignPart,
    index::IndexEntry,
    record::{Channel, ClockLine, Event, Header, Ledger, Subject, TakeEnding},
};

/// A take without its samples.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TakeMap {
    /// Its header.
    pub header: Header,
    /// The whole channel table, in order of columns.
    pub channels: Vec<Channel>,
    /// Rows, lost ones included.
    pub n_rows: u64,
    /// Rows in stretches that were found and have samples; `None` when stretches were not read. The others were
    /// lost, or nothing was seen in them.
    pub n_held: Option<u64>,
    /// Rows of the longest stretch, which is what a decoder holds of each marker; `None` when stretches were not read.
    pub longest_stretch: Option<u64>,
    /// The key stretches, at which a reader can start, in order of rows.
    pub keys: Vec<IndexEntry>,
    /// Who was captured, where it says.
    pub subject: Option<Subject>,
    /// The events, in order.
    pub events: Vec<Event>,
    /// The last ledger.
    pub ledger: Option<Ledger>,
    /// How it ended, where it says: takes of earlier versions, imports, and takes that were cut off do not.
    pub ending: Option<TakeEnding>,
    /// By segment of the device's clock, the last line of each that has one.
    pub clock_lines: Vec<(u32, ClockLine)>,
    /// What an importer kept; empty when stretches were not read.
    pub foreign: Vec<ForeignPart>,
    /// Whether the take was closed in order: one without a footer was cut off.
    pub finished: bool,
    /// Something was found that is damaged or missing.
    pub damaged: bool,
    /// Rows that are lost to damage, here or before the take was recovered, as far as stretches were read.
    pub damage: Vec<LostRows>,
    /// What is wrong with it; that it was cut off comes last.
    pub problems: Vec<Problem>,
}

impl TakeMap {
    /// The rows `rows` in order, cut at keys: at most `n` pieces, each of which can be decoded on its own.
    #[must_use]
    pub fn pieces(&self, rows: &Range<u64>, n: usize) -> Vec<Range<u64>> {
        let inside = self.keys.iter().map(|key| key.first_row);
        let keys: Vec<u64> = inside.filter(|row| rows.start < *row && *row < rows.end).collect();
        let n = n.clamp(1, keys.len() + 1);
        let starts = (1..n).map(|i| keys[i * keys.len() / n]);
        let mut pieces = Vec::new();
        let mut at = rows.start;
        for row in starts.chain([rows.end]) {
            if row > at {
                pieces.push(at..row);
                at = row;
            }
        }
        pieces
    }

    /// What the take says beside its motion and its channel table.
    pub(crate) fn keep(&mut self, event: TakeEvent<'_>) {
        match event {
            TakeEvent::Subject(subject) => self.subject = Some(*subject),
            TakeEvent::Event(event) => self.events.push(event),
            TakeEvent::Ledger(ledger) => self.ledger = Some(*ledger),
            TakeEvent::Clock(clock) => {
                if let Some(line) = clock.line {
                    self.clock_lines.pop_if(|last| last.0 == clock.segment);
                    self.clock_lines.push((clock.segment, line));
                }
            }
            TakeEvent::Foreign(part) => self.foreign.push(part),
            TakeEvent::Summary(summary) => self.ending = summary.ending,
            _ => {}
        }
    }
}

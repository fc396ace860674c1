//! The map of a take: everything but the samples, and the positions from which decoding can start.

mod open;

use std::ops::Range;

use crate::{
    TakeEvent,
    damage::{LostRows, Problem},
    foreign::ForeignPart,
    index::IndexEntry,
    record::{Channel, ClockLine, Event, Header, Ledger, Subject, TakeEnding},
    statistics::TakeStatistics,
};

/// Everything in a take but its samples.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TakeMap {
    /// The header.
    pub header: Header,
    /// The complete channel table, in column order.
    pub channels: Vec<Channel>,
    /// Number of rows, including lost ones.
    pub n_rows: u64,
    /// Rows in stretches that were found and have samples; `None` if the stretches were not read. All other rows were
    /// lost or have no marker.
    pub n_sampled_rows: Option<u64>,
    /// Rows of the longest stretch, which is what a decoder buffers of each marker; `None` if the stretches were not
    /// read.
    pub longest_stretch: Option<u64>,
    /// The key stretches, from which decoding can start, in order of rows.
    pub keys: Vec<IndexEntry>,
    /// The captured subject, if stated.
    pub subject: Option<Subject>,
    /// The events, in file order.
    pub events: Vec<Event>,
    /// The last ledger.
    pub ledger: Option<Ledger>,
    /// How the take ended; `None` in takes of earlier versions, in imports, and in takes that were cut off.
    pub ending: Option<TakeEnding>,
    /// The statistics that the take states; `None` in takes of earlier versions, and in those that were cut off.
    pub statistics: Option<TakeStatistics>,
    /// The last fitted clock line of each segment of the device's clock that has one.
    pub clock_lines: Vec<(u32, ClockLine)>,
    /// The parts that an importer kept; empty if the stretches were not read.
    pub foreign: Vec<ForeignPart>,
    /// Whether the take was closed; a take without a footer was cut off.
    pub finished: bool,
    /// Whether anything damaged or missing was found.
    pub damaged: bool,
    /// Rows lost to damage, in this file or before it was recovered, in the stretches that were read.
    pub damage: Vec<LostRows>,
    /// Everything that is wrong with the take; the cut-off comes last.
    pub problems: Vec<Problem>,
}

impl TakeMap {
    /// Splits `rows` at key stretches into at most `n` consecutive ranges that can be decoded independently.
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

    /// Adds the content of an event, except motion and channel table.
    pub(crate) fn add_content(&mut self, event: TakeEvent<'_>) {
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
            TakeEvent::Summary(summary) => {
                (self.ending, self.statistics) = (summary.ending, summary.statistics);
            }
            _ => {}
        }
    }
}

//! Where everything in a take lies, and what it says beside the motion: what a reader needs that starts in the
//! middle.

mod heads;
mod scan;

use std::io::{Read, Seek};

use crate::{
    TakeError,
    foreign::ForeignPart,
    index::IndexEntry,
    record::{Channel, Clock, ClockLine, Event, Header, Ledger, Subject, TakeEnding},
};

/// A take without its samples.
#[derive(Debug, Clone, PartialEq)]
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
    /// Whether the take was closed in order: one without a footer was cut off.
    pub finished: bool,
    /// Something was found that is damaged or missing.
    pub damaged: bool,
    /// What is wrong with it, one sentence each.
    pub problems: Vec<String>,
}

impl TakeMap {
    /// Of a take as quickly as can be: one that was finished is known by its index and the heads of its chunks,
    /// and a stretch is not read before somebody wants it. Any other is [scanned](Self::scan).
    ///
    /// So damage within a stretch shows when it is read, not here.
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`.
    pub fn open(input: &mut (impl Read + Seek)) -> Result<Self, TakeError> {
        if let Some(map) = heads::walk(input)? {
            return Ok(map);
        }
        Self::scan(input, |_| {})
    }

    /// Of a take of which every chunk's checksum is looked at, and no sample decoded; `foreign` gets its foreign
    /// parts, to be read where they are wanted.
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`.
    pub fn scan(
        input: &mut (impl Read + Seek),
        foreign: impl FnMut(ForeignPart),
    ) -> Result<Self, TakeError> {
        scan::scan(input, foreign)
    }

    /// Of a take with this header, and nothing more yet.
    fn new(header: Header) -> Self {
        Self {
            header,
            channels: Vec::new(),
            n_rows: 0,
            n_held: None,
            longest_stretch: None,
            keys: Vec::new(),
            subject: None,
            events: Vec::new(),
            ledger: None,
            ending: None,
            clock_lines: Vec::new(),
            finished: false,
            damaged: false,
            problems: Vec::new(),
        }
    }

    fn clock(&mut self, clock: &Clock) {
        if let Some(line) = clock.line {
            self.clock_lines.pop_if(|last| last.0 == clock.segment);
            self.clock_lines.push((clock.segment, line));
        }
    }
}

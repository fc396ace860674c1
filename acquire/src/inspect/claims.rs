//! What a take says of itself, held against what is in it.

use mocapd_take::{
    index::{Footer, IndexEntry},
    record::Ledger,
    stretch::{Span, Stretch},
    timeline::Timeline,
};

/// Sentences that are kept; one is enough to distrust a take.
const TOLD_MAX: usize = 20;

/// Counts what ledgers count, and compares.
#[derive(Debug, Default)]
pub(super) struct Claims {
    tolerance_mm: f64,
    recorded: u64,
    announced: u64,
    /// Where key stretches lie, which INDEX repeats.
    keys: Vec<IndexEntry>,
    index_offset: u64,
    ledger_offset: u64,
    broken: Vec<String>,
}

impl Claims {
    /// Of a take with this tolerance; 0 for `lossless`.
    pub(super) fn new(tolerance_mm: f64) -> Self {
        Self { tolerance_mm, ..Self::default() }
    }

    /// A stretch that was decoded, of a take with so many channels by now.
    pub(super) fn stretch(&mut self, stretch: &Stretch<'_>, n_channels: usize) {
        let rows = u64::from(stretch.span.n_rows);
        let recorded = stretch.timeline.as_ref().map_or(rows, Timeline::n_recorded);
        self.recorded += recorded;
        self.announced += recorded * n_channels as u64;
    }

    /// A stretch whose chunk begins at `offset`.
    pub(super) fn key(&mut self, span: Span, offset: u64) {
        if span.key && span.n_rows > 0 {
            self.keys.push(IndexEntry { offset, first_row: span.first_row });
        }
    }

    /// INDEX, whose chunk begins at `offset`.
    pub(super) fn index(&mut self, entries: &[IndexEntry], offset: u64, damaged: bool) {
        self.index_offset = offset;
        if !damaged && entries != self.keys {
            self.tell("the index does not tell where the key stretches are".to_owned());
        }
    }

    /// FOOTER.
    pub(super) fn footer(&mut self, footer: &Footer, damaged: bool) {
        let found = [self.index_offset, self.ledger_offset];
        if !damaged && [footer.index_offset, footer.ledger_offset] != found {
            self.tell("the footer does not tell where index and ledger are".to_owned());
        }
    }

    /// The error that a block with samples states.
    pub(super) fn block(&mut self, first_row: u64, max_error_mm: f64) {
        if max_error_mm > self.tolerance_mm {
            self.tell(format!(
                "a block of the stretch from frame {first_row} on states an error of {max_error_mm} mm, the tolerance is {} mm",
                self.tolerance_mm
            ));
        }
    }

    /// A ledger, whose chunk begins at `offset`, when so many samples were found before it. It is true for what stands before it, all of which
    /// must have been read.
    pub(super) fn ledger(&mut self, ledger: &Ledger, offset: u64, samples: u64, damaged: bool) {
        self.ledger_offset = offset;
        if damaged {
            return;
        }
        for (what, told, found) in [
            ("recorded frames", ledger.recorded, self.recorded),
            ("samples", ledger.samples_present, samples),
            ("announced samples", ledger.samples_announced, self.announced),
        ] {
            if told != found {
                self.tell(format!("a ledger tells of {told} {what}, before it are {found}"));
            }
        }
    }

    pub(super) fn broken(&self) -> &[String] {
        &self.broken
    }

    fn tell(&mut self, sentence: String) {
        if self.broken.len() < TOLD_MAX {
            self.broken.push(sentence);
        }
    }
}

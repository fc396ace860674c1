//! Writes a take, chunk after chunk, never going back.

use std::io::Write;

use crate::{
    TakeError, chunk,
    chunk::types,
    foreign,
    index::{Footer, IndexEntry, index_payload},
    motion::Foreign,
    record::{Channel, Event, Header, Ledger, MoreChannels, Record},
    stretch::Span,
};

/// Appends chunks to anything that takes bytes.
///
/// After an error nothing more is written: what is on disk up to then stays a readable take.
#[derive(Debug)]
pub struct TakeWriter<W> {
    out: W,
    offset: u64,
    failed: bool,
    scratch: Vec<u8>,
    index: Vec<IndexEntry>,
    n_rows: u64,
    ledger_offset: u64,
}

impl<W: Write> TakeWriter<W> {
    /// Writes magic and header.
    ///
    /// # Errors
    /// `Io`; `InvalidArgument` or `Codec` for a header that a reader would refuse.
    pub fn new(out: W, header: &Header) -> Result<Self, TakeError> {
        header.check()?;
        let mut writer = Self {
            out,
            offset: 0,
            failed: false,
            scratch: Vec::with_capacity(1 << 16),
            index: Vec::new(),
            n_rows: 0,
            ledger_offset: 0,
        };
        writer.scratch.extend_from_slice(&chunk::MAGIC);
        chunk::put(&mut writer.scratch, Header::KIND, &header.to_payload()?)?;
        writer.flush_scratch()?;
        Ok(writer)
    }

    /// Markers that appeared: appended to the channel table.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn channels(&mut self, channels: &[Channel]) -> Result<(), TakeError> {
        self.record(&MoreChannels(channels.to_vec()))
    }

    /// One stretch, its payload made by [`FrontWriter`](crate::stretch::FrontWriter) and
    /// [`put_block`](crate::stretch::put_block).
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn stretch(&mut self, span: Span, payload: &[u8]) -> Result<(), TakeError> {
        if span.key && span.n_rows > 0 {
            self.index.push(IndexEntry { offset: self.offset, first_row: span.first_row });
        }
        self.n_rows = self.n_rows.max(span.end_row());
        self.chunk(types::STRETCH, payload)
    }

    /// An event.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn event(&mut self, event: &Event) -> Result<(), TakeError> {
        self.record(event)
    }

    /// The ledger so far.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn ledger(&mut self, ledger: &Ledger) -> Result<(), TakeError> {
        self.ledger_offset = self.offset;
        self.record(ledger)
    }

    /// Something an importer found and a take does not model.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn foreign(&mut self, part: &Foreign) -> Result<(), TakeError> {
        self.chunk(types::FOREIGN, &foreign::to_payload(part)?)
    }

    /// The last ledger, index and footer. Gives the output back, flushed, and the bytes written.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn finish(mut self, ledger: &Ledger) -> Result<(W, u64), TakeError> {
        self.ledger(ledger)?;
        let index_offset = self.offset;
        self.chunk(types::INDEX, &index_payload(&self.index))?;
        let footer =
            Footer { index_offset, ledger_offset: self.ledger_offset, n_rows: self.n_rows };
        self.chunk(types::FOOTER, &footer.to_payload())?;
        self.out.flush()?;
        Ok((self.out, self.offset))
    }

    /// Bytes written.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.offset
    }

    /// What it writes to, for a sync.
    pub fn get_mut(&mut self) -> &mut W {
        &mut self.out
    }

    fn record<R: Record>(&mut self, record: &R) -> Result<(), TakeError> {
        self.chunk(R::KIND, &record.to_payload()?)
    }

    fn chunk(&mut self, kind: u8, payload: &[u8]) -> Result<(), TakeError> {
        self.scratch.clear();
        chunk::put(&mut self.scratch, kind, payload)?;
        self.flush_scratch()
    }

    /// One `write` a chunk, so that a kill leaves at most one chunk torn.
    fn flush_scratch(&mut self) -> Result<(), TakeError> {
        if self.failed {
            return Err(TakeError::InvalidArgument(
                "an earlier write failed: nothing more is written to this take".into(),
            ));
        }
        self.failed = true;
        self.out.write_all(&self.scratch)?;
        self.failed = false;
        self.offset += self.scratch.len() as u64;
        Ok(())
    }
}

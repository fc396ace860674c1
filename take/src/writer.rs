//! Writes a take, chunk after chunk, never going back.

use std::io::{Read, Write};

use crc32fast::Hasher;

use crate::{
    TakeError, chunk,
    chunk::types,
    foreign,
    index::{Footer, IndexEntry, index_payload},
    motion::Foreign,
    record::{Channel, Clock, Event, Header, Ledger, MoreChannels, Record, Subject, SummaryRecord},
    stretch::{RECORDED_MAX, ROWS_PASSED_MAX, Span, rows_max},
};

/// Of a long chunk so much is copied at once.
const COPIED_BYTES: u64 = 1 << 16;

/// Appends chunks to anything that takes bytes.
///
/// After an error nothing more is written: what is on disk up to then stays a readable take.
#[derive(Debug)]
pub struct TakeWriter<W> {
    out: W,
    offset: u64,
    failed: bool,
    scratch: Vec<u8>,
    rows_max: u64,
    index: Vec<IndexEntry>,
    n_rows: u64,
    ledger_offset: u64,
}

impl<W: Write> TakeWriter<W> {
    /// Writes magic and header.
    ///
    /// # Errors
    /// `Io`; `InvalidArgument` or `Codec` for a header that a reader would refuse, or whose stretches it
    /// would.
    pub fn new(out: W, header: &Header) -> Result<Self, TakeError> {
        header.check()?;
        let rows_max = rows_max(header.codec()?.kind);
        // A full stretch of a recording has a time for every row.
        let full_max = if header.device.is_some() { rows_max.min(RECORDED_MAX) } else { rows_max };
        check_rows(header.stretch_rows, full_max)?;
        let mut writer = Self {
            out,
            offset: 0,
            failed: false,
            scratch: Vec::with_capacity(1 << 16),
            rows_max,
            index: Vec::new(),
            n_rows: 0,
            ledger_offset: 0,
        };
        writer.scratch.extend_from_slice(&chunk::MAGIC);
        chunk::put(&mut writer.scratch, Header::KIND, &header.to_payload()?)?;
        writer.flush_scratch()?;
        Ok(writer)
    }

    /// Who is captured: behind the header, once.
    ///
    /// # Errors
    /// `Io`; `InvalidArgument` for more or longer documents than a take can hold.
    pub fn subject(&mut self, subject: &Subject) -> Result<(), TakeError> {
        self.record(subject)
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
    /// `Io`; `InvalidArgument` when it has more rows than a reader would take, or too many were lost
    /// before it.
    pub fn stretch(&mut self, span: Span, payload: &[u8]) -> Result<(), TakeError> {
        self.account(span)?;
        self.chunk(types::STRETCH, payload)
    }

    /// A stretch comes next.
    fn account(&mut self, span: Span) -> Result<(), TakeError> {
        check_rows(span.n_rows, self.rows_max)?;
        let passed = span.end_row().saturating_sub(self.n_rows);
        if passed > ROWS_PASSED_MAX {
            return Err(TakeError::InvalidArgument(format!(
                "{passed} rows since the last stretch are more than a take can hold ({ROWS_PASSED_MAX})"
            )));
        }
        if span.key && span.n_rows > 0 {
            self.index.push(IndexEntry { offset: self.offset, first_row: span.first_row });
        }
        self.n_rows = self.n_rows.max(span.end_row());
        Ok(())
    }

    /// An event.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn event(&mut self, event: &Event) -> Result<(), TakeError> {
        self.record(event)
    }

    /// What was seen of the clocks.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn clock(&mut self, clock: &Clock) -> Result<(), TakeError> {
        self.record(clock)
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
    pub fn finish(self, ledger: &Ledger) -> Result<(W, u64), TakeError> {
        self.finish_with(ledger, &SummaryRecord::default())
    }

    /// The same with a SUMMARY, unless that says nothing.
    ///
    /// # Errors
    /// As [`finish`](Self::finish).
    pub fn finish_with(
        mut self,
        ledger: &Ledger,
        summary: &SummaryRecord,
    ) -> Result<(W, u64), TakeError> {
        self.close(ledger, summary)?;
        Ok((self.out, self.offset))
    }

    /// The same, and keeps the output: nothing more may be written.
    ///
    /// # Errors
    /// As [`finish`](Self::finish).
    pub fn close(&mut self, ledger: &Ledger, summary: &SummaryRecord) -> Result<(), TakeError> {
        self.ledger(ledger)?;
        if *summary != SummaryRecord::default() {
            self.chunk(types::SUMMARY, &summary.to_payload()?)?;
        }
        let index_offset = self.offset;
        self.chunk(types::INDEX, &index_payload(&self.index))?;
        let footer =
            Footer { index_offset, ledger_offset: self.ledger_offset, n_rows: self.n_rows };
        self.chunk(types::FOOTER, &footer.to_payload())?;
        self.out.flush()?;
        Ok(())
    }

    /// The output, with nothing more written: what is on disk stays a take that was cut off.
    #[must_use]
    pub fn abandon(self) -> W {
        self.out
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

    /// A chunk of another take that is no stretch, unchanged.
    pub(crate) fn copy(&mut self, kind: u8, payload: &[u8]) -> Result<(), TakeError> {
        self.chunk(kind, payload)
    }

    /// A whole chunk of `len` bytes of another take, however long, unchanged; says whether its CRC matches. What a
    /// stretch spans is told.
    pub(crate) fn copy_long(
        &mut self,
        span: Option<Span>,
        mut chunk: impl Read,
        len: u64,
    ) -> Result<bool, TakeError> {
        span.map_or(Ok(()), |span| self.account(span))?;
        let mut crc = Hasher::new();
        let mut left = len.saturating_sub(chunk::CRC_BYTES as u64);
        while left > 0 {
            self.scratch.clear();
            let n = chunk.by_ref().take(left.min(COPIED_BYTES)).read_to_end(&mut self.scratch)?;
            if n == 0 {
                return Ok(false);
            }
            crc.update(&self.scratch);
            left -= n as u64;
            self.flush_scratch()?;
        }
        self.scratch.clear();
        chunk.take(chunk::CRC_BYTES as u64).read_to_end(&mut self.scratch)?;
        let matches = *self.scratch == crc.finalize().to_le_bytes();
        self.flush_scratch()?;
        Ok(matches)
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

fn check_rows(n_rows: u32, rows_max: u64) -> Result<(), TakeError> {
    if u64::from(n_rows) <= rows_max {
        return Ok(());
    }
    Err(TakeError::InvalidArgument(format!(
        "a stretch of {n_rows} rows is longer than a take of this kind can hold ({rows_max})"
    )))
}

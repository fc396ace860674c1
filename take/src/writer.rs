//! Writes a take chunk by chunk, without seeking back.

use std::io::{Read, Write};

use crc32fast::Hasher;

use crate::{
    ChannelOrder, TakeError, chunk,
    chunk::types,
    foreign::{ForeignPayload, check_length},
    index::{Footer, IndexEntry, index_payload},
    interchange::c3d::{self, Parameters},
    map::TakeMap,
    motion::Foreign,
    record::{
        Channel, Clock, Event, Header, Ledger, MoreChannels, Record, SampleLedger, SampledGroup,
        Subject, SummaryRecord, TakeEnding,
    },
    sampled::{
        EncodedSpan, LostSamples, PartContext, SampleAnchor, SampleSpan, SampleTimes, SamplesPlan,
        SpanEncoder,
    },
    statistics::{StretchTally, TakeTally},
    stretch::{RECORDED_MAX, ROWS_PASSED_MAX, Span, rows_max},
};

/// Size of one copy of a long chunk.
const COPIED_BYTES: u64 = 1 << 16;

/// Appends the chunks of a take to an output.
///
/// After an error nothing more is written, and the file so far remains a readable take.
#[derive(Debug)]
pub struct TakeWriter<W> {
    out: W,
    offset: u64,
    failed: bool,
    scratch: Vec<u8>,
    /// A payload of samples.
    payload: Vec<u8>,
    rows_max: u64,
    index: Vec<IndexEntry>,
    n_rows: u64,
    ledger_offset: u64,
    /// The header, with the complete channel table.
    header: Header,
    /// The order of the markers in the source, if it is not that of the table.
    order: Option<ChannelOrder>,
    /// The parameters of the imported file.
    parameters: Parameters,
    /// Groups of sampled channels so far.
    n_groups: u32,
    /// The last ledger of their samples.
    sample_ledger: Option<SampleLedger>,
    tally: TakeTally,
}

impl<W: Write> TakeWriter<W> {
    /// Writes the magic and the header.
    ///
    /// # Errors
    /// `Io`; `InvalidArgument` or `Codec` for a header that a reader would reject, by itself or for its stretch length.
    pub fn new(out: W, header: &Header) -> Result<Self, TakeError> {
        header.check()?;
        let rows_max = rows_max(header.codec()?.kind);
        // A full stretch of a recording has a time for each row.
        let full_max = if header.device.is_some() { rows_max.min(RECORDED_MAX) } else { rows_max };
        check_rows(header.stretch_rows, full_max)?;
        let mut writer = Self {
            out,
            offset: 0,
            failed: false,
            scratch: Vec::with_capacity(1 << 16),
            payload: Vec::new(),
            rows_max,
            index: Vec::new(),
            n_rows: 0,
            ledger_offset: 0,
            header: header.clone(),
            order: None,
            parameters: Parameters::default(),
            n_groups: 0,
            sample_ledger: None,
            tally: TakeTally::default(),
        };
        writer.tally.announce(header.channels.len());
        writer.scratch.extend_from_slice(&chunk::MAGIC);
        chunk::put(&mut writer.scratch, Header::KIND, &header.to_payload()?)?;
        writer.flush_scratch()?;
        Ok(writer)
    }

    /// Writes the subject, once, after the header.
    ///
    /// # Errors
    /// `Io`; `InvalidArgument` for more or longer documents than a take can hold.
    pub fn subject(&mut self, subject: &Subject) -> Result<(), TakeError> {
        self.record(subject)
    }

    /// Writes the order of the markers in the source, once, before the first stretch; nothing if it is that of the table in
    /// the header.
    ///
    /// # Errors
    /// `Io`; `InvalidArgument` if it is not an order of the markers of the header.
    pub fn order(&mut self, order: &ChannelOrder) -> Result<(), TakeError> {
        if order.is_identity() {
            return Ok(());
        }
        order
            .check(&self.header, self.offset)
            .map_err(|error| TakeError::InvalidArgument(error.to_string()))?;
        self.order = Some(order.clone());
        self.chunk(types::ORDER, &order.to_payload())
    }

    /// Appends channels to the channel table.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn channels(&mut self, channels: &[Channel]) -> Result<(), TakeError> {
        self.record(&MoreChannels(channels.to_vec()))?;
        self.header.channels.extend_from_slice(channels);
        self.tally.announce(self.header.channels.len());
        Ok(())
    }

    /// Writes a stretch, with a payload made by [`StretchHeaderWriter`](crate::stretch::StretchHeaderWriter) and
    /// [`put_block`](crate::stretch::put_block), and adds its `tally` to the statistics of the take.
    ///
    /// # Errors
    /// `Io`; `InvalidArgument` when it has more rows than a reader accepts, or too many rows were lost before it.
    pub fn stretch(
        &mut self,
        span: Span,
        payload: &[u8],
        tally: &StretchTally,
    ) -> Result<(), TakeError> {
        self.copy_stretch(span, payload)?;
        self.tally.add(span, tally);
        Ok(())
    }

    /// Writes a stretch of another take, whose statistics the caller passes at the end.
    pub(crate) fn copy_stretch(&mut self, span: Span, payload: &[u8]) -> Result<(), TakeError> {
        self.add_span(span)?;
        self.chunk(types::STRETCH, payload)
    }

    /// Validates the span of the next stretch, and adds it to the index.
    fn add_span(&mut self, span: Span) -> Result<(), TakeError> {
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

    /// Writes an event.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn event(&mut self, event: &Event) -> Result<(), TakeError> {
        self.record(event)
    }

    /// Writes observations of the clocks.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn clock(&mut self, clock: &Clock) -> Result<(), TakeError> {
        self.record(clock)
    }

    /// Writes the ledger so far.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn ledger(&mut self, ledger: &Ledger) -> Result<(), TakeError> {
        self.ledger_offset = self.offset;
        self.record(ledger)
    }

    /// Writes a part of an imported file. The samples of a part that has some go into groups of sampled channels; their
    /// names and units are those of the last `c3d/parameters` before it.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`, `Codec`.
    pub fn foreign(&mut self, part: &Foreign) -> Result<(), TakeError> {
        self.foreign_with_lost(part, &[])
    }

    /// Writes a part like [`foreign`](Self::foreign), with these samples recorded as lost.
    pub(crate) fn foreign_with_lost(
        &mut self,
        part: &Foreign,
        lost: &[LostSamples],
    ) -> Result<(), TakeError> {
        let Some(mut plan) = self.plan_samples(part)? else { return self.deflated(part) };
        plan.lose(lost);
        let mut encoder = SpanEncoder::default();
        for span in plan.spans() {
            self.span(&encoder.encode(&span?)?)?;
        }
        Ok(())
    }

    /// Describes analog channels as `take` does, if that has lost the parameters of its file.
    ///
    /// # Errors
    /// `Io`.
    pub(crate) fn describe_as(&mut self, take: &TakeMap) -> Result<(), TakeError> {
        if let Some(part) = c3d::analog_without_parameters(&take.foreign) {
            let kept = c3d::kept_parameters(&[c3d::parameters_of_channels(part)])?;
            self.parameters = kept.map(|(_, parameters)| parameters).unwrap_or_default();
        }
        Ok(())
    }

    /// Writes the groups of a part with samples, and plans the encoding of these, so that threads can share it; the
    /// caller [writes](Self::span) all spans of the plan in order. Writes nothing, and returns `None`, for another part.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn plan_samples<'p>(
        &mut self,
        part: &'p Foreign,
    ) -> Result<Option<SamplesPlan<'p>>, TakeError> {
        check_length(part)?;
        if part.kind == c3d::PARAMETERS {
            let kept = c3d::kept_parameters(std::slice::from_ref(part))?;
            self.parameters = kept.map(|(_, parameters)| parameters).unwrap_or_default();
        }
        let context = PartContext {
            rate_hz: self.header.rate_hz,
            is_unsigned: c3d::is_analog_unsigned(&self.parameters),
            first_group: self.n_groups,
            bounds: &part.bounds,
        };
        let markers = &self.header.channels;
        let marker = |column: usize| markers.get(column).map(|marker| marker.label.clone());
        let plan = SamplesPlan::new(&part.kind, &part.data, context, |kind, numbers| {
            let marker = |column| marker(column).unwrap_or_default();
            c3d::describe_sampled(kind, numbers, &self.parameters, marker)
        })?;
        for group in plan.iter().flat_map(SamplesPlan::groups) {
            self.sampled_group(group)?;
        }
        Ok(plan)
    }

    /// Writes a group of sampled channels, before its samples.
    ///
    /// # Errors
    /// `Io`; `InvalidArgument` for a group that a reader would refuse.
    pub fn sampled_group(&mut self, group: &SampledGroup) -> Result<(), TakeError> {
        self.n_groups = self.n_groups.max(group.number.saturating_add(1));
        self.chunk(types::SAMPLED_GROUP, &group.to_chunk_payload()?)
    }

    /// Writes samples of a group of a recording: the block of the span, or that they are lost.
    ///
    /// # Errors
    /// `Io`.
    pub fn samples(&mut self, span: &SampleSpan, block: &[u8]) -> Result<(), TakeError> {
        self.payload.clear();
        span.put(&mut self.payload);
        self.payload.extend_from_slice(block);
        self.own_payload(types::SAMPLES)
    }

    /// Writes the time of a sample of a group, and with `later` the number and the ticks of a later one in its run.
    ///
    /// # Errors
    /// `Io`.
    pub fn sample_time(
        &mut self,
        group: u32,
        anchor: &SampleAnchor,
        later: Option<(u64, u64)>,
    ) -> Result<(), TakeError> {
        self.payload.clear();
        SampleTimes::put(group, anchor, later, &mut self.payload);
        self.own_payload(types::SAMPLE_TIMES)
    }

    /// Allocates the memory for blocks of samples of up to this size.
    pub fn reserve_samples(&mut self, block_bytes: usize) {
        // Head and three numbers precede a block, and the chunk's own head and CRC surround it.
        self.payload.reserve(block_bytes + 64);
        self.scratch.reserve(block_bytes + 128);
    }

    /// Writes a chunk with the payload in `self.payload`, whose memory is kept.
    fn own_payload(&mut self, kind: u8) -> Result<(), TakeError> {
        let payload = std::mem::take(&mut self.payload);
        let written = self.chunk(kind, &payload);
        self.payload = payload;
        written
    }

    /// Writes the ledger of the samples so far.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn sample_ledger(&mut self, ledger: &SampleLedger) -> Result<(), TakeError> {
        self.sample_ledger = Some(ledger.clone());
        self.record(ledger)
    }

    /// Records samples of a group as lost.
    pub(crate) fn lost_samples(&mut self, span: &SampleSpan) -> Result<(), TakeError> {
        self.samples(span, &[])
    }

    /// Writes an encoded span.
    ///
    /// # Errors
    /// `Io`.
    pub fn span(&mut self, encoded: &EncodedSpan) -> Result<(), TakeError> {
        encoded.0.iter().try_for_each(|payload| self.chunk(types::SAMPLES, payload))
    }

    /// Writes a part as one deflated chunk.
    fn deflated(&mut self, part: &Foreign) -> Result<(), TakeError> {
        let ForeignPayload { front, deflated } = ForeignPayload::of(part)?;
        let payload_bytes = front.len() as u64 + deflated.len();
        self.scratch.clear();
        chunk::put_head(&mut self.scratch, types::FOREIGN, payload_bytes)?;
        self.scratch.extend_from_slice(&front);
        let mut crc = Hasher::new();
        let mut deflated = deflated.reader();
        loop {
            let n = deflated.by_ref().take(COPIED_BYTES).read_to_end(&mut self.scratch)?;
            crc.update(&self.scratch);
            if n == 0 {
                self.scratch.extend_from_slice(&crc.finalize().to_le_bytes());
                return self.flush_scratch();
            }
            self.flush_scratch()?;
            self.scratch.clear();
        }
    }

    /// [Closes](Self::close) the take without stating how it ended. Returns the output and the number of bytes written.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn finish(mut self, ledger: &Ledger) -> Result<(W, u64), TakeError> {
        self.close(ledger, None)?;
        Ok((self.out, self.offset))
    }

    /// Writes the last ledger, the summary with the `ending`, index and footer, and flushes. Nothing more may be
    /// written.
    ///
    /// # Errors
    /// `Io`, `InvalidArgument`.
    pub fn close(&mut self, ledger: &Ledger, ending: Option<TakeEnding>) -> Result<(), TakeError> {
        let header = Some(Box::new(std::mem::take(&mut self.header)));
        let statistics = Some(std::mem::take(&mut self.tally).finish(self.n_rows));
        let order = self.order.take();
        let sample_ledger = self.sample_ledger.take();
        self.close_with(ledger, &SummaryRecord { ending, header, statistics, order, sample_ledger })
    }

    /// Closes the take like [`close`](Self::close), with another summary.
    pub(crate) fn close_with(
        &mut self,
        ledger: &Ledger,
        summary: &SummaryRecord,
    ) -> Result<(), TakeError> {
        self.ledger(ledger)?;
        // Where all channels together are more than a record can hold, a reader has to read them where they were announced.
        let only_ending = || SummaryRecord {
            ending: summary.ending.clone(),
            order: summary.order.clone(),
            sample_ledger: summary.sample_ledger.clone(),
            ..Default::default()
        };
        let payload = summary.to_payload().or_else(|_| only_ending().to_payload())?;
        self.chunk(types::SUMMARY, &payload)?;
        let index_offset = self.offset;
        self.chunk(types::INDEX, &index_payload(&self.index))?;
        let footer =
            Footer { index_offset, ledger_offset: self.ledger_offset, n_rows: self.n_rows };
        self.chunk(types::FOOTER, &footer.to_payload())?;
        self.out.flush()?;
        Ok(())
    }

    /// Returns the output. A take that was not closed remains one that was cut off.
    #[must_use]
    pub fn abandon(self) -> W {
        self.out
    }

    /// Number of bytes written.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.offset
    }

    /// The output, for a sync.
    pub fn get_mut(&mut self) -> &mut W {
        &mut self.out
    }

    /// Copies a chunk of another take, of any length `len`, and returns whether its CRC matches. A stretch needs its
    /// `span`.
    pub(crate) fn copy_long(
        &mut self,
        span: Option<Span>,
        mut chunk: impl Read,
        len: u64,
    ) -> Result<bool, TakeError> {
        span.map_or(Ok(()), |span| self.add_span(span))?;
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

    /// Writes a chunk that is not a stretch, or one whose span was added. A channel table is not followed.
    pub(crate) fn chunk(&mut self, kind: u8, payload: &[u8]) -> Result<(), TakeError> {
        self.scratch.clear();
        chunk::put(&mut self.scratch, kind, payload)?;
        self.flush_scratch()
    }

    /// One `write` per chunk, so that a kill leaves at most one incomplete chunk.
    fn flush_scratch(&mut self) -> Result<(), TakeError> {
        if self.failed {
            let message = "an earlier write failed; nothing more is written to this take".into();
            return Err(TakeError::InvalidArgument(message));
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

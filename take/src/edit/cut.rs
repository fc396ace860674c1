//! Copies a range of rows of a take into a new take.

use std::{
    io::{Read, Seek, Write},
    iter,
    ops::Range,
};

use mocapd_codec::{
    BlockEncoder, BlockReport, DecodedRows, GROUP_CHANNELS, Position, ResamplerKind, Rows, Settings,
};

use super::{CUT, CutOrigin, EditContext, SourceTake, damaged, recorded};
use crate::{
    TakeError, TakeEvent, TakeTraversal, TakeWriter,
    record::{EndingKind, Event, Header, Ledger, SeriesPlace, TakeEnding},
    recovery::LedgerTally,
    sampled::is_recorded,
    statistics::{BlockTally, StretchTally},
    stretch::{CopiedStretch, NUMBERS, Span, Stretch, StretchHeaderWriter, put_block},
    timeline::{RowRun, Timeline, TimelineEncoder},
    traversal::{Decode, Progress},
};

/// The result of a cut.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CutReport {
    /// Rows of the new take, including lost ones.
    pub rows: u64,
    /// Entries of the channel table of the new take.
    pub n_channels: usize,
    /// Rows whose blocks were copied, or could be encoded again to the same floats.
    pub rows_copied: u64,
    /// Rows whose samples were stored as floats.
    pub rows_exact: u64,
    /// The ledger of the new take.
    pub ledger: Ledger,
    /// Size of the new take in bytes.
    pub bytes: u64,
    /// What the new take lacks of these rows, one phrase each.
    pub left_out: Vec<String>,
}

/// Copies the rows `rows` of a take, with all that belongs to them, into a new take: the same floats, gaps and
/// times. `input` is the file that `source` was read from.
///
/// The number of the first row in an imported file increases accordingly, so that `verify --against` finds the rows.
///
/// # Errors
/// `InvalidArgument` if there are no rows in the range, or a stretch cannot be decoded; `Io`; those of [`TakeWriter`].
pub fn cut<W: Write>(
    source: &SourceTake,
    mut input: impl Read + Seek,
    rows: Range<u64>,
    out: W,
    context: &EditContext<'_>,
) -> Result<CutReport, TakeError> {
    let n_rows = source.map().n_rows;
    if rows.start >= rows.end || rows.end > n_rows {
        return Err(TakeError::InvalidArgument(format!(
            "frames {} to {} are not in a take of {n_rows} frames",
            rows.start, rows.end
        )));
    }
    let header = header_of_part(source, &rows, context)?;
    let mut take = TakeWriter::new(out, &header)?;
    source.map().subject.iter().try_for_each(|subject| take.subject(subject))?;
    take.order(&source.map().order.extended(header.channels.len()))?;
    recorded::write_groups(source.map(), &mut take)?;
    take.describe_as(source.map())?;
    let mut left_out: Vec<String> = source.left_out().collect();
    let first_frame = source.first_frame();
    let frames = first_frame.saturating_add(rows.start)..first_frame.saturating_add(rows.end);
    for part in source.map().foreign.iter().filter(|part| !is_recorded(&part.kind)) {
        match super::cut_part(part, &mut input, &frames, context)? {
            Some(found) => take.foreign_with_lost(&found.part, &found.lost)?,
            None => left_out.push(part.kind.clone()),
        }
    }
    for event in events_of(&source.map().events, &rows, n_rows) {
        take.event(&event)?;
    }
    let mut cutter = Cutter::new(source, rows.clone(), take, header.channels.len())?;
    let mut traversal = TakeTraversal::from_map(&mut input, source.map(), Decode::All)?;
    traversal.seek(rows.start)?;
    while cutter.next_row < rows.end && !traversal.is_ended() {
        traversal.step(|found, progress| match &found.event {
            TakeEvent::Stretch(stretch) if !found.is_refused => cutter.stretch(stretch, progress),
            _ => Ok(()),
        })?;
        (context.on_rows)(cutter.next_row.saturating_sub(rows.start));
    }
    if let Some(problem) = traversal.problems().first() {
        return Err(damaged(problem));
    }
    recorded::cut(source, &mut input, &rows, &mut cutter.take)?;
    CutReport { left_out, ..cutter.finish()? }.into_result(&rows)
}

impl CutReport {
    /// Fails if rows are missing, because the file has changed since it was read.
    fn into_result(self, rows: &Range<u64>) -> Result<Self, TakeError> {
        if self.rows == rows.end - rows.start {
            return Ok(self);
        }
        Err(TakeError::InvalidArgument(
            "another program changed the take while it was being read".into(),
        ))
    }
}

fn header_of_part(
    source: &SourceTake,
    rows: &Range<u64>,
    context: &EditContext<'_>,
) -> Result<Header, TakeError> {
    let map = source.map();
    let mut header = map.header.clone();
    let n_channels = source.channels_at(rows.start);
    header.channels = map.table().get(..n_channels).unwrap_or_default().to_vec();
    if header.created_unix_ms != 0 {
        let ms = (rows.start as f64 * 1000.0 / header.rate_hz).round() as i64;
        header.created_unix_ms = header.created_unix_ms.saturating_add(ms);
    }
    if let Some(import) = &mut header.source {
        import.first_frame = import.first_frame.saturating_add(rows.start);
    }
    let origin = CutOrigin { take_id: map.header.take_id_text(), rows: rows.clone() };
    let note = origin.to_setting(map.n_rows, context.software);
    header.settings.push((CUT.to_owned(), note));
    if *rows != (0..map.n_rows) {
        // The size of the source file is not that of the part.
        header.unset_source_bytes();
    }
    SeriesPlace::advance(&mut header, rows.start);
    header.set_import_id(&map.header.take_id[..], map.subject.as_ref())?;
    Ok(header)
}

/// The events of these rows; those at the end of the take belong to a part that reaches it.
fn events_of(events: &[Event], rows: &Range<u64>, n_rows: u64) -> impl Iterator<Item = Event> {
    let is_inside = move |event: &&Event| {
        event.row >= rows.start && (event.row < rows.end || rows.end == n_rows)
    };
    let moved = |event: &Event| Event { row: event.row - rows.start, ..event.clone() };
    events.iter().filter(is_inside).map(moved)
}

/// The state of a cut.
struct Cutter<'a, W> {
    source: &'a SourceTake,
    rows: Range<u64>,
    take: TakeWriter<W>,
    /// Entries of the channel table that were written.
    n_channels: usize,
    /// The number of the next stretch.
    number: u8,
    /// The row after the last stretch that was read.
    next_row: u64,
    /// Whether the stretch before was copied, so that the next one may continue it.
    in_step: bool,
    untimed: StretchHeaderWriter,
    timed: StretchHeaderWriter,
    exact: ExactBlocks,
    payload: Vec<u8>,
    tally: LedgerTally,
    report: CutReport,
}

impl<'a, W: Write> Cutter<'a, W> {
    fn new(
        source: &'a SourceTake,
        rows: Range<u64>,
        take: TakeWriter<W>,
        n_channels: usize,
    ) -> Result<Self, TakeError> {
        let header = &source.map().header;
        let tick_hz = header.device.as_ref().map_or(1, |device| device.tick_hz);
        let times = TimelineEncoder::exact(tick_hz, header.rate_hz);
        Ok(Self {
            source,
            rows,
            take,
            n_channels,
            number: 0,
            next_row: 0,
            in_step: false,
            untimed: StretchHeaderWriter::new(header.stretch_rows),
            timed: StretchHeaderWriter::with_times(header.stretch_rows, times),
            exact: ExactBlocks::new(&header.codec()?),
            payload: Vec::new(),
            tally: LedgerTally::default(),
            report: CutReport::default(),
        })
    }

    /// Writes the rows of a decoded stretch that belong to the part.
    fn stretch(&mut self, stretch: &Stretch<'_>, progress: &Progress) -> Result<(), TakeError> {
        let (from_row, end_row) = (stretch.from_row(), stretch.span.end_row());
        self.next_row = end_row;
        if from_row >= self.rows.end {
            return Ok(());
        }
        let is_whole = stretch.span.first_row >= self.rows.start && end_row <= self.rows.end;
        let can_copy = is_whole && (stretch.span.key || self.in_step);
        let is_outside = end_row.min(self.rows.end) <= from_row.max(self.rows.start);
        // A stretch that accounts for no row overlaps nothing. After the start it is copied, so that the next one can
        // continue it.
        if is_outside && !(can_copy && from_row > self.rows.start) {
            self.in_step = false;
            return Ok(());
        }
        let n_channels = self.source.channels_at(from_row.max(self.rows.start));
        self.grow(n_channels)?;
        let timeline =
            stretch.timeline.as_ref().map(|timeline| self.moved(timeline.part(self.rows.clone())));
        let rows = stretch.span.first_row.max(self.rows.start)..end_row.min(self.rows.end);
        let rows = rows.start.min(rows.end)..rows.end;
        let n_rows = (rows.end - rows.start) as u32;
        let first_row = rows.start - self.rows.start;
        let first_here = (rows.start - stretch.span.first_row.min(rows.start)) as usize;
        let here = first_here..first_here + n_rows as usize;
        let recorded = [RowRun { rows: n_rows.into(), lost: None }];
        let runs = timeline.as_ref().map_or(&recorded[..], |timeline| &timeline.runs);
        // A stretch without rows leaves the rows of the one before decoded.
        let decoded = progress.coded_rows().take(if n_rows > 0 { n_channels } else { 0 });
        let channels: Vec<_> = decoded.collect();
        self.tally.add_runs(runs, n_channels, samples_in(&channels, &here));
        if can_copy {
            let from_row = timeline.as_ref().map_or(first_row, |timeline| timeline.first_row);
            let stretch_rows = [self.source.map().header.stretch_rows; 2];
            let runs = timeline.map(|timeline| timeline.runs);
            let span = Span { first_row, n_rows, key: stretch.span.key, number: self.number };
            self.payload.clear();
            CopiedStretch { span, from_row, runs, stretch_rows }
                .put(stretch.payload, &mut self.payload)?;
            self.report.rows_copied += u64::from(n_rows);
            let tally = StretchTally::of_decoded(stretch, channels.iter().copied());
            self.push(span, &tally)?;
        } else {
            let pieces = match &timeline {
                Some(_) => vec![here],
                None => self.exact.pieces(&channels, here, stretch.span.key)?,
            };
            for piece in pieces {
                let first_row = first_row + (piece.start - first_here) as u64;
                self.encode(&channels, piece, first_row, timeline.clone())?;
            }
        }
        // A stretch without rows changes nothing for the blocks after it.
        self.in_step = can_copy && (n_rows > 0 || self.in_step);
        Ok(())
    }

    /// Writes the channels that appear up to entry `n_channels`.
    fn grow(&mut self, n_channels: usize) -> Result<(), TakeError> {
        let more = self.source.map().channels.get(self.n_channels..n_channels).unwrap_or_default();
        if !more.is_empty() {
            self.take.channels(more)?;
            self.n_channels = n_channels;
        }
        Ok(())
    }

    /// Writes the rows `here` of decoded channels as a separate key stretch.
    fn encode(
        &mut self,
        channels: &[Option<&DecodedRows>],
        here: Range<usize>,
        first_row: u64,
        timeline: Option<Timeline>,
    ) -> Result<(), TakeError> {
        let alone = channels.len() <= GROUP_CHANNELS;
        let n_rows = here.len() as u32;
        let span = Span { first_row, n_rows, key: true, number: self.number };
        let front = if timeline.is_some() { &mut self.timed } else { &mut self.untimed };
        self.payload.clear();
        front.put(span, &timeline.unwrap_or_default(), &[], alone, &mut self.payload);
        let (tally, is_stored) = self.exact.put(channels, &here, alone, &mut self.payload)?;
        let rows =
            if is_stored { &mut self.report.rows_exact } else { &mut self.report.rows_copied };
        *rows += u64::from(n_rows);
        self.push(span, &tally)
    }

    /// Writes the payload as the next stretch.
    fn push(&mut self, span: Span, tally: &StretchTally) -> Result<(), TakeError> {
        self.take.stretch(span, &self.payload, tally)?;
        self.number = (self.number + 1) % NUMBERS;
        self.report.rows = span.end_row();
        Ok(())
    }

    /// Moves a timeline of the take to its rows in the part.
    fn moved(&self, timeline: Timeline) -> Timeline {
        Timeline { first_row: timeline.first_row - self.rows.start, ..timeline }
    }

    /// Writes the clocks, the ledger and the end.
    fn finish(mut self) -> Result<CutReport, TakeError> {
        let map = self.source.map();
        if self.rows.end == map.n_rows {
            // Channels may be announced after the last stretch.
            self.grow(map.channels.len())?;
        }
        for clock in &self.source.clocks {
            self.take.clock(clock)?;
        }
        let is_all = self.rows == (0..map.n_rows);
        let ledger = match &map.ledger {
            Some(ledger) if is_all => ledger.clone(),
            ledger => {
                let (contradictions, clock) = ledger
                    .as_ref()
                    .map_or((Vec::new(), None), |l| (l.contradictions.clone(), l.clock));
                Ledger { contradictions, clock, ..self.tally.close(None, &[]) }
            }
        };
        let detail = || format!("cut at frame {} of {}", self.rows.end, map.n_rows);
        let ending = match &map.ending {
            ending if self.rows.end == map.n_rows => ending.clone(),
            _ => Some(TakeEnding::new(EndingKind::Length, detail())),
        };
        self.take.close(&ledger, ending)?;
        let bytes = self.take.bytes();
        Ok(CutReport { n_channels: self.n_channels, ledger, bytes, ..self.report })
    }
}

/// Samples present in the rows `here` of a decoded stretch.
fn samples_in(channels: &[Option<&DecodedRows>], here: &Range<usize>) -> u64 {
    let present = |rows: &DecodedRows| {
        rows.present.get(here.clone()).unwrap_or_default().iter().filter(|&&p| p).count() as u64
    };
    channels.iter().flatten().map(|rows| present(rows)).sum()
}

/// Rows of a span of `dense`: a key block has the same points in as many whole spans as are kept of it.
const SPAN_ROWS: usize = 64;

/// Minimum number of rows in which nothing moves that become a separate stretch: stored, they take 192 bytes for each
/// marker, more than a further stretch.
const STILL_ROWS_MIN: usize = 16;

/// Encodes decoded samples as key blocks that decode to the same floats.
pub(super) struct ExactBlocks {
    encoder: Box<dyn BlockEncoder>,
    reports: Vec<BlockReport>,
    /// Some samples can be encoded again, and need not be stored.
    is_dense: bool,
}

impl ExactBlocks {
    pub(super) fn new(codec: &Settings) -> Self {
        let is_dense = codec.kind == ResamplerKind::Dense;
        Self { encoder: codec.encoder(), reports: Vec::new(), is_dense }
    }

    /// Divides the rows `here` of a decoded stretch into stretches that take few bytes: whole spans behind its key, if
    /// the rows begin with it, and rows in which nothing moves can be encoded again; others are stored.
    fn pieces(
        &mut self,
        channels: &[Option<&DecodedRows>],
        here: Range<usize>,
        is_key: bool,
    ) -> Result<Vec<Range<usize>>, TakeError> {
        if !self.is_dense || here.len() < STILL_ROWS_MIN {
            return Ok(vec![here]);
        }
        if !self.put(channels, &here, true, &mut Vec::new())?.1 {
            return Ok(vec![here]);
        }
        let mut pieces = Vec::new();
        let mut at = here.start;
        if is_key && at == 0 && here.end > SPAN_ROWS {
            at = here.end - here.end % SPAN_ROWS;
            pieces.push(0..at);
        }
        for still in still_runs(channels, at..here.end) {
            if at < still.start {
                pieces.push(at..still.start);
            }
            at = still.end;
            pieces.push(still);
        }
        if at < here.end {
            pieces.push(at..here.end);
        }
        Ok(pieces)
    }

    /// Appends the blocks of the rows `here` of decoded channels, and counts their samples. Also returns whether samples
    /// of a channel are stored.
    pub(super) fn put(
        &mut self,
        channels: &[Option<&DecodedRows>],
        here: &Range<usize>,
        alone: bool,
        out: &mut Vec<u8>,
    ) -> Result<(StretchTally, bool), TakeError> {
        let mut tally = BlockTally::default();
        tally.restart(here.len());
        let mut is_stored = false;
        // A channel without samples, in the stretch or at all.
        let (absent, nowhere) = (vec![false; here.len()], vec![[0.0; 3]; here.len()]);
        for group in channels.chunks(GROUP_CHANNELS).filter(|_| !here.is_empty()) {
            let rows = group.iter().map(|decoded| {
                let part = decoded.and_then(|decoded| {
                    let positions: &[Position] = decoded.positions.get(here.clone())?;
                    Some((positions, decoded.present.get(here.clone())?))
                });
                let (positions, present) = part.unwrap_or((&nowhere, &absent));
                Rows::new(positions, present)
            });
            let rows = rows.collect::<Result<Vec<_>, _>>()?;
            // All channels of a block state the same error.
            let stated = group.iter().flatten().map(|decoded| decoded.max_error_mm);
            let stated_mm = stated.fold(0.0, f64::max);
            self.reports.clear();
            self.reports.extend(iter::repeat_n(BlockReport::default(), rows.len()));
            let mut block = Vec::new();
            self.encoder.encode_exact(&rows, stated_mm, &mut block, &mut self.reports)?;
            put_block(&block, alone, out);
            let mut reports = self.reports.iter();
            is_stored |= reports.any(|report| report.samples > 1 && report.kept == report.samples);
            let kept_rows = self.encoder.kept_rows();
            tally.append(&BlockTally::of_encoded(&block, &rows, &self.reports, kept_rows));
        }
        Ok((StretchTally::of(&tally), is_stored))
    }
}

/// The longest runs of the rows `here` in which every marker has one position, of those that are long enough.
fn still_runs(channels: &[Option<&DecodedRows>], here: Range<usize>) -> Vec<Range<usize>> {
    let mut is_moved = vec![false; here.len()];
    for decoded in channels.iter().flatten() {
        let mut last = None;
        for (row, is_moved) in here.clone().zip(&mut is_moved) {
            if !decoded.present.get(row).copied().unwrap_or_default() {
                continue;
            }
            let at = decoded.positions.get(row).map(|position| position.map(f32::to_bits));
            *is_moved |= last.is_some_and(|last| last != at);
            last = Some(at);
        }
    }
    let mut runs = Vec::new();
    let mut start = here.start;
    let moves = here.clone().zip(is_moved).filter(|(_, is_moved)| *is_moved).map(|(row, _)| row);
    for end in moves.chain([here.end]) {
        if end - start >= STILL_ROWS_MIN {
            runs.push(start..end);
        }
        start = end;
    }
    runs
}

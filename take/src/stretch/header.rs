//! The header of a stretch, before its blocks (docs/take-format.md, "STRETCH"), and the continuity from stretch to
//! stretch: the first row of each, and the state of the clocks before it.

use super::{
    NUMBERS, RECORDED_MAX, ROWS_MAX, ROWS_PASSED_MAX, RUNS_MAX, Span, Stretch, StretchSizes,
    rows_max, take_blocks,
};
use crate::{
    TakeError,
    record::Header,
    timeline::{LossCauses, RowRun, Timeline, TimelineDecoder, TimelineEncoder, take_times},
    varint,
};

pub(super) const KEY: u8 = 1;
const PLAIN: u8 = 2;
const ALONE: u8 = 4;
const NUMBER_SHIFT: u32 = 3;

const HAS_TIMES: u8 = 1;
const RUNS_LISTED: u8 = 2;
const ROWS_LISTED: u8 = 4;
const SHARED: u8 = 8;

/// Writes the headers of a take's stretches, in order.
#[derive(Debug)]
pub struct StretchHeaderWriter {
    stretch_rows: u32,
    times: Option<TimelineEncoder>,
}

impl StretchHeaderWriter {
    /// A writer for stretches without time lines, as in imports. `stretch_rows` is that of the take's HEADER.
    #[must_use]
    pub fn new(stretch_rows: u32) -> Self {
        Self { stretch_rows, times: None }
    }

    /// A writer for stretches with time lines.
    #[must_use]
    pub fn with_times(stretch_rows: u32, times: TimelineEncoder) -> Self {
        Self { stretch_rows, times: Some(times) }
    }

    /// Appends the header of a stretch. The caller then appends the block of each group, in the order of the channel
    /// table, with [`put_block`](super::put_block). `timeline` covers the rows from the end of the previous stretch to
    /// the end of this one; it is written only with [`with_times`](Self::with_times). `alone`: at most one block
    /// follows.
    pub fn put(
        &mut self,
        span: Span,
        timeline: &Timeline,
        shared: &[u8],
        alone: bool,
        out: &mut Vec<u8>,
    ) {
        let runs = self.times.is_some().then_some(&timeline.runs[..]);
        let from_row = runs.map_or(span.first_row, |_| timeline.first_row);
        let stretch_rows = self.stretch_rows;
        StretchFront { span, from_row, runs, has_shared: !shared.is_empty(), alone, stretch_rows }
            .put(out);
        if let Some(times) = &mut self.times {
            times.encode(timeline, span.key, out);
        }
        if !shared.is_empty() {
            varint::put_prefixed(out, shared);
        }
    }
}

/// What precedes the times of a stretch.
struct StretchFront<'a> {
    span: Span,
    /// The row after the previous stretch.
    from_row: u64,
    /// With a time line: the runs of rows from `from_row` on.
    runs: Option<&'a [RowRun]>,
    has_shared: bool,
    alone: bool,
    /// Rows of a stretch that lists no number.
    stretch_rows: u32,
}

impl StretchFront<'_> {
    fn put(&self, out: &mut Vec<u8>) {
        let Self { span, runs, .. } = self;
        let lost = runs.is_some_and(|runs| runs.iter().any(|run| run.lost.is_some()));
        let shape = flag(runs.is_some(), HAS_TIMES)
            | flag(lost, RUNS_LISTED)
            | flag(span.n_rows != self.stretch_rows, ROWS_LISTED)
            | flag(self.has_shared, SHARED);
        let plain = shape == HAS_TIMES;
        let flags = flag(span.key, KEY) | flag(plain, PLAIN) | flag(self.alone, ALONE);
        out.push(flags | ((span.number % NUMBERS) << NUMBER_SHIFT));
        if !plain {
            out.push(shape);
        }
        if span.key {
            varint::put(out, self.from_row);
        }
        if shape & ROWS_LISTED != 0 {
            varint::put(out, u64::from(span.n_rows));
        }
        if let Some(runs) = runs.filter(|_| lost) {
            varint::put(out, runs.len() as u64);
            for run in runs {
                varint::put(out, (run.rows << 1) | u64::from(run.lost.is_some()));
                out.extend(run.lost.map(|causes| causes.0));
            }
        }
    }
}

/// Whether at most one block follows the header of this payload.
pub(crate) fn is_alone(payload: &[u8]) -> bool {
    payload.first().is_some_and(|head| head & ALONE != 0)
}

fn flag(set: bool, bit: u8) -> u8 {
    if set { bit } else { 0 }
}

/// The parsed header of a stretch, not yet related to the previous stretch.
#[derive(Debug)]
pub(crate) struct StretchHeader<'a> {
    pub(crate) key: bool,
    pub(crate) alone: bool,
    pub(crate) number: u8,
    /// For a key stretch: the row after the previous stretch.
    pub(crate) from_row: Option<u64>,
    pub(crate) n_rows: u32,
    /// With a time line: the runs of rows from `from_row` on.
    pub(crate) runs: Option<Vec<RowRun>>,
    /// Rows from `from_row` to the end: `n_rows`, and those lost before.
    pub(crate) rows_passed: u64,
    pub(crate) times: &'a [u8],
    pub(crate) shared: &'a [u8],
    pub(crate) sizes: StretchSizes,
}

/// Whether these bytes are a plausible start of a stretch's payload, by the fields that are cheap to check.
pub(crate) fn may_begin_with(payload: &[u8]) -> bool {
    let mut cursor = varint::Cursor::new(payload);
    let Some(head) = cursor.byte() else { return false };
    let shape = if head & PLAIN != 0 { Some(HAS_TIMES) } else { cursor.byte() };
    let row = if head & KEY != 0 { cursor.varint() } else { Some(0) };
    let Some((shape, _)) = shape.zip(row).filter(|(shape, _)| is_known(*shape)) else {
        return false;
    };
    let listed = shape & ROWS_LISTED != 0;
    !listed || cursor.varint().is_some_and(|n_rows| (1..=ROWS_MAX).contains(&n_rows))
}

fn is_known(shape: u8) -> bool {
    shape <= HAS_TIMES | RUNS_LISTED | ROWS_LISTED | SHARED
        && shape & (HAS_TIMES | RUNS_LISTED) != RUNS_LISTED
}

impl<'a> StretchHeader<'a> {
    /// Parses the header at the front of `cursor`. The stretch has `stretch_rows` rows unless it lists another number,
    /// and at most `rows_max`. The error is a message.
    pub(crate) fn take(
        cursor: &mut varint::Cursor<'a>,
        rows_max: u64,
        stretch_rows: u32,
    ) -> Result<Self, &'static str> {
        let short = "its header is truncated";
        let before = cursor.rest().len();
        let head = cursor.byte().ok_or(short)?;
        let shape = if head & PLAIN != 0 { HAS_TIMES } else { cursor.byte().ok_or(short)? };
        let key = head & KEY != 0;
        if !is_known(shape) {
            return Err("unknown form of its header: use a newer mocapd");
        }
        let from_row = if key { Some(cursor.varint().ok_or(short)?) } else { None };
        let listed = shape & ROWS_LISTED != 0;
        let n_rows = if listed { cursor.varint().ok_or(short)? } else { stretch_rows.into() };
        if n_rows > rows_max {
            return Err("it claims more rows than a stretch can hold");
        }
        let in_head = before - cursor.rest().len();
        let runs = match shape & (HAS_TIMES | RUNS_LISTED) {
            0 => None,
            HAS_TIMES if n_rows == 0 => Some(Vec::new()),
            HAS_TIMES => Some(vec![RowRun { rows: n_rows, lost: None }]),
            _ => Some(take_runs(cursor).ok_or("its runs are invalid")?),
        };
        let rows_of = |runs: &[RowRun], all: bool| {
            let runs = runs.iter().filter(|run| all || run.lost.is_none());
            runs.fold(0_u64, |sum, run| sum.saturating_add(run.rows))
        };
        let (rows_passed, n_recorded) =
            runs.as_deref().map_or((n_rows, 0), |runs| (rows_of(runs, true), rows_of(runs, false)));
        if rows_passed < n_rows || n_recorded > RECORDED_MAX {
            return Err("its runs are invalid");
        }
        if rows_passed > ROWS_PASSED_MAX {
            return Err("it claims more lost rows than can lie between two stretches");
        }
        let times = if n_recorded > 0 { take_times(cursor, key).ok_or(short)? } else { &[] };
        let in_time_line = before - cursor.rest().len() - in_head;
        let mut shared = &[][..];
        let mut framing = in_head;
        if shape & SHARED != 0 {
            let left = cursor.rest().len();
            shared = cursor.prefixed().ok_or(short)?;
            framing += left - cursor.rest().len() - shared.len();
        }
        Ok(Self {
            key,
            alone: head & ALONE != 0,
            number: head >> NUMBER_SHIFT,
            from_row,
            n_rows: n_rows as u32,
            runs,
            rows_passed,
            times,
            shared,
            sizes: StretchSizes {
                framing: framing as u64,
                time_line: in_time_line as u64,
                blocks: shared.len() as u64,
                ..StretchSizes::default()
            },
        })
    }

    /// Whether the stretch has no rows and replaces damaged stretches of a recovered take.
    pub(crate) fn replaces_damaged(&self) -> bool {
        self.n_rows == 0 && super::all_damaged(self.runs.as_deref().unwrap_or_default())
    }
}

fn take_runs(cursor: &mut varint::Cursor<'_>) -> Option<Vec<RowRun>> {
    let n_runs = cursor.varint().filter(|&n| n <= RUNS_MAX)?;
    let mut runs = Vec::new();
    for _ in 0..n_runs {
        let head = cursor.varint()?;
        let lost = if head & 1 == 1 { Some(LossCauses(cursor.byte()?)) } else { None };
        let rows = Some(head >> 1).filter(|&rows| rows > 0)?;
        runs.push(RowRun { rows, lost });
    }
    Some(runs)
}

/// Appends `payload`, made by [`StretchHeaderWriter`], for another take: with stretch number `number`, and with row
/// `rows_before` of the original recording as row 0. Only the number and the row of a key stretch are rewritten;
/// nothing is decoded.
///
/// # Errors
/// `InvalidArgument` for a payload without a complete header, or a stretch that begins before the take.
pub fn put_renumbered(
    payload: &[u8],
    rows_before: u64,
    number: u8,
    out: &mut Vec<u8>,
) -> Result<(), TakeError> {
    let wrong = |what: &str| TakeError::InvalidArgument(format!("a stretch that {what}"));
    let mut cursor = varint::Cursor::new(payload);
    let short = || wrong("has no complete header");
    let head = cursor.byte().ok_or_else(short)?;
    out.push((head & ((1 << NUMBER_SHIFT) - 1)) | ((number % NUMBERS) << NUMBER_SHIFT));
    if head & PLAIN == 0 {
        out.push(cursor.byte().ok_or_else(short)?);
    }
    if head & KEY != 0 {
        let from_row = cursor.varint().ok_or_else(short)?;
        let from_row = from_row.checked_sub(rows_before);
        varint::put(out, from_row.ok_or_else(|| wrong("begins before the take"))?);
    }
    out.extend_from_slice(cursor.rest());
    Ok(())
}

/// The place of a copied stretch in another take.
#[derive(Debug, Clone)]
pub(crate) struct CopiedStretch {
    /// Its rows and number there.
    pub(crate) span: Span,
    /// The row after the stretch before it there.
    pub(crate) from_row: u64,
    /// With a time line: the runs from that row on. They differ from the stored ones in lost rows before the first
    /// recorded one only.
    pub(crate) runs: Option<Vec<RowRun>>,
    /// Rows of a full stretch in the take that it comes from, and in the other.
    pub(crate) stretch_rows: [u32; 2],
}

impl CopiedStretch {
    /// Appends `payload`, which was read as a stretch, for its new place. Times, shared bytes and blocks stay as they are.
    ///
    /// # Errors
    /// `InvalidArgument` for a payload without a valid header.
    pub(crate) fn put(&self, payload: &[u8], out: &mut Vec<u8>) -> Result<(), TakeError> {
        let mut cursor = varint::Cursor::new(payload);
        let [before, now] = self.stretch_rows;
        let header = StretchHeader::take(&mut cursor, ROWS_MAX, before)
            .map_err(|why| TakeError::InvalidArgument(format!("a stretch: {why}")))?;
        let (span, from_row, has_shared) = (self.span, self.from_row, !header.shared.is_empty());
        let (runs, alone, stretch_rows) = (self.runs.as_deref(), header.alone, now);
        StretchFront { span, from_row, runs, has_shared, alone, stretch_rows }.put(out);
        out.extend_from_slice(header.times);
        if has_shared {
            varint::put_prefixed(out, header.shared);
        }
        out.extend_from_slice(cursor.rest());
        Ok(())
    }
}

/// A stretch with known rows, or the remains of one whose rows are unknown.
#[derive(Debug)]
pub(crate) enum Placement<'a> {
    Stretch(Stretch<'a>),
    /// The stretch continues one that is missing or damaged.
    Unplaced {
        missing_before: bool,
        n_rows: u32,
        /// The least number of rows that the take has up to the end of this stretch.
        rows_min: u64,
    },
}

/// Follows the stretches of a take.
///
/// A key stretch states its row and clocks; any other stretch continues the previous one. After anything that may have
/// contained a stretch, no row is assigned up to the next key stretch, because the blocks could not be decoded either.
#[derive(Debug)]
pub(crate) struct StretchChain {
    rows_max: u64,
    stretch_rows: u32,
    /// `None` if times are not decoded.
    times: Option<TimelineDecoder>,
    /// The row after the last stretch; after damage, its least possible value.
    next_row: u64,
    /// The number of the next stretch; `None` if reading began in the middle of the take.
    next_number: Option<u8>,
    /// Whether the next stretch does not continue what was read.
    broken: bool,
}

impl StretchChain {
    /// Starts at the first stretch of the take with this header.
    pub(crate) fn from_header(header: &Header) -> Result<Self, TakeError> {
        let tick_hz = header.device.as_ref().map_or(1, |device| device.tick_hz);
        Ok(Self::new(rows_max(header.codec()?.kind), header.stretch_rows, tick_hz))
    }

    /// Starts at the first stretch of a take whose stretches have at most `rows_max` rows, and `stretch_rows` unless
    /// they state another number.
    pub(crate) fn new(rows_max: u64, stretch_rows: u32, tick_hz: u64) -> Self {
        Self {
            rows_max,
            stretch_rows,
            times: Some(TimelineDecoder::new(tick_hz)),
            next_row: 0,
            next_number: Some(0),
            broken: true,
        }
    }

    /// Leaves the times of all rows undecoded.
    pub(crate) fn skip_times(&mut self) {
        self.times = None;
    }

    /// Continues at a key stretch that begins at `row`.
    pub(crate) fn seek(&mut self, row: u64) {
        self.broken = true;
        self.next_row = row;
        self.next_number = None;
    }

    /// Reports a region that may have contained a stretch.
    pub(crate) fn break_off(&mut self) {
        self.broken = true;
    }

    /// The most rows that the take can have up to the next stretch, or to its end.
    ///
    /// Lost rows are read as gaps, one by one. A number that no loss explains must not create more of them than fit on
    /// a disk.
    pub(crate) fn plausible_rows_max(&self) -> u64 {
        self.next_row.saturating_add(ROWS_PASSED_MAX)
    }

    /// Parses the payload of the next STRETCH chunk. The error is a message.
    pub(crate) fn place<'a>(&mut self, payload: &'a [u8]) -> Result<Placement<'a>, &'static str> {
        // An error below leaves the stretch as good as missing.
        let was_broken = std::mem::replace(&mut self.broken, true);
        let mut cursor = varint::Cursor::new(payload);
        let header = StretchHeader::take(&mut cursor, self.rows_max, self.stretch_rows)?;
        let StretchHeader { key, number, n_rows, rows_passed, shared, mut sizes, .. } = header;
        let blocks = take_blocks(&mut cursor, header.alone, n_rows, &mut sizes)?;
        let mut missing_before = self.next_number.is_some_and(|next| next != number);
        let from_row = match header.from_row {
            Some(row) => {
                if row > self.plausible_rows_max() {
                    return Err("its row is further ahead than any loss can explain");
                }
                // As many stretches as there are numbers may be missing, or more.
                missing_before |= !was_broken && row > self.next_row;
                // A stretch of a recovered take accounts for the rows before it.
                missing_before &= row > self.next_row || !header.replaces_damaged();
                row
            }
            None if was_broken || missing_before => {
                self.next_number = Some((number + 1) % NUMBERS);
                self.next_row = self.next_row.saturating_add(rows_passed);
                return Ok(Placement::Unplaced { missing_before, n_rows, rows_min: self.next_row });
            }
            None => self.next_row,
        };
        let end_row = from_row.checked_add(rows_passed).ok_or("its row numbers overflow")?;
        let timeline = |runs| Timeline { first_row: from_row, runs, times: Vec::new() };
        let mut timeline = header.runs.map(timeline);
        if let (Some(timeline), Some(times)) = (&mut timeline, &mut self.times) {
            times.decode(timeline, key, header.times).ok_or("its times are invalid")?;
        }
        self.next_row = end_row;
        self.next_number = Some((number + 1) % NUMBERS);
        self.broken = false;
        let span = Span { first_row: end_row - u64::from(n_rows), n_rows, key, number };
        Ok(Placement::Stretch(Stretch {
            span,
            missing_before,
            timeline,
            shared,
            blocks,
            sizes,
            payload,
        }))
    }
}

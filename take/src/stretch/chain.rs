//! Continuity from stretch to stretch: the first row of each, and the state of the clocks before it.

use super::{
    NUMBERS, ROWS_PASSED_MAX, Span, Stretch, header::StretchHeader, rows_max, take_blocks,
};
use crate::{
    TakeError,
    record::Header,
    timeline::{Timeline, TimelineDecoder},
    varint,
};

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

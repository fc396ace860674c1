//! The time line: the exposure and arrival of each row, or the cause of its loss; and its coding
//! (docs/take-format.md, "The time line").

mod predict;

#[cfg(test)]
mod tests;

use mocapd_codec::range::{BinaryCoder, RangeDecoder, RangeEncoder};

pub(crate) use self::predict::ResidualModel;
use self::predict::{ArrivalModel, FramePeriod, SHIFT_MAX, TickPredictor, TimecodeModel};
use crate::varint;

/// Causes of lost rows; a set, because a run of lost rows can have several.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LossCauses(pub u8);

impl LossCauses {
    /// Never arrived: lost on the link or dropped by the device; the ledger has the counts of each.
    pub const NOT_RECEIVED: Self = Self(1);
    /// Arrived while a ring buffer was full.
    pub const RING_FULL: Self = Self(2);
    /// The device was disconnected.
    pub const DISCONNECTED: Self = Self(4);
    /// Recorded, but damaged in the file that this take was recovered from.
    pub const DAMAGED: Self = Self(8);
    /// Dropped by the device, by its numbers of batches. Of samples only: 16 is reserved.
    pub const DROPPED_BY_DEVICE: Self = Self(32);

    /// Whether all causes in `other` are among these.
    #[must_use]
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// All causes of both sets.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// Consecutive rows with the same outcome.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RowRun {
    /// Number of rows.
    pub rows: u64,
    /// The causes of the loss; `None` for recorded rows.
    pub lost: Option<LossCauses>,
}

/// The times of one recorded row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RowTime {
    /// Device time at exposure, in ticks.
    pub device_ticks: u64,
    /// Host monotonic time of arrival, in units of 10 microseconds. A take stores it to within half a quantisation
    /// step: 80 to 320 microseconds.
    pub arrival_10us: u64,
    /// Timecode: hours, minutes, seconds, frames.
    pub timecode: Option<[u8; 4]>,
}

/// The time line of the rows from the end of one stretch to the end of the next.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Timeline {
    /// First row, recorded or lost.
    pub first_row: u64,
    /// Runs of recorded and lost rows, in order.
    pub runs: Vec<RowRun>,
    /// The times of the recorded rows.
    pub times: Vec<RowTime>,
}

impl Timeline {
    /// Clears the time line for reuse.
    pub fn restart(&mut self, first_row: u64) {
        self.first_row = first_row;
        self.runs.clear();
        self.times.clear();
    }

    /// Adds one recorded row.
    pub fn push(&mut self, time: RowTime) {
        self.extend_run(1, None);
        self.times.push(time);
    }

    /// Adds lost rows.
    pub fn push_lost(&mut self, rows: u64, causes: LossCauses) {
        self.extend_run(rows, Some(causes));
    }

    /// Adds a run of rows that were damaged before a recovery; none if only stretch numbers are missing.
    pub(crate) fn push_damaged(&mut self, rows: u64) {
        if rows > 0 {
            self.runs.push(RowRun { rows, lost: Some(LossCauses::DAMAGED) });
        }
    }

    /// Number of rows.
    #[must_use]
    pub fn n_rows(&self) -> u64 {
        self.runs.iter().fold(0, |sum, run| sum.saturating_add(run.rows))
    }

    /// Number of recorded rows.
    #[must_use]
    pub fn n_recorded(&self) -> u64 {
        let recorded = self.runs.iter().filter(|run| run.lost.is_none());
        recorded.fold(0, |sum, run| sum.saturating_add(run.rows))
    }

    /// Numbers and times of the recorded rows.
    pub fn recorded(&self) -> impl Iterator<Item = (u64, RowTime)> + Clone + '_ {
        let mut at = self.first_row;
        let rows = self.runs.iter().flat_map(move |run| {
            let first = at;
            at = at.saturating_add(run.rows);
            first..if run.lost.is_none() { at } else { first }
        });
        rows.zip(self.times.iter().copied())
    }

    /// The time line of the rows `rows` only.
    pub(crate) fn part(&self, rows: std::ops::Range<u64>) -> Self {
        let mut part = Self { first_row: self.first_row.max(rows.start), ..Self::default() };
        let mut at = self.first_row;
        for run in &self.runs {
            let end = at.saturating_add(run.rows);
            let inside = end.min(rows.end).saturating_sub(at.max(rows.start));
            if inside > 0 {
                part.runs.push(RowRun { rows: inside, lost: run.lost });
            }
            at = end;
        }
        let inside = self.recorded().filter(|(row, _)| rows.contains(row));
        part.times.extend(inside.map(|(_, time)| time));
        part
    }

    fn extend_run(&mut self, rows: u64, lost: Option<LossCauses>) {
        match self.runs.last_mut() {
            Some(last) if last.lost == lost => last.rows += rows,
            _ if rows > 0 => self.runs.push(RowRun { rows, lost }),
            _ => {}
        }
    }
}

/// State that continues from row to row and across stretches, up to the next key stretch.
#[derive(Debug)]
struct TimelineState {
    last_row: u64,
    pace: TickPredictor,
    line: ArrivalModel,
    errors: ResidualModel,
    timecodes: TimecodeModel,
}

/// The clock state that a key stretch states for its first recorded row.
#[derive(Debug, Clone, Copy)]
struct TimelineAnchor {
    shift: u8,
    period: FramePeriod,
    ticks: u64,
    arrival_10us: u64,
}

impl TimelineState {
    /// The state before any row: everything is coded as a difference from zero.
    fn initial(tick_hz: u64) -> Self {
        Self {
            last_row: 0,
            pace: TickPredictor::stopped(),
            line: ArrivalModel::new(tick_hz, 0, 0, 0),
            errors: ResidualModel::new(4),
            timecodes: TimecodeModel::new(),
        }
    }

    fn at(anchor: &TimelineAnchor, row: u64, tick_hz: u64) -> Option<Self> {
        if anchor.shift > SHIFT_MAX {
            return None;
        }
        Some(Self {
            last_row: row,
            pace: TickPredictor::new(anchor.period, anchor.ticks)?,
            line: ArrivalModel::new(tick_hz, anchor.shift, anchor.ticks, anchor.arrival_10us),
            ..Self::initial(tick_hz)
        })
    }

    /// Encodes the time of `row` and returns it as a decoder will reconstruct it; with a decoder, returns the decoded
    /// time.
    fn row(&mut self, coder: &mut impl BinaryCoder, row: u64, time: RowTime) -> RowTime {
        let rows = row.wrapping_sub(std::mem::replace(&mut self.last_row, row));
        let predicted = self.pace.predict(rows);
        let error = time.device_ticks.wrapping_sub(predicted).cast_signed();
        let error = self.errors.code(coder, error);
        self.pace.correct(error);
        let device_ticks = predicted.wrapping_add_signed(error);
        let arrival_10us = self.line.code(coder, rows, device_ticks, time.arrival_10us);
        RowTime { device_ticks, arrival_10us, timecode: self.timecodes.code(coder, time.timecode) }
    }

    /// Codes all rows of a stretch. The anchor gives the times of the first row of a key stretch.
    fn rows(
        &mut self,
        coder: &mut impl BinaryCoder,
        anchored: bool,
        rows: impl Iterator<Item = (u64, RowTime)>,
        mut emit: impl FnMut(RowTime),
    ) {
        for (i, (row, time)) in rows.enumerate() {
            emit(if anchored && i == 0 {
                RowTime { timecode: self.timecodes.code(coder, time.timecode), ..time }
            } else {
                self.row(coder, row, time)
            });
        }
    }
}

impl TimelineAnchor {
    fn put(&self, out: &mut Vec<u8>) {
        out.push(self.shift);
        varint::put(out, self.period.rows);
        varint::put(out, self.period.ticks);
        varint::put(out, self.ticks);
        varint::put(out, self.arrival_10us);
    }

    fn take(cursor: &mut varint::Cursor<'_>) -> Option<Self> {
        let shift = cursor.byte()?;
        let (rows, period_ticks) = (cursor.varint()?, cursor.varint()?);
        let (ticks, arrival_10us) = (cursor.varint()?, cursor.varint()?);
        Some(Self { shift, period: FramePeriod { ticks: period_ticks, rows }, ticks, arrival_10us })
    }
}

/// Splits what [`TimelineEncoder::encode`] wrote off the front of `cursor`.
pub(crate) fn take_times<'a>(cursor: &mut varint::Cursor<'a>, key: bool) -> Option<&'a [u8]> {
    let all = cursor.rest();
    if key {
        TimelineAnchor::take(cursor)?;
    }
    cursor.prefixed()?;
    all.get(..all.len() - cursor.rest().len())
}

/// Quantisation steps of arrivals that the encoder can use, as powers of two of 10 us: 160, 320 and 640 us. It takes
/// the longest that does not exceed a sixteenth of the frame period: batched and delayed frames still show, and the
/// jitter of a serial or USB line exceeds half a step anyway.
const SHIFTS: [u8; 3] = [6, 5, 4];

/// Encodes the time lines of a take's stretches, in order.
#[derive(Debug)]
pub struct TimelineEncoder {
    tick_hz: u64,
    nominal: FramePeriod,
    /// The quantisation step of arrivals.
    shift: u8,
    state: TimelineState,
    /// First and last recorded row since the last key stretch, with their ticks.
    measured: Option<((u64, u64), (u64, u64))>,
    coded: Vec<u8>,
}

impl TimelineEncoder {
    /// An encoder for a device with `tick_hz` ticks (0 counts as 1) and `rate_hz` rows per second.
    #[must_use]
    pub fn new(tick_hz: u64, rate_hz: f64) -> Self {
        let longest = |shift: &u8| (1 << shift) as f64 * rate_hz * 16.0 <= 100_000.0;
        Self {
            tick_hz,
            nominal: FramePeriod::from_rate(tick_hz, rate_hz),
            shift: SHIFTS.into_iter().find(longest).unwrap_or(SHIFTS[2]),
            state: TimelineState::initial(tick_hz),
            measured: None,
            coded: Vec::new(),
        }
    }

    /// An encoder that keeps arrivals to 10 us, the unit of [`RowTime::arrival_10us`]: for times that were decoded
    /// before, which it does not round again.
    pub(crate) fn exact(tick_hz: u64, rate_hz: f64) -> Self {
        Self { shift: 0, ..Self::new(tick_hz, rate_hz) }
    }

    /// Reserves memory for stretches of `n_rows` recorded rows, so that encoding does not allocate. Clocks and arrivals
    /// take fewer than 16 bytes per row unless they are noise with an amplitude of hours.
    pub fn reserve(&mut self, n_rows: usize) {
        self.coded.reserve(n_rows.saturating_mul(16));
    }

    /// Appends the anchor of a key stretch, the length of the coded times, and the coded times; nothing without a
    /// recorded row.
    pub(crate) fn encode(&mut self, timeline: &Timeline, key: bool, out: &mut Vec<u8>) {
        if key {
            self.state = TimelineState::initial(self.tick_hz);
        }
        let Some((row, time)) = timeline.recorded().next() else { return };
        if key {
            let (shift, period) = (self.shift, self.period(timeline));
            let RowTime { device_ticks: ticks, arrival_10us, .. } = time;
            let anchor = TimelineAnchor { shift, period, ticks, arrival_10us };
            self.measured = None;
            if let Some(state) = TimelineState::at(&anchor, row, self.tick_hz) {
                self.state = state;
            }
            anchor.put(out);
        }
        self.coded.clear();
        let mut coder = RangeEncoder::new(&mut self.coded, usize::MAX);
        self.state.rows(&mut coder, key, timeline.recorded(), |_| {});
        // The encoder has no limit to exceed.
        let _fits = coder.finish();
        varint::put_prefixed(out, &self.coded);
        let first = self.measured.map_or((row, time.device_ticks), |measured| measured.0);
        let last = timeline.recorded().last().map(|(row, time)| (row, time.device_ticks));
        self.measured = last.map(|last| (first, last));
    }

    /// Chooses among the nominal period, the period measured since the last key stretch, and that of this stretch: the
    /// one that mispredicts the fewest rows.
    fn period(&self, timeline: &Timeline) -> FramePeriod {
        let ends = timeline.recorded().next().zip(timeline.recorded().last());
        let here = ends.and_then(|(first, last)| {
            FramePeriod::between((first.0, first.1.device_ticks), (last.0, last.1.device_ticks))
        });
        let before = self.measured.and_then(|(first, last)| FramePeriod::between(first, last));
        let wrong = |period: &FramePeriod| {
            let mut rows = timeline.recorded();
            let (Some(first), mut n_wrong) = (rows.next(), 0) else { return 0 };
            let Some(mut pace) = TickPredictor::new(*period, first.1.device_ticks) else {
                return usize::MAX;
            };
            let mut last_row = first.0;
            for (row, time) in rows {
                let predicted = pace.predict(row - std::mem::replace(&mut last_row, row));
                let error = time.device_ticks.wrapping_sub(predicted).cast_signed();
                n_wrong += usize::from(error != 0);
                pace.correct(error);
            }
            n_wrong
        };
        // The first of equals.
        let candidates = [Some(self.nominal), before, here];
        candidates.into_iter().flatten().min_by_key(wrong).unwrap_or(self.nominal)
    }
}

/// Decodes the time lines of a take's stretches, in order.
#[derive(Debug)]
pub(crate) struct TimelineDecoder {
    tick_hz: u64,
    state: TimelineState,
}

impl TimelineDecoder {
    pub(crate) fn new(tick_hz: u64) -> Self {
        Self { tick_hz, state: TimelineState::initial(tick_hz) }
    }

    /// Decodes the times of `timeline`, whose runs are known. Unless `key`, the previous stretch must have been
    /// decoded. `None` for invalid bytes.
    pub(crate) fn decode(
        &mut self,
        timeline: &mut Timeline,
        key: bool,
        times: &[u8],
    ) -> Option<()> {
        if key {
            self.state = TimelineState::initial(self.tick_hz);
        }
        let n = timeline.n_recorded();
        if n == 0 {
            return times.is_empty().then_some(());
        }
        let mut cursor = varint::Cursor::new(times);
        timeline.times.resize(usize::try_from(n).ok()?, RowTime::default());
        if key {
            let anchor = TimelineAnchor::take(&mut cursor)?;
            let first_row = timeline.recorded().next().map_or(timeline.first_row, |(row, _)| row);
            self.state = TimelineState::at(&anchor, first_row, self.tick_hz)?;
            timeline.times[0].device_ticks = anchor.ticks;
            timeline.times[0].arrival_10us = anchor.arrival_10us;
        }
        let mut coder = RangeDecoder::new(cursor.prefixed()?);
        let mut decoded = Vec::with_capacity(timeline.times.len());
        self.state.rows(&mut coder, key, timeline.recorded(), |time| decoded.push(time));
        timeline.times = decoded;
        (coder.finish().is_ok() && cursor.is_empty()).then_some(())
    }
}

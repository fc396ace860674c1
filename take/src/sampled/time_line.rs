//! The time line of a recording: which place among its rows each sample has.
//!
//! A sample has the device's time that `SAMPLE_TIMES` gives it, and a place among the rows by [`RowClock`].
//! Exports place row r at r / rate, whatever rate the device kept. A sample is therefore placed between the rows that were
//! taken around it, and not by the tick frequency: a sample that was taken with row r has the time of row r.

use std::{
    io::{Read, Seek},
    ops::Range,
};

use super::{GroupSamples, SampleAnchor, SampleClock, SampleRun, SampleTime};
use crate::{TakeError, TakeMap, TakeTraversal, record::SampledGroup, traversal::Decode};

/// The longest time by which a batch is stamped late, in seconds: a device sends one within a tenth of that.
const LATE_S: f64 = 1.0;

/// Seconds by which the device's clock goes back at least where it began again: batches may be stamped late by less.
const BACK_S: f64 = 0.1;

/// Where the samples of a group are on the time line.
#[derive(Debug, Clone)]
struct GroupPlaces {
    /// The stated times, without those that were stamped so late that the next ones would be before them.
    anchors: Vec<SampleAnchor>,
    /// By run of samples, in ascending order of their starts: the rows' epoch that it belongs to.
    epochs: Vec<(u64, Option<usize>)>,
}

/// The times of a group's anchors that ascend: one that is later than the rate allows before the next one of its run was
/// stamped late, with a batch that waited.
fn ascending(samples: &GroupSamples, tick_hz: u64) -> Vec<SampleAnchor> {
    let nominal = tick_hz as f64 / samples.group.rate_hz;
    let mut kept: Vec<SampleAnchor> = Vec::with_capacity(samples.anchors().len());
    for anchor in samples.anchors() {
        let is_late = |last: &SampleAnchor| {
            let ticks = anchor.device_ticks.wrapping_sub(last.device_ticks).cast_signed() as f64;
            last.run_start == anchor.run_start
                && last.number > last.run_start
                && (anchor.number - last.number) as f64 <= LATE_S * samples.group.rate_hz
                && ticks < 0.5 * nominal * (anchor.number - last.number) as f64
        };
        while kept.pop_if(|last| is_late(last)).is_some() {}
        kept.push(*anchor);
    }
    kept
}

/// The epochs of a group's runs.
pub(crate) fn epochs_of(
    samples: &GroupSamples,
    clock: &RowClock,
    tick_hz: u64,
) -> Vec<(u64, Option<usize>)> {
    let mut found: Vec<(u64, Option<usize>)> = Vec::new();
    let mut from = 0;
    let mut before: Option<u64> = None;
    let mut runs = samples.anchors().chunk_by(|a, b| a.run_start == b.run_start).peekable();
    while let Some(run) = runs.next() {
        let (Some(first), Some(last)) = (run.first(), run.last()) else { continue };
        let end = runs.peek().and_then(|next| next.first()).map_or(u64::MAX, |next| next.run_start);
        // A run behind which the clock went back has rows of a later epoch.
        let back_s = |before: u64| {
            before.wrapping_sub(first.device_ticks).cast_signed() as f64 / tick_hz as f64
        };
        from += usize::from(before.is_some_and(|before| back_s(before) > BACK_S));
        let offsets = samples.offsets_of(first.run_start..end);
        let epoch = clock.epoch_of((first.device_ticks, last.device_ticks), offsets, from);
        from = epoch.unwrap_or(from);
        before = Some(last.device_ticks);
        found.push((first.run_start, epoch));
    }
    found
}

/// The sampled channels of a recording, and where their samples are among its rows.
#[derive(Debug, Clone)]
pub struct SampleTimeLine {
    groups: Vec<GroupSamples>,
    places: Vec<GroupPlaces>,
    clock: RowClock,
    tick_hz: u64,
    rate_hz: f64,
}

impl SampleTimeLine {
    /// Reads the times of a take's rows; no samples are decoded.
    ///
    /// # Errors
    /// Those of [`RowClock::read`].
    pub fn read(input: impl Read + Seek, map: &TakeMap) -> Result<Self, TakeError> {
        Self::read_groups(input, map, |_| true)
    }

    /// The same for those groups only that `is_wanted` wants.
    ///
    /// # Errors
    /// Those of [`RowClock::read`].
    pub fn read_groups(
        input: impl Read + Seek,
        map: &TakeMap,
        is_wanted: impl Fn(&SampledGroup) -> bool,
    ) -> Result<Self, TakeError> {
        let groups = map.recorded_groups().filter(|samples| is_wanted(&samples.group));
        let groups: Vec<GroupSamples> = groups.cloned().collect();
        let has_groups = !groups.is_empty();
        let clock = if has_groups { RowClock::read(input, map)? } else { RowClock::default() };
        let tick_hz = map.header.device.as_ref().map_or(1, |device| device.tick_hz.max(1));
        let places = groups.iter().map(|samples| GroupPlaces {
            anchors: ascending(samples, tick_hz),
            epochs: epochs_of(samples, &clock, tick_hz),
        });
        Ok(Self { places: places.collect(), groups, clock, tick_hz, rate_hz: map.header.rate_hz })
    }

    /// The groups, in order of their numbers.
    #[must_use]
    pub fn groups(&self) -> &[GroupSamples] {
        &self.groups
    }

    /// The clock of a group; `None` beyond the last one.
    #[must_use]
    pub fn clock(&self, group: usize) -> Option<RecordingClock<'_>> {
        let places = self.places.get(group)?;
        let samples = self.groups.get(group)?.clock_by(&places.anchors, self.tick_hz);
        Some(RecordingClock { samples, rows: &self.clock, epochs: &places.epochs, own_rows: None })
    }

    /// Entries that it holds in memory: times of rows and samples, and blocks.
    #[must_use]
    pub fn n_entries(&self) -> usize {
        let of_group = |group: &GroupSamples| 2 * group.anchors().len() + group.n_chunks();
        self.clock.n_knots() + self.groups.iter().map(of_group).sum::<usize>()
    }

    /// An index of a group's samples by their places; `None` beyond the last group.
    #[must_use]
    pub fn index(&self, group: usize) -> Option<PlaceIndex> {
        let (samples, places) = (self.groups.get(group)?, self.places.get(group)?);
        let slack = TICK_SAMPLES * self.rate_hz / samples.group.rate_hz;
        Some(PlaceIndex::new(samples, &places.anchors, self.clock(group)?, slack))
    }
}

/// Samples of a group that follow each other, as their rows do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct RowPiece {
    pub(crate) numbers: Range<u64>,
    /// The row of the first of them.
    pub(crate) first_row: u64,
    /// Whether a recorded row has the time of an anchor; else the row is the nearest one to it.
    pub(crate) is_exact: bool,
}

impl RowPiece {
    /// The row after the last one.
    pub(crate) fn end_row(&self) -> u64 {
        self.first_row + (self.numbers.end - self.numbers.start)
    }

    /// Leaves out the rows before this one.
    pub(crate) fn begin_at(&mut self, row: u64) {
        let by = row.saturating_sub(self.first_row).min(self.numbers.end - self.numbers.start);
        self.numbers.start += by;
        self.first_row += by;
    }

    /// Leaves out this row and those after it.
    pub(crate) fn end_before(&mut self, row: u64) {
        let n = row.saturating_sub(self.first_row).min(self.numbers.end - self.numbers.start);
        self.numbers.end = self.numbers.start + n;
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.numbers.is_empty()
    }
}

/// The times of a group's samples on the time line of the rows.
#[derive(Debug, Clone, Copy)]
pub struct RecordingClock<'a> {
    samples: SampleClock<'a>,
    rows: &'a RowClock,
    epochs: &'a [(u64, Option<usize>)],
    /// Of a group with a sample in each row: the rows of its samples, in ascending order.
    own_rows: Option<&'a [RowPiece]>,
}

impl<'a> RecordingClock<'a> {
    /// The same for a group with a sample in each row.
    pub(super) fn with_rows(self, own_rows: &'a [RowPiece]) -> Self {
        Self { own_rows: Some(own_rows), ..self }
    }

    /// The place of a sample among the rows.
    #[must_use]
    pub fn position(&self, number: u64) -> Option<f64> {
        if let Some(pieces) = self.own_rows {
            let at = pieces.partition_point(|piece| piece.numbers.end <= number);
            let piece = pieces.get(at).filter(|piece| piece.numbers.contains(&number))?;
            return Some((piece.first_row + (number - piece.numbers.start)) as f64);
        }
        let time = self.samples.at(number)?;
        let run =
            self.epochs.partition_point(|(start, _)| *start <= time.run_start).checked_sub(1)?;
        let (_, epoch) = self.epochs.get(run)?;
        self.rows.position((*epoch)?, &time)
    }

    /// The time of a sample by the device's clock.
    #[must_use]
    pub fn device_time(&self, number: u64) -> Option<SampleTime> {
        self.samples.at(number)
    }
}

/// Samples of a group one after another, which are all stored or all lost.
#[derive(Debug, Clone, Copy)]
struct Piece {
    first: u64,
    /// The largest place of the samples before it.
    before: f64,
    is_lost: bool,
}

/// An index of a group's samples by their places among the rows: readers of a few rows look at the samples of these only.
#[derive(Debug, Clone)]
pub struct PlaceIndex {
    /// In ascending order, from one stated time or block to the next: there, places lie on lines.
    pieces: Vec<Piece>,
    /// One past the last sample, and the largest place of all.
    end: (u64, f64),
    /// The rows by which the time of a sample may miss that of a row that it was taken with.
    slack: f64,
}

/// Samples by which a stated time may miss that of a sample: it is stated to a tick.
const TICK_SAMPLES: f64 = 0.05;

impl PlaceIndex {
    fn new(
        samples: &GroupSamples,
        anchors: &[SampleAnchor],
        clock: RecordingClock<'_>,
        slack: f64,
    ) -> Self {
        let stored = samples.stored_range();
        let (mut pieces, mut before) = (Vec::new(), f64::NEG_INFINITY);
        let mut add = |numbers: Range<u64>, is_lost: bool| {
            pieces.push(Piece { first: numbers.start, before, is_lost });
            let place = |number: u64| clock.position(number);
            let (mut last, mut end) = (numbers.start, numbers.end);
            // Where frames stop within it, the last sample that has a place.
            while place(numbers.end - 1).is_none() && end - last > 1 {
                let middle = last + (end - last) / 2;
                if place(middle).is_some() { last = middle } else { end = middle }
            }
            let ends = [numbers.start, last, numbers.end - 1].map(place);
            before = ends.into_iter().flatten().fold(before, f64::max);
        };
        let found = samples.runs(|run| {
            let (numbers, is_lost) = match run {
                SampleRun::Block(chunk) => (chunk.span.first..chunk.span.end(), false),
                SampleRun::Lost { first, n, .. } => (first..first.saturating_add(n), true),
            };
            let mut start = numbers.start.max(stored.start);
            let end = numbers.end.min(stored.end);
            let from = anchors.partition_point(|anchor| anchor.number <= start);
            let inside = anchors.get(from..).unwrap_or_default().iter();
            let bounds = inside.map(|anchor| anchor.number).take_while(|&number| number < end);
            for next in bounds.chain([end]) {
                if start < next {
                    add(start..next, is_lost);
                    start = next;
                }
            }
            Ok::<(), std::convert::Infallible>(())
        });
        let Ok(()) = found;
        Self { pieces, end: (stored.end, before), slack }
    }

    /// Entries that it holds in memory.
    #[must_use]
    pub fn n_entries(&self) -> usize {
        self.pieces.len()
    }

    /// The stored samples that were taken in these rows: `each` receives the number of each and the row with or after which
    /// it was taken, in ascending order, and says whether to go on. Returns whether samples are lost there. Samples
    /// without a place are absent, as in exports.
    pub fn in_rows(
        &self,
        clock: RecordingClock<'_>,
        rows: &Range<u64>,
        mut each: impl FnMut(u64, Option<u64>) -> bool,
    ) -> bool {
        let (from, to) = (rows.start as f64 - self.slack, rows.end as f64 - self.slack);
        let reached = self.pieces.partition_point(|piece| piece.before < from);
        let mut has_lost = false;
        for at in reached.saturating_sub(1)..self.pieces.len() {
            let Some(piece) = self.pieces.get(at).filter(|piece| piece.before < to) else { break };
            let end = self.pieces.get(at + 1).map_or(self.end.0, |next| next.first);
            let mut last = piece.before;
            if piece.is_lost {
                // Of a long loss only the ends are looked at.
                let ends = [piece.first, end - 1].map(|number| clock.position(number));
                let [first, last] = ends.map(|at| at.filter(|at| at.is_finite()));
                has_lost |= first.is_none_or(|at| at < to) && last.is_none_or(|at| at >= from);
                continue;
            }
            for number in piece.first..end {
                let place = clock.position(number).filter(|&place| place > last);
                last = place.unwrap_or(last);
                let inside = place.filter(|place| (from..to).contains(place));
                let row = inside.map(|place| {
                    let row = (place + self.slack).floor() as u64;
                    row.clamp(rows.start, rows.end.saturating_sub(1).max(rows.start))
                });
                if !each(number, row) {
                    return has_lost;
                }
            }
        }
        has_lost
    }
}

/// Distance of a row from the line through those before it, in rows, from which on it is a knot of its own: an eighth of a
/// frame is less than a sample of most groups.
const OFF_LINE: f64 = 0.125;

/// Most knots, in half a GiB: days of a clock that is even. Of rows beyond them only the first of each stretch is kept.
const KNOTS_MAX: usize = 1 << 25;

/// Most times that a clock begins again: devices are switched off a few times. A few bytes can claim that it does at every
/// row; rows behind the last one of these have no place for samples.
const EPOCHS_MAX: usize = 1 << 12;

/// Steps from row to row of which the median is the period of a clock.
const STEPS_MAX: usize = 1 << 12;

/// A recorded row and its time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Knot {
    row: u64,
    ticks: u64,
}

/// Rows during which the device's clock did not go back.
#[derive(Debug, Clone, PartialEq, Default)]
struct Epoch {
    /// In ascending order of rows and ticks; at least one.
    knots: Vec<Knot>,
    /// Ticks from a row to the next one: the median of the first ones.
    period: f64,
    /// File offset before its first stretch.
    offset: u64,
}

/// The times of a recording's rows by the device's clock.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RowClock {
    epochs: Vec<Epoch>,
}

/// Builds an epoch from its rows.
struct EpochBuilder {
    epoch: Epoch,
    last: Knot,
    /// Ticks in a row between the last two knots.
    slope: f64,
    steps: Vec<f64>,
    n_before: usize,
}

impl EpochBuilder {
    fn new(first: Knot, offset: u64, nominal: f64, n_before: usize) -> Self {
        let epoch = Epoch { knots: vec![first], period: nominal, offset };
        Self { epoch, last: first, slope: nominal, steps: Vec::new(), n_before }
    }

    /// Adds the next row; `is_first`: of a stretch.
    fn push(&mut self, next: Knot, is_first: bool) {
        let (rows, ticks) = (next.row - self.last.row, next.ticks.wrapping_sub(self.last.ticks));
        if self.steps.len() < STEPS_MAX {
            self.steps.push(ticks as f64 / rows as f64);
        }
        let Some(knot) = self.epoch.knots.last().copied() else { return };
        let due = (next.row - knot.row) as f64 * self.slope;
        let off = next.ticks.wrapping_sub(knot.ticks) as f64 - due;
        let is_off =
            off.abs() > OFF_LINE * self.slope && self.n_before + self.epoch.knots.len() < KNOTS_MAX;
        if is_off && self.last.row > knot.row {
            self.keep(self.last);
        }
        if is_off || is_first {
            self.keep(next);
        }
        self.last = next;
    }

    fn keep(&mut self, next: Knot) {
        if let Some(knot) = self.epoch.knots.last().filter(|knot| knot.row < next.row) {
            self.slope = next.ticks.wrapping_sub(knot.ticks) as f64 / (next.row - knot.row) as f64;
            self.epoch.knots.push(next);
        }
    }

    fn finish(mut self) -> Epoch {
        self.keep(self.last);
        self.steps.sort_by(f64::total_cmp);
        if let Some(&median) = self.steps.get(self.steps.len() / 2) {
            self.epoch.period = median;
        }
        self.epoch
    }
}

impl RowClock {
    /// Reads the times of all rows of a take.
    ///
    /// # Errors
    /// Those of [`TakeTraversal::next_stretch`].
    pub fn read(input: impl Read + Seek, map: &TakeMap) -> Result<Self, TakeError> {
        Self::read_each(input, map, |_, _, _| {})
    }

    /// The same; `each` receives every recorded row: its epoch, its number and its ticks.
    pub(crate) fn read_each(
        input: impl Read + Seek,
        map: &TakeMap,
        mut each: impl FnMut(usize, u64, u64),
    ) -> Result<Self, TakeError> {
        let tick_hz = map.header.device.as_ref().map_or(1, |device| device.tick_hz.max(1)) as f64;
        let nominal = tick_hz / map.header.rate_hz;
        let (mut epochs, mut open): (Vec<Epoch>, Option<EpochBuilder>) = (Vec::new(), None);
        let mut stretches = TakeTraversal::from_map(input, map, Decode::Groups(Vec::new()))?;
        let (mut offset, mut n_knots) = (0, 0);
        while stretches.next_stretch()?.is_some() {
            let mut is_first = true;
            for (row, time) in stretches.timeline().iter().flat_map(|timeline| timeline.recorded())
            {
                let next = Knot { row, ticks: time.device_ticks };
                let ascends = |of: &EpochBuilder| {
                    next.row > of.last.row
                        && next.ticks.wrapping_sub(of.last.ticks).cast_signed() > 0
                };
                match open.as_mut().filter(|of| ascends(of)) {
                    Some(of) => of.push(next, is_first),
                    None if epochs.len() + 1 >= EPOCHS_MAX => continue,
                    None => {
                        let ended = open.take().map(EpochBuilder::finish);
                        n_knots += ended.as_ref().map_or(0, |epoch| epoch.knots.len());
                        epochs.extend(ended);
                        open = Some(EpochBuilder::new(next, offset, nominal, n_knots));
                    }
                }
                each(epochs.len(), row, time.device_ticks);
                is_first = false;
            }
            offset = stretches.bytes_read() + crate::chunk::MAGIC.len() as u64;
        }
        epochs.extend(open.map(EpochBuilder::finish));
        Ok(Self { epochs })
    }

    /// Whether a row next to an end of an epoch has the same time: the clock stood there.
    pub(crate) fn stands_at(&self, epoch: usize, ticks: u64) -> bool {
        let first = |epoch: usize| Some(self.epochs.get(epoch)?.knots.first()?.ticks);
        let last = |epoch: usize| Some(self.epochs.get(epoch)?.knots.last()?.ticks);
        let (here, before) = ([first(epoch), last(epoch)], epoch.checked_sub(1).and_then(last));
        let ends = here.into_iter().zip([before, first(epoch + 1)]);
        ends.into_iter().any(|ends| ends == (Some(ticks), Some(ticks)))
    }

    /// Times of rows that it holds in memory.
    pub(super) fn n_knots(&self) -> usize {
        self.epochs.iter().map(|epoch| epoch.knots.len()).sum()
    }

    /// The epoch that samples belong to which are taken one after another, from the first to the last of these times, in the
    /// chunks at `offsets`; not before the epoch `from`.
    ///
    /// The clock of samples and rows is the same, and a recorder writes blocks behind the stretches during which their
    /// samples came, or soon after. So the epoch is the one behind whose stretches most of the blocks lie, and in whose time
    /// most of the samples.
    pub(super) fn epoch_of(
        &self,
        (first, last): (u64, u64),
        offsets: impl Iterator<Item = u64>,
        from: usize,
    ) -> Option<usize> {
        let mut n_behind = vec![0_u64; self.epochs.len()];
        let mut n_all = 0;
        for offset in offsets {
            let behind = self.epochs.partition_point(|epoch| epoch.offset < offset).max(1) - 1;
            if let Some(n) = n_behind.get_mut(behind) {
                *n += 1;
            }
            n_all += 1;
        }
        let score = |index: usize, epoch: &Epoch| {
            let (Some(begin), Some(end)) = (epoch.knots.first(), epoch.knots.last()) else {
                return 0.0;
            };
            let span = last.wrapping_sub(first).cast_signed().max(1) as f64;
            let at = |ticks: u64| ticks.wrapping_sub(first).cast_signed() as f64;
            let both = at(end.ticks).min(span) - at(begin.ticks).max(0.0);
            let behind = n_behind.get(index).map_or(0.0, |&n| n as f64 / n_all.max(1) as f64);
            (both / span).clamp(0.0, 1.0) + behind
        };
        let scored = self.epochs.iter().enumerate().skip(from);
        let scored = scored.map(|(index, epoch)| (index, score(index, epoch)));
        // Of equal ones the first.
        scored
            .reduce(|best, other| if other.1 > best.1 { other } else { best })
            .map(|(index, _)| index)
    }

    /// The place of a time among the rows of an epoch: row 3 was taken at 3.0. Before the first row and after the last one,
    /// time goes on at the epoch's own rate, as far as no other epoch has rows there. `None` beyond that, and where the next
    /// row came later than it was due: the time line of the frames has no place for the time between.
    #[must_use]
    pub(crate) fn position(&self, epoch: usize, time: &SampleTime) -> Option<f64> {
        let of = self.epochs.get(epoch)?;
        let row_of = |knot: Option<&Knot>| knot.map(|knot| knot.row as f64);
        let next = of.knots.partition_point(|knot| time.ticks_since(knot.ticks) >= 0.0);
        let Some(from) = next.checked_sub(1).and_then(|at| of.knots.get(at)) else {
            let first = of.knots.first()?;
            let before = epoch.checked_sub(1).and_then(|before| self.epochs.get(before));
            let last = row_of(before.and_then(|before| before.knots.last()));
            let at = first.row as f64 + time.ticks_since(first.ticks) / of.period;
            return Some(at).filter(|&at| last.is_none_or(|last| at > last));
        };
        let forwards = from.row as f64 + time.ticks_since(from.ticks) / of.period;
        let Some(to) = of.knots.get(next) else {
            let first = row_of(self.epochs.get(epoch + 1).and_then(|after| after.knots.first()));
            return Some(forwards).filter(|&at| first.is_none_or(|first| at < first));
        };
        let (rows, ticks) = ((to.row - from.row) as f64, to.ticks.wrapping_sub(from.ticks) as f64);
        if ticks > (rows + 1.0) * of.period {
            // Half of the rows between follow the earlier one, the others precede the later one.
            let middle = from.row as f64 + 0.5 * rows;
            let backwards = to.row as f64 + time.ticks_since(to.ticks) / of.period;
            let found = if forwards < middle { Some(forwards) } else { Some(backwards) };
            return found.filter(|&at| at == forwards || at >= middle);
        }
        Some(from.row as f64 + time.ticks_since(from.ticks) * (rows / ticks))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn epoch(offset: u64, rows: impl IntoIterator<Item = (u64, u64)>) -> Epoch {
        let mut rows = rows.into_iter().map(|(row, ticks)| Knot { row, ticks });
        let mut builder = EpochBuilder::new(rows.next().unwrap(), offset, 10.0, 0);
        for (i, row) in rows.enumerate() {
            builder.push(row, i % 50 == 49);
        }
        builder.finish()
    }

    fn at(clock: &RowClock, epoch: usize, device_ticks: u64) -> Option<f64> {
        let time = SampleTime { device_ticks, fraction: 0.0, segment: 0, run_start: 0 };
        clock.position(epoch, &time)
    }

    /// Places ascend strictly over these ticks, and those without a place are in the range.
    fn ascends(clock: &RowClock, epoch: usize, ticks: Range<u64>, none: Range<u64>) {
        let mut last = f64::NEG_INFINITY;
        for ticks in ticks {
            match at(clock, epoch, ticks) {
                Some(at) => {
                    assert!(at > last, "{ticks}: {at} after {last}");
                    last = at;
                }
                None => assert!(none.contains(&ticks), "{ticks}"),
            }
        }
    }

    #[test]
    fn a_sample_that_was_taken_with_a_row_has_its_place() {
        // 1 % slow from row 100 on, and every seventh row is 4 ticks late.
        let ticks =
            |row: u64| 5000 + row * 10 + row.saturating_sub(100) / 10 + 4 * u64::from(row % 7 == 3);
        let clock = RowClock { epochs: vec![epoch(0, (0..400).map(|row| (row, ticks(row))))] };
        for row in 0..400 {
            let found = at(&clock, 0, ticks(row)).unwrap();
            assert!((found - row as f64).abs() < OFF_LINE + 0.01, "{row}: {found}");
        }
        ascends(&clock, 0, 4000..10_000, 0..0);
        assert_eq!(at(&clock, 0, 4990), Some(-1.0));
    }

    #[test]
    fn while_no_frames_come_time_stands_still_on_their_time_line() {
        // Three seconds of a thousand ticks pass between rows 199 and 200, whose numbers follow each other.
        let ticks = |row: u64| row * 10 + if row < 200 { 0 } else { 3000 };
        let clock = RowClock { epochs: vec![epoch(0, (0..400).map(|row| (row, ticks(row))))] };
        ascends(&clock, 0, 0..7000, 1995..4995);
        assert_eq!([at(&clock, 0, 1994), at(&clock, 0, 3000)], [Some(199.4), None]);
        assert_eq!([at(&clock, 0, 4995), at(&clock, 0, 5000)], [Some(199.5), Some(200.0)]);
    }

    #[test]
    fn a_camera_that_is_triggered_slower_than_it_says_keeps_its_samples() {
        // Five rows a second of a thousand ticks, where the take states a hundred.
        let clock = RowClock { epochs: vec![epoch(0, (0..50).map(|row| (row, row * 200)))] };
        ascends(&clock, 0, 0..11_000, 0..0);
        assert_eq!(at(&clock, 0, 300), Some(1.5));
    }

    #[test]
    fn a_clock_that_begins_again_has_other_rows() {
        let epochs = vec![
            epoch(0, (0..200).map(|row| (row, 100_000 + row * 10))),
            epoch(5000, (201..400).map(|row| (row, (row - 201) * 10))),
        ];
        let clock = RowClock { epochs };
        // Frames stop, and samples go on: until the rows of the restarted device.
        assert_eq!([at(&clock, 0, 102_005), at(&clock, 0, 102_100)], [Some(200.5), None]);
        assert_eq!(at(&clock, 1, 5), Some(201.5));
        let runs = [
            ((99_990, 103_000), [100_u64, 2000, 5100], 0),
            ((0, 1980), [5100, 6000, 9000], 1),
            // A short one of the old clock, whose block was written late.
            ((101_000, 101_500), [5100, 5100, 5100], 0),
        ];
        for (ticks, offsets, expected) in runs {
            let found = clock.epoch_of(ticks, offsets.into_iter(), 0);
            assert_eq!(found, Some(expected), "{ticks:?}");
        }
        // Both count alike: the place in the file decides.
        let again =
            RowClock { epochs: vec![epoch(0, [(0, 0), (9, 90)]), epoch(500, [(20, 0), (29, 90)])] };
        assert_eq!(again.epoch_of((0, 90), [100, 200].into_iter(), 0), Some(0));
        assert_eq!(again.epoch_of((0, 90), [600, 700].into_iter(), 0), Some(1));
        assert_eq!(again.epoch_of((0, 90), [100].into_iter(), 1), Some(1));
    }
}

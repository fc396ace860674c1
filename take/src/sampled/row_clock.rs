//! The clock of a recording's rows: which place among them a time of the device's clock has.
//!
//! Exports place row r at r / rate, whatever rate the device kept. A sample is therefore placed between the rows that were
//! taken around it, and not by the tick frequency: a sample that was taken with row r has the time of row r.

use std::io::{Read, Seek};

use super::SampleTime;
use crate::{TakeError, TakeMap, TakeTraversal, traversal::Decode};

/// Distance of a row from the line through those before it, in rows, from which on it is a knot of its own: an eighth of a
/// frame is less than a sample of most groups.
const OFF_LINE: f64 = 0.125;

/// Most knots, in half a GiB: days of a clock that is even. Of rows beyond them only the first of each stretch is kept.
const KNOTS_MAX: usize = 1 << 25;

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
    fn ascends(
        clock: &RowClock,
        epoch: usize,
        ticks: std::ops::Range<u64>,
        none: std::ops::Range<u64>,
    ) {
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

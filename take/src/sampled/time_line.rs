//! The time line of a recording: which place among its rows each sample has.
//!
//! A sample has the device's time that `SAMPLE_TIMES` gives it, and a place among the rows by [`RowClock`].

use std::{
    io::{Read, Seek},
    ops::Range,
};

use super::{GroupSamples, RowClock, SampleAnchor, SampleClock, SampleRun, SampleTime};
use crate::{TakeError, TakeMap};

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
        let clock = RowClock::read(input, map)?;
        let tick_hz = map.header.device.as_ref().map_or(1, |device| device.tick_hz.max(1));
        let groups: Vec<GroupSamples> = map.recorded_groups().cloned().collect();
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
        Some(RecordingClock { samples, rows: &self.clock, epochs: &places.epochs })
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

/// The times of a group's samples on the time line of the rows.
#[derive(Debug, Clone, Copy)]
pub struct RecordingClock<'a> {
    samples: SampleClock<'a>,
    rows: &'a RowClock,
    epochs: &'a [(u64, Option<usize>)],
}

impl RecordingClock<'_> {
    /// The place of a sample among the rows.
    #[must_use]
    pub fn position(&self, number: u64) -> Option<f64> {
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

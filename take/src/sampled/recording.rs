//! The sampled channels of a recording on the time line of its frames: the one place that says when a sample was taken.
//!
//! A sample has the device's time that `SAMPLE_TIMES` gives it, and a place among the rows by [`RowClock`]: sample times and
//! frame times agree wherever the device took both at once, whatever its rates are. All exports, the plots and the
//! Python package read recorded samples from here.

use std::{
    fmt,
    io::{self, Read, Seek},
    ops::Range,
    sync::{Arc, Mutex, PoisonError},
};

use super::{
    GroupReader, GroupSamples, RESIDUAL_SCALE, RecordingClock, RowPiece, SampleRun, SampleTimeLine,
};
use crate::{
    TakeError, TakeMap,
    poses::{Pose, PoseBody, PoseTurn, PosesByRow, RowPoses, rows_of},
    record::{RecordedPlate, SampledChannel},
};

/// Samples of a block that are decoded at once are those of a block of the take; lost ones come in blocks of this many.
const LOST_AT_ONCE: u64 = 1 << 16;

/// Most lost samples of a channel, one after another, that outputs have as missing: more than an hour at 1000 Hz. A few
/// bytes of a take can claim years, and a clock that jumps can make a recorder count as many.
const LOST_RUN_MAX: u64 = 1 << 22;

/// Most such samples of a channel in all: those of eight hours at 2000 Hz.
const LOST_MAX: u64 = 1 << 26;

/// The file of a take, for readers that share it.
pub trait ReadSeek: Read + Seek + Send {}

impl<T: Read + Seek + Send> ReadSeek for T {}

/// The index of a group, and a range of rows: the first and one past the last.
type RowsOfGroup = (usize, u64, u64);

/// The numbers of the samples in such rows.
type FoundNumbers = (RowsOfGroup, Arc<[Range<u64>]>);

/// What all copies of a recording share.
struct Shared {
    line: SampleTimeLine,
    poses: Option<PosesByRow>,
    /// By group, the rows of its samples if they are residuals.
    residual_rows: Vec<Option<Vec<RowPiece>>>,
    rate_hz: f64,
    n_rows: u64,
    first_frame: u64,
    input: Mutex<Box<dyn ReadSeek>>,
    /// For groups and ranges of rows that were asked for before: the numbers of their samples.
    found: Mutex<Vec<FoundNumbers>>,
}

/// The sampled channels of a recording, its force plates, and the poses of its rigid bodies.
#[derive(Clone)]
pub struct Recording {
    shared: Arc<Shared>,
    /// The rotation of the poses, if the laboratory was rotated.
    turn: Option<PoseTurn>,
    plates: Vec<RecordedPlate>,
    warnings: Vec<String>,
    resamples: bool,
}

impl fmt::Debug for Recording {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let n_groups = self.groups().len();
        let mut out = f.debug_struct("Recording");
        out.field("n_groups", &n_groups).field("plates", &self.plates).finish_non_exhaustive()
    }
}

impl PartialEq for Recording {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.shared, &other.shared)
            && self.plates == other.plates
            && self.turn == other.turn
            && self.resamples == other.resamples
    }
}

impl Recording {
    /// The sampled channels and poses of a take, whose file `input` reads; `None` if it has none.
    ///
    /// # Errors
    /// Those of [`SampleTimeLine::read`].
    pub fn open(
        map: &TakeMap,
        mut input: impl Read + Seek + Send + 'static,
    ) -> Result<Option<Self>, TakeError> {
        if map.sample_groups().next().is_none() {
            return Ok(None);
        }
        let line = SampleTimeLine::read(&mut input, map)?;
        let poses = PosesByRow::read(&mut input, map)?;
        let residual_rows = residual_rows(&mut input, map, line.groups())?;
        let (plates, warnings) = map.force_plates();
        let shared = Arc::new(Shared {
            line,
            poses,
            residual_rows,
            rate_hz: map.header.rate_hz,
            n_rows: map.n_rows,
            first_frame: map.header.source.as_ref().map_or(1, |source| source.first_frame),
            input: Mutex::new(Box::new(input)),
            found: Mutex::default(),
        });
        Ok(Some(Self { shared, turn: None, plates, warnings, resamples: false }))
    }

    /// The same, for an export that may resample channels where the format needs it.
    #[must_use]
    pub fn resampling(self, resamples: bool) -> Self {
        Self { resamples, ..self }
    }

    /// Whether an export may resample channels.
    #[must_use]
    pub fn resamples(&self) -> bool {
        self.resamples
    }

    /// The force plates and poses in the axes after a rotation.
    pub(crate) fn turned(&self, turned: impl Fn([f64; 3]) -> [f64; 3] + Copy) -> Self {
        let mut all = self.clone();
        for plate in &mut all.plates {
            plate.geometry = plate.geometry.turned(turned);
        }
        all.turn = Some(match self.turn {
            Some(before) => PoseTurn::new(|vector| turned(before.vector(vector))),
            None => PoseTurn::new(turned),
        });
        all
    }

    /// The rigid bodies; none if the recording has no poses.
    #[must_use]
    pub fn bodies(&self) -> &[PoseBody] {
        self.shared.poses.as_ref().map_or(&[], PosesByRow::bodies)
    }

    /// The poses of all bodies in these rows.
    #[must_use]
    pub fn poses(&self, rows: Range<u64>) -> RecordedPoses<'_> {
        let poses = self.shared.poses.as_ref().map(|poses| poses.rows(rows));
        RecordedPoses { recording: self, poses }
    }

    /// The groups of scalar channels, in order of their numbers.
    #[must_use]
    pub fn groups(&self) -> &[GroupSamples] {
        self.shared.line.groups()
    }

    /// The force plates that can be used.
    #[must_use]
    pub fn plates(&self) -> &[RecordedPlate] {
        &self.plates
    }

    /// Why force plates cannot be used, one sentence each.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Number of the take's first frame.
    pub(crate) fn first_frame(&self) -> u64 {
        self.shared.first_frame
    }

    /// Number of rows of the take.
    #[must_use]
    pub fn n_rows(&self) -> u64 {
        self.shared.n_rows
    }

    /// The clock of a group; `None` beyond the last one.
    #[must_use]
    pub fn clock(&self, group: usize) -> Option<RecordingClock<'_>> {
        let clock = self.shared.line.clock(group)?;
        let rows = self.shared.residual_rows.get(group).and_then(Option::as_deref);
        Some(rows.map_or(clock, |rows| clock.with_rows(rows)))
    }

    /// Whether it has residuals of markers.
    #[must_use]
    pub fn has_residuals(&self) -> bool {
        self.shared.residual_rows.iter().any(Option::is_some)
    }

    /// The residuals of the markers in these rows, of `n_markers` in the take's table.
    ///
    /// # Errors
    /// Those of [`numbers`](Self::numbers).
    pub fn residuals(
        &self,
        rows: &Range<u64>,
        n_markers: usize,
    ) -> Result<RecordedResiduals<'_>, TakeError> {
        let of = |(index, found): (usize, &GroupSamples)| {
            let samples = found.group.has_residuals().then(|| self.samples(index, rows))?;
            Some(samples.map(|samples| ResidualCursor {
                samples,
                block: SampleBlock::default(),
                next: 0,
                has_row: false,
            }))
        };
        let groups = self.groups().iter().enumerate().filter_map(of).collect::<Result<_, _>>()?;
        Ok(RecordedResiduals { groups, row: rows.start, counts_10um: vec![0; n_markers] })
    }

    /// The time of a place among the rows, in seconds from row `first_row`, to the nanosecond.
    #[must_use]
    pub fn time_s(&self, position: f64, first_row: u64) -> f64 {
        ((position - first_row as f64) / self.shared.rate_hz * 1e9).round() / 1e9
    }

    /// The numbers of a group's samples that were taken from row `rows.start` to before row `rows.end`, in ascending order;
    /// those before the first row and after the last one of the take belong to a range that has that row. Lost samples
    /// count, unless none follows or precedes them.
    ///
    /// # Errors
    /// `Io`.
    pub fn numbers(&self, group: usize, rows: &Range<u64>) -> Result<Arc<[Range<u64>]>, TakeError> {
        let key = (group, rows.start, rows.end);
        let lock = || self.shared.found.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, known)) = lock().iter().find(|(known, _)| *known == key) {
            return Ok(Arc::clone(known));
        }
        let found: Arc<[Range<u64>]> = self.find_numbers(group, rows)?.into();
        lock().push((key, Arc::clone(&found)));
        Ok(found)
    }

    fn find_numbers(&self, group: usize, rows: &Range<u64>) -> Result<Vec<Range<u64>>, TakeError> {
        let (Some(samples), Some(clock)) = (self.groups().get(group), self.clock(group)) else {
            return Ok(Vec::new());
        };
        let from = if rows.start == 0 { f64::NEG_INFINITY } else { rows.start as f64 };
        let to = if rows.end >= self.shared.n_rows { f64::INFINITY } else { rows.end as f64 };
        let stored = samples.stored_range();
        let mut found: Vec<Range<u64>> = Vec::new();
        let (mut last, mut n_lost) = (f64::NEG_INFINITY, 0);
        samples.runs(|run| {
            let numbers = match run {
                SampleRun::Block(chunk) => chunk.span.first..chunk.span.end(),
                SampleRun::Lost { first, n, .. } => {
                    let inside = first.max(stored.start)..first.saturating_add(n).min(stored.end);
                    let n = inside.end.saturating_sub(inside.start);
                    n_lost += n;
                    if n > LOST_RUN_MAX || n_lost > LOST_MAX { 0..0 } else { inside }
                }
            };
            for number in numbers {
                // Times ascend: one that does not belongs to a clock that went back by less than its rows tell.
                let Some(at) = clock.position(number).filter(|&at| at > last) else { continue };
                last = at;
                if !(from..to).contains(&at) {
                    continue;
                }
                match found.last_mut() {
                    Some(last) if last.end == number => last.end = number + 1,
                    _ => found.push(number..number + 1),
                }
            }
            Ok::<_, TakeError>(())
        })?;
        Ok(found)
    }

    /// How many samples of each channel have no place on the time line, because the take does not say when they were taken,
    /// or no frame was taken for seconds.
    ///
    /// # Errors
    /// Those of [`numbers`](Self::numbers).
    pub fn n_without_time(&self, group: usize) -> Result<u64, TakeError> {
        let placed = self.numbers(group, &(0..self.shared.n_rows))?;
        let n_placed: u64 = placed.iter().map(|range| range.end - range.start).sum();
        let stored = self.groups().get(group).map(GroupSamples::stored_range);
        Ok(stored
            .map_or(0, |stored| stored.end.saturating_sub(stored.start).saturating_sub(n_placed)))
    }

    /// The samples of a group in those rows, block by block.
    ///
    /// # Errors
    /// Those of [`numbers`](Self::numbers).
    pub fn samples(
        &self,
        group: usize,
        rows: &Range<u64>,
    ) -> Result<RecordedSamples<'_>, TakeError> {
        Ok(self.samples_of(group, self.numbers(group, rows)?))
    }

    /// Some of the samples of a group, block by block: `indices` counts those of the whole take that have a time.
    ///
    /// # Errors
    /// Those of [`numbers`](Self::numbers).
    pub fn samples_at(
        &self,
        group: usize,
        indices: &Range<u64>,
    ) -> Result<RecordedSamples<'_>, TakeError> {
        let mut before = 0;
        let mut wanted = Vec::new();
        for range in self.numbers(group, &(0..self.shared.n_rows))?.iter() {
            let n = range.end - range.start;
            let first = indices.start.saturating_sub(before).min(n);
            let end = indices.end.saturating_sub(before).min(n);
            wanted.extend((first < end).then_some(range.start + first..range.start + end));
            before += n;
        }
        Ok(self.samples_of(group, wanted.into()))
    }

    fn samples_of(&self, group: usize, numbers: Arc<[Range<u64>]>) -> RecordedSamples<'_> {
        let found = self.groups().get(group);
        let first = numbers.first().map_or(0, |range| range.start);
        RecordedSamples {
            recording: self,
            clock: self.clock(group),
            reader: found.map(|found| found.reader_from(first)),
            channels: found.map_or(&[][..], |found| &found.group.channels),
            numbers,
            next_range: 0,
            lost: None,
        }
    }
}

/// By group, the rows of its samples if they are residuals.
fn residual_rows(
    input: &mut (impl Read + Seek),
    map: &TakeMap,
    groups: &[GroupSamples],
) -> Result<Vec<Option<Vec<RowPiece>>>, TakeError> {
    let wanted = groups.iter().filter(|samples| samples.group.has_residuals());
    let wanted: Vec<GroupSamples> = wanted.cloned().collect();
    if wanted.is_empty() {
        return Ok(Vec::new());
    }
    let mut found = rows_of(input, map, &wanted)?.into_iter();
    let of = |samples: &GroupSamples| samples.group.has_residuals().then(|| found.next()).flatten();
    Ok(groups.iter().map(of).collect())
}

/// The residuals of the markers of a recording, row by row.
#[derive(Debug)]
pub struct RecordedResiduals<'a> {
    groups: Vec<ResidualCursor<'a>>,
    row: u64,
    counts_10um: Vec<u8>,
}

#[derive(Debug)]
struct ResidualCursor<'a> {
    samples: RecordedSamples<'a>,
    block: SampleBlock,
    /// The next sample of the block.
    next: usize,
    /// Whether it has a sample of the last row.
    has_row: bool,
}

impl RecordedResiduals<'_> {
    /// The residuals of the next row, by marker in the order of the take's table: in units of 10 micrometres, as devices report
    /// them; 0 where the take has none.
    ///
    /// # Errors
    /// Those of reading the take.
    pub fn next_row(&mut self) -> io::Result<&[u8]> {
        self.counts_10um.fill(0);
        for cursor in &mut self.groups {
            cursor.has_row = cursor.add_row(self.row, &mut self.counts_10um)?;
        }
        self.row += 1;
        Ok(&self.counts_10um)
    }

    /// Those of the last row again.
    pub(crate) fn row(&self) -> &[u8] {
        &self.counts_10um
    }

    /// The markers whose residuals of the last row are missing, by their entry of the take's table: they were lost, while their
    /// frame may be there.
    pub(crate) fn missing(&self) -> impl Iterator<Item = usize> {
        let groups = self.groups.iter().filter(|cursor| !cursor.has_row);
        let channels = groups.flat_map(|cursor| cursor.samples.channels());
        channels.map(|channel| channel.index as usize)
    }
}

impl ResidualCursor<'_> {
    /// Returns whether there is a sample of the row.
    fn add_row(&mut self, row: u64, counts_10um: &mut [u8]) -> io::Result<bool> {
        let channels = self.samples.channels();
        loop {
            let Some(&at) = self.block.positions.get(self.next) else {
                self.next = 0;
                if !self.samples.next_block(&mut self.block)? {
                    self.block = SampleBlock::default();
                    return Ok(false);
                }
                continue;
            };
            if at > row as f64 {
                return Ok(false);
            }
            let n_before = self.next * channels.len();
            self.next += 1;
            if at < row as f64 || self.block.is_lost {
                continue;
            }
            let stored = self.block.stored.get(n_before..).unwrap_or_default();
            for (channel, &stored) in channels.iter().zip(stored) {
                if let Some(count) = counts_10um.get_mut(channel.index as usize) {
                    // NaN becomes 0.
                    *count = (channel.value(stored) / RESIDUAL_SCALE).round() as u8;
                }
            }
            return Ok(true);
        }
    }
}

/// The poses of some rows of a recording, one range of rows after another.
#[derive(Debug)]
pub struct RecordedPoses<'a> {
    recording: &'a Recording,
    poses: Option<RowPoses<'a>>,
}

impl RecordedPoses<'_> {
    /// Replaces `poses` by those of the next rows, as [`RowPoses::next`]: at most [`RowPoses::ROWS_AT_ONCE`] rows.
    ///
    /// # Errors
    /// Those of reading the take.
    pub fn next(&mut self, poses: &mut Vec<Pose>) -> io::Result<Option<Range<u64>>> {
        let Some(of_rows) = &mut self.poses else { return Ok(None) };
        let mut input = self.recording.shared.input.lock().unwrap_or_else(PoisonError::into_inner);
        let rows = of_rows.next(&mut &mut **input, RowPoses::ROWS_AT_ONCE, poses);
        if let Some(turn) = &self.recording.turn {
            poses.iter_mut().for_each(|pose| *pose = turn.apply(pose));
        }
        rows.map_err(io::Error::other)
    }
}

/// Consecutive samples of all channels of a group.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SampleBlock {
    /// Numbers of the samples.
    pub numbers: Vec<u64>,
    /// Their places among the rows, ascending.
    pub positions: Vec<f64>,
    /// The samples as the take stores them, one after another; of each, all channels in order. NaN where they are lost.
    pub stored: Vec<f32>,
    /// Whether they are lost.
    pub is_lost: bool,
}

/// The samples of a group, decoded block by block.
pub struct RecordedSamples<'a> {
    recording: &'a Recording,
    clock: Option<RecordingClock<'a>>,
    reader: Option<GroupReader<'a>>,
    channels: &'a [SampledChannel],
    numbers: Arc<[Range<u64>]>,
    next_range: usize,
    /// Lost samples that have not been returned yet.
    lost: Option<Range<u64>>,
}

impl fmt::Debug for RecordedSamples<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RecordedSamples").field("numbers", &self.numbers).finish_non_exhaustive()
    }
}

impl<'a> RecordedSamples<'a> {
    /// The channels.
    #[must_use]
    pub fn channels(&self) -> &'a [SampledChannel] {
        self.channels
    }

    /// Samples of each channel.
    #[must_use]
    pub fn n_samples(&self) -> u64 {
        self.numbers.iter().map(|range| range.end - range.start).sum()
    }

    /// The places of all samples among the rows, in order.
    pub fn positions(&self) -> impl Iterator<Item = f64> + '_ {
        let numbers = self.numbers.iter().cloned().flatten();
        numbers.map(|number| self.position(number))
    }

    fn position(&self, number: u64) -> f64 {
        self.clock.and_then(|clock| clock.position(number)).unwrap_or(f64::NAN)
    }

    /// Replaces `block` by the next samples; `false` at the end.
    ///
    /// # Errors
    /// Those of reading the take.
    pub fn next_block(&mut self, block: &mut SampleBlock) -> io::Result<bool> {
        let recording = self.recording;
        let mut input = recording.shared.input.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            if let Some(lost) = self.lost.take() {
                // Most of a long loss has no place.
                let wanted =
                    self.numbers.get(self.next_range).map_or(lost.end, |range| range.start);
                let lost = lost.start.max(wanted).min(lost.end)..lost.end;
                if lost.is_empty() {
                    continue;
                }
                let end = lost.end.min(lost.start + LOST_AT_ONCE);
                self.lost = Some(end..lost.end).filter(|rest| !rest.is_empty());
                if self.fill(block, lost.start..end, None) {
                    return Ok(true);
                }
                continue;
            }
            let Some(reader) = &mut self.reader else { return Ok(false) };
            let last = self.numbers.last().map_or(0, |range| range.end);
            let Some((span, samples)) = reader.next(&mut &mut **input).map_err(io::Error::other)?
            else {
                return Ok(false);
            };
            let Some(samples) = samples else {
                self.lost = Some(span.first..span.end().min(last)).filter(|lost| !lost.is_empty());
                if span.first >= last {
                    return Ok(false);
                }
                continue;
            };
            let samples = samples.to_vec();
            if self.fill(block, span.first..span.end(), Some(&samples)) {
                return Ok(true);
            }
            if span.first >= last {
                return Ok(false);
            }
        }
    }

    /// Fills a block with those of the samples that are wanted; `samples` has them channel after channel. Returns whether
    /// there is one.
    fn fill(&mut self, block: &mut SampleBlock, all: Range<u64>, samples: Option<&[f32]>) -> bool {
        block.numbers.clear();
        block.positions.clear();
        block.stored.clear();
        block.is_lost = samples.is_none();
        let n = (all.end - all.start) as usize;
        while let Some(wanted) = self.numbers.get(self.next_range) {
            for number in wanted.start.max(all.start)..wanted.end.min(all.end) {
                let at = (number - all.start) as usize;
                block.numbers.push(number);
                let value =
                    |channel: usize| samples.and_then(|samples| samples.get(channel * n + at));
                let values = (0..self.channels.len()).map(|channel| value(channel).copied());
                block.stored.extend(values.map(|value| value.unwrap_or(f32::NAN)));
            }
            if wanted.end > all.end {
                break;
            }
            self.next_range += 1;
        }
        block.positions.extend(block.numbers.iter().map(|&number| self.position(number)));
        !block.numbers.is_empty()
    }
}

impl SampledChannel {
    /// The value of a stored sample, in the channel's unit.
    #[must_use]
    pub fn value(&self, stored: f32) -> f64 {
        (f64::from(stored) - self.offset) * self.scale
    }
}

//! The syntax of a channel's samples: exact events first, then the cell by halving.

use super::{
    prediction::{Distribution, Predictor, REFERENCES},
    representation::{CellForm, Cells, Head, Past, from_ordered, ordered},
};
use crate::{
    Result,
    coding::{
        isa::Kernel,
        range::{BinaryCoder, Bit},
    },
    ensure,
};

/// Contexts of one kind of event: three events back, the parity of the row, and the channel before.
const EVENT_CONTEXTS: usize = 64 * 2 * 3;
/// Contexts of corrections: whether there is one, its sign, and the unary length of its magnitude.
const CORRECTION_CONTEXTS: usize = 36;

/// All adaptive probabilities of samples.
#[derive(Debug, Clone)]
pub(super) struct SampleModel {
    lines: [Bit; EVENT_CONTEXTS],
    repeats: [Bit; EVENT_CONTEXTS],
    modes: [Bit; EVENT_CONTEXTS],
    corrections: [Bit; CORRECTION_CONTEXTS],
}

impl SampleModel {
    pub(super) const NEW: Self = Self {
        lines: [Bit::NEW; EVENT_CONTEXTS],
        repeats: [Bit::NEW; EVENT_CONTEXTS],
        modes: [Bit::NEW; EVENT_CONTEXTS],
        corrections: [Bit::NEW; CORRECTION_CONTEXTS],
    };
}

/// The state of a channel from block to block.
#[derive(Debug, Clone)]
pub(super) struct SampledChannelState {
    pub(super) head: Head,
    pub(super) cells: Cells,
    pub(super) predictor: Predictor,
    pub(super) distribution: Distribution,
    /// The distribution of first samples after gaps.
    across_gaps: Distribution,
    /// The last two samples of the block before.
    pub(super) last: [f32; 2],
    /// The last two samples before the current block, for the channels after this one.
    pub(super) last_before: [f32; 2],
    /// Whether there was a sample since the key.
    pub(super) is_started: bool,
    events: u32,
    /// The parity of the next row, counted from the key.
    pub(super) parity: u32,
}

/// Values beyond this many units of a channel's scale are cut to it for prediction.
const REACH: f64 = 1e12;

impl SampledChannelState {
    pub(super) fn new() -> Self {
        Self {
            head: Head::default(),
            cells: Cells::default(),
            predictor: Predictor::new(),
            distribution: Distribution::new(),
            across_gaps: Distribution::new(),
            last: [0.0; 2],
            last_before: [0.0; 2],
            is_started: false,
            events: 0,
            parity: 0,
        }
    }

    pub(super) fn reset(&mut self) {
        self.head = Head::default();
        self.cells.clear();
        self.is_started = false;
        (self.distribution, self.across_gaps) = (Distribution::new(), Distribution::new());
        (self.last, self.last_before) = ([0.0; 2], [0.0; 2]);
        (self.events, self.parity) = (0, 0);
    }

    /// Starts with a sample, and with the weights of a similar channel, if there is one.
    fn start(&mut self, sample: f32, like: Option<&Self>) {
        self.is_started = true;
        self.parity = 1;
        self.last = [sample; 2];
        let value = unit(sample, self.head.per_unit());
        if let Some(other) = like {
            self.predictor.start_like(value, &other.predictor);
            self.distribution = other.distribution.clone();
            self.across_gaps = other.across_gaps.clone();
        } else {
            self.predictor.start(value);
        }
    }

    /// Accounts for a block without a sample of this channel.
    pub(super) fn skip(&mut self) {
        self.last_before = self.last;
    }
}

/// A sample as a number for arithmetic: finite, and in units.
#[inline(always)]
fn unit(sample: f32, per_unit: f64) -> f64 {
    let value = f64::from(sample) * per_unit;
    // NaN fails both comparisons.
    if value > -REACH && value < REACH {
        value
    } else if value >= REACH {
        REACH
    } else if value <= -REACH {
        -REACH
    } else {
        0.0
    }
}

/// A channel that was coded before the current one.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ReferenceChannel<'a> {
    pub(super) samples: &'a [f32],
    pub(super) last: [f32; 2],
    pub(super) per_unit: f64,
}

impl ReferenceChannel<'_> {
    /// The sample `back` rows before a row.
    #[inline(always)]
    fn at(&self, row: usize, back: usize) -> f32 {
        if row >= back {
            self.samples.get(row - back).copied().unwrap_or_default()
        } else {
            self.last[(back - row - 1).min(1)]
        }
    }
}

/// The coding of one channel over one block.
pub(super) struct ChannelWalk<'a, C> {
    pub(super) coder: &'a mut C,
    pub(super) model: &'a mut SampleModel,
    pub(super) track: &'a mut SampledChannelState,
    /// The channel before, if there is one.
    pub(super) previous: Option<ReferenceChannel<'a>>,
    /// The reference channels, which predict this one; unused entries are empty.
    pub(super) references: [ReferenceChannel<'a>; REFERENCES],
    /// Encoded, or replaced by what was decoded.
    pub(super) samples: &'a mut [f32],
    /// Indices of the samples after gaps, ascending: nothing is predicted from what lies before a gap.
    pub(super) after_gaps: &'a [u32],
    /// A channel whose weights this one inherits, if this is its first block.
    pub(super) like: Option<&'a SampledChannelState>,
}

/// How a sample was coded; the contexts of later samples depend on it.
const OTHER: u32 = 0;
const REPEAT: u32 = 1;
const LINE: u32 = 2;
const MODE: u32 = 3;

impl<C: BinaryCoder> Kernel for ChannelWalk<'_, C> {
    type Output = Result<()>;

    #[inline(always)]
    fn run(mut self) -> Result<()> {
        if self.track.cells.form == CellForm::Stored {
            self.stored();
            return Ok(());
        }
        let first = usize::from(!self.track.is_started);
        if !self.track.is_started
            && let Some(sample) = self.samples.first_mut()
        {
            *sample = f32::from_bits(self.coder.plain(sample.to_bits().into(), 32) as u32);
            self.track.start(*sample, self.like);
        }
        self.track.last_before = self.track.last;
        let [mut before, mut before2] = self.track.last;
        for row in first..self.samples.len() {
            let wanted = self.samples.get(row).copied().unwrap_or_default();
            let is_after_gap = self.is_after_gap(row);
            let sample = self.sample((row, is_after_gap), wanted, [before, before2])?;
            if let Some(slot) = self.samples.get_mut(row) {
                *slot = sample;
            }
            (before2, before) = (before, sample);
        }
        self.track.last = [before, before2];
        Ok(())
    }
}

/// The sample on the line through the two before; a fixed NaN if that is not finite, because processors differ in the
/// bits of the NaN that they compute.
#[inline(always)]
fn on_line([before, before2]: [f32; 2]) -> f32 {
    let line = (2.0 * f64::from(before) - f64::from(before2)) as f32;
    if line.is_finite() { line } else { f32::from_bits(0x7fc0_0000) }
}

impl<C: BinaryCoder> ChannelWalk<'_, C> {
    /// Codes all samples bit by bit. The channel is then in the state after a first sample.
    fn stored(&mut self) {
        for sample in self.samples.iter_mut() {
            *sample = f32::from_bits(self.coder.plain(sample.to_bits().into(), 32) as u32);
        }
        if let Some(&last) = self.samples.last() {
            self.track.start(last, None);
        }
    }

    /// Whether a gap precedes a sample. Calls must be in the order of samples.
    #[inline(always)]
    fn is_after_gap(&mut self, row: usize) -> bool {
        while let Some((&next, rest)) = self.after_gaps.split_first() {
            if next as usize >= row {
                return next as usize == row;
            }
            self.after_gaps = rest;
        }
        false
    }

    #[inline(always)]
    fn sample(
        &mut self,
        (row, is_after_gap): (usize, bool),
        wanted: f32,
        past: [f32; 2],
    ) -> Result<f32> {
        let parity = self.track.parity;
        self.track.parity ^= 1;
        let head = self.track.head;
        let history = (self.track.events & 0x3f) as usize;
        let mut repeat_context = 0;
        if (head.repeats[parity as usize] || head.mode.is_some())
            && let Some(previous) = &self.previous
        {
            let [now, then] = [previous.at(row, 0), previous.at(row, 1)];
            repeat_context = 1 + usize::from(now.to_bits() == then.to_bits());
        }
        let mut excluded = [None; 3];
        if head.lines[parity as usize] {
            let line = on_line(past);
            let context = history * 2 + parity as usize;
            let is_line = wanted.to_bits() == line.to_bits();
            if self.coder.bit(&mut self.model.lines[context], is_line) {
                self.move_on(line, LINE);
                return Ok(line);
            }
            excluded[0] = Some(line);
        }
        if head.repeats[parity as usize] {
            let context = (history * 2 + parity as usize) * 3 + repeat_context;
            let is_repeat = wanted.to_bits() == past[0].to_bits();
            if self.coder.bit(&mut self.model.repeats[context], is_repeat) {
                self.move_on(past[0], REPEAT);
                return Ok(past[0]);
            }
            excluded[1] = Some(past[0]);
        }
        if let Some(mode) = head.mode {
            let context = (history * 2 + parity as usize) * 3 + repeat_context;
            let is_mode = wanted.to_bits() == mode;
            if self.coder.bit(&mut self.model.modes[context], is_mode) {
                let mode = f32::from_bits(mode);
                self.move_on(mode, MODE);
                return Ok(mode);
            }
            excluded[2] = Some(f32::from_bits(mode));
        }
        self.cell_sample((row, is_after_gap), wanted, excluded)
    }

    /// The changes of the reference channels at the row and the row before.
    #[inline(always)]
    fn reference_changes(&self, row: usize) -> [f64; 2 * REFERENCES] {
        let mut changes = [0.0; 2 * REFERENCES];
        for (i, reference) in self.references.iter().enumerate() {
            let [now, then, before] =
                [0, 1, 2].map(|back| unit(reference.at(row, back), reference.per_unit));
            changes[2 * i] = now - then;
            changes[2 * i + 1] = then - before;
        }
        changes
    }

    /// Accounts for a sample that an event gave.
    #[inline(always)]
    fn move_on(&mut self, sample: f32, event: u32) {
        let track = &mut *self.track;
        track.events = track.events << 2 | event;
        if track.head.past != Past::Cells {
            track.predictor.push(unit(sample, track.head.per_unit()));
        }
    }

    #[inline(always)]
    fn cell_sample(
        &mut self,
        (row, is_after_gap): (usize, bool),
        wanted: f32,
        excluded: [Option<f32>; 3],
    ) -> Result<f32> {
        let changes = self.reference_changes(row);
        let track = &mut *self.track;
        let per_unit = track.head.per_unit();
        let predicted = track.predictor.predict(&changes);
        let predicted = if predicted > -REACH && predicted < REACH && !is_after_gap {
            predicted
        } else {
            track.predictor.last()
        };
        let scale = track.head.scale();
        let mut halving = Halving {
            cells: &track.cells,
            distribution: if is_after_gap { &track.across_gaps } else { &track.distribution },
            centre: predicted * scale,
            per_unit,
            excluded: [(0, 0.0); 3],
            n_excluded: 0,
        };
        if !track.head.corrects {
            halving.exclude(excluded);
        }
        let wanted_cell = if wanted.is_finite() {
            track.cells.nearest(f64::from(wanted))
        } else {
            track.cells.nearest(halving.centre)
        };
        let cell = halving.code(self.coder, wanted_cell);
        let mut sample = track.cells.value(cell);
        if track.head.corrects {
            let correction = i64::from(ordered(wanted)) - i64::from(ordered(sample));
            let correction = code_correction(self.coder, &mut self.model.corrections, correction)?;
            let corrected = i64::from(ordered(sample)) + correction;
            ensure(i32::try_from(corrected).is_ok(), "a sample out of range")?;
            sample = from_ordered(corrected as i32);
        }
        let low = if cell > track.cells.bounds().0 { track.cells.border(cell - 1) } else { -1e39 };
        let high = if cell < track.cells.bounds().1 { track.cells.border(cell) } else { 1e39 };
        let value = if sample.is_finite() { unit(sample, per_unit) } else { predicted };
        let error = value - predicted;
        let (low, high) = (low * per_unit - predicted, high * per_unit - predicted);
        if is_after_gap {
            track.across_gaps.learn(low, high, error);
            track.predictor.restart(value);
        } else {
            track.distribution.learn(low, high, error);
            track.predictor.learn(error);
            if track.head.past != Past::Events {
                track.predictor.push(value);
            }
        }
        track.events <<= 2;
        track.events |= OTHER;
        Ok(sample)
    }
}

/// Codes a number of steps of [`ordered`] between a sample and the value of its cell.
#[inline(always)]
fn code_correction<C: BinaryCoder>(coder: &mut C, bits: &mut [Bit], wanted: i64) -> Result<i64> {
    if !coder.bit(&mut bits[0], wanted != 0) {
        return Ok(0);
    }
    let is_negative = coder.bit(&mut bits[1], wanted < 0);
    let magnitude = wanted.unsigned_abs().max(1);
    let wanted_log = magnitude.ilog2();
    let mut log = 0;
    while coder.bit(&mut bits[2 + log as usize], wanted_log > log) {
        log += 1;
        ensure(log < 33, "a correction out of range")?;
    }
    let rest = coder.plain(magnitude, log);
    let magnitude = (1 << log | rest & ((1 << log) - 1)) as i64;
    Ok(if is_negative { -magnitude } else { magnitude })
}

/// Finds a cell by decisions between two halves of an interval.
struct Halving<'a> {
    cells: &'a Cells,
    distribution: &'a Distribution,
    centre: f64,
    per_unit: f64,
    /// Cells that the sample is not in, and their probabilities.
    excluded: [(i64, f64); 3],
    n_excluded: usize,
}

/// An interval of cells, and the probabilities of a sample below its first and below its end.
#[derive(Clone, Copy)]
struct Interval {
    first: i64,
    last: i64,
    below: f64,
    through: f64,
}

/// Probabilities up to this are treated as equal.
const NEGLIGIBLE: f64 = 1e-13;

impl Halving<'_> {
    #[inline(always)]
    fn below(&self, cell: i64) -> f64 {
        let border = self.cells.border(cell - 1);
        self.distribution.below((border - self.centre) * self.per_unit)
    }

    #[inline(always)]
    fn exclude(&mut self, samples: [Option<f32>; 3]) {
        let (first, last) = self.cells.bounds();
        for sample in samples.into_iter().flatten().filter(|sample| sample.is_finite()) {
            let cell = self.cells.nearest(f64::from(sample));
            let is_known = self.excluded.iter().take(self.n_excluded).any(|known| known.0 == cell);
            if self.cells.value(cell).to_bits() != sample.to_bits() || is_known {
                continue;
            }
            let below = if cell > first { self.below(cell) } else { 0.0 };
            let through = if cell < last { self.below(cell + 1) } else { 1.0 };
            if let Some(slot) = self.excluded.get_mut(self.n_excluded) {
                *slot = (cell, through - below);
                self.n_excluded += 1;
            }
        }
    }

    /// The probability of an interval without its excluded cells.
    #[inline(always)]
    fn mass(&self, Interval { first, last, below, through }: Interval) -> f64 {
        let mut mass = through - below;
        for &(cell, probability) in self.excluded.iter().take(self.n_excluded) {
            if cell >= first && cell <= last {
                mass -= probability;
            }
        }
        if mass > 0.0 { mass } else { 0.0 }
    }

    /// Decides whether the cell is at least `middle`, which is above the first of the interval, and narrows the
    /// interval.
    #[inline(always)]
    fn decide<C: BinaryCoder>(
        &self,
        coder: &mut C,
        interval: &mut Interval,
        middle: i64,
        wanted: i64,
    ) -> bool {
        let border = self.below(middle);
        let lower = Interval { last: middle - 1, through: border, ..*interval };
        let upper = Interval { first: middle, below: border, ..*interval };
        let masses = (self.mass(lower), self.mass(upper));
        let total = masses.0 + masses.1;
        let probability = if total > NEGLIGIBLE {
            ((masses.0 / total * 65536.0) as u32).clamp(16, 65520)
        } else {
            1 << 15
        };
        let is_upper = coder.split(probability, wanted >= middle);
        *interval = if is_upper { upper } else { lower };
        is_upper
    }

    #[inline(always)]
    fn code<C: BinaryCoder>(&self, coder: &mut C, wanted: i64) -> i64 {
        let (first, last) = self.cells.bounds();
        let mut interval = Interval { first, last, below: 0.0, through: 1.0 };
        let width = self.distribution.width() / self.per_unit;
        let narrowest = self.distribution.narrowest() / self.per_unit;
        let near = self.cells.nearest(self.centre);
        // Above or below the prediction.
        let is_upper =
            near > first && self.decide(coder, &mut interval, near, wanted) || near == first;
        // Outwards in growing steps, until the interval is bounded.
        let mut step = width * 0.5;
        while interval.first < interval.last {
            let far = self.cells.nearest(self.centre + if is_upper { step } else { -step });
            if is_upper {
                let middle = far.max(interval.first) + 1;
                if middle > interval.last || !self.decide(coder, &mut interval, middle, wanted) {
                    break;
                }
            } else {
                let middle = far.min(interval.last);
                if middle <= interval.first || self.decide(coder, &mut interval, middle, wanted) {
                    break;
                }
            }
            step *= 2.0;
        }
        self.narrow(coder, interval, wanted, narrowest)
    }

    /// Halves an interval until it is one cell.
    #[inline(always)]
    fn narrow<C: BinaryCoder>(
        &self,
        coder: &mut C,
        mut interval: Interval,
        wanted: i64,
        width: f64,
    ) -> i64 {
        while interval.first < interval.last {
            let low = self.cells.position(interval.first);
            let high = self.cells.position(interval.last);
            if high - low < width * 0.25 && self.cells.is_even(interval.first, interval.last) {
                return uniform(coder, interval.first, interval.last, wanted);
            }
            let middle = self.cells.nearest((low + high) * 0.5);
            let middle = middle.clamp(interval.first + 1, interval.last);
            self.decide(coder, &mut interval, middle, wanted);
        }
        interval.first
    }
}

/// Codes a cell of an interval where all are equally probable: whether it is among the first 2^n, and then n bits.
#[inline(always)]
fn uniform<C: BinaryCoder>(coder: &mut C, mut first: i64, last: i64, wanted: i64) -> i64 {
    loop {
        let n = (last - first + 1) as u64;
        let log = n.ilog2();
        let half = 1_u64 << log;
        if half < n {
            let probability = ((half << 16) / n) as u32;
            if coder.split(probability.clamp(1, 65535), wanted >= first + half as i64) {
                first += half as i64;
                continue;
            }
        }
        return first + coder.plain((wanted - first) as u64, log) as i64;
    }
}

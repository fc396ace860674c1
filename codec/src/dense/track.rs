//! The state of one channel: its decoded rows in and before this block, and the activities of its residuals.

use std::ops::RangeInclusive;

use super::{
    contexts::KINDS,
    lattice::{Fineness, Point, Points, copy, integers},
    level_prediction::{AnchorErrors, Batch, PADDED_SPAN, PAST_ROWS},
};

/// Neighbours' magnitudes are clamped to this: three rows' sums of three axes then fit 16 bits.
const MAX_MAGNITUDE: u32 = 900;
/// Magnitudes are clamped to this in activities.
const MAX_ACTIVITY: i64 = 2000;
/// Stored magnitudes with signs are clamped to this.
const MAX_STEP: i32 = 1000;

/// The last sample of a run.
#[derive(Debug, Clone, Copy)]
pub(super) struct RunEnd {
    /// Number of the row since the key block.
    pub(super) row: u64,
    pub(super) point: Point,
    /// Whether a later run has been coded as the continuation of this one.
    pub(super) taken: bool,
}

/// The coded magnitudes of a row with their signs, and the sum of their clamped absolute values.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(8))]
pub(super) struct Steps {
    pub(super) axes: [i16; 3],
    pub(super) weight: u16,
}

impl Steps {
    #[inline(always)]
    fn new(axes: [i16; 3]) -> Self {
        let weight = axes.map(|step| magnitude(i32::from(step)) as u16).iter().sum();
        Self { axes, weight }
    }

    /// The clamped magnitudes and their sum, packed into 16 bits each, so that up to three rows can be added at once.
    #[inline(always)]
    fn packed(self) -> u64 {
        let [x, y, z] = self.axes.map(|step| magnitude(i32::from(step)) as u64);
        x | y << 16 | z << 32 | u64::from(self.weight) << 48
    }
}

/// The magnitude of an axis in packed steps or a sum of them.
#[inline(always)]
pub(super) fn unpack_magnitude(packed: u64, axis: usize) -> i32 {
    i32::from((packed >> (16 * axis)) as u16)
}

/// The sum of the three magnitudes in packed steps or a sum of them.
#[inline(always)]
pub(super) fn unpack_sum(packed: u64) -> i32 {
    (packed >> 48) as i32
}

/// One channel. Rows are indices into these lists; the block's first row is [`PAST_ROWS`].
#[derive(Debug)]
pub(super) struct Track {
    /// Decoded points in units; NaN where a row is unknown, which carries over to all results.
    pub(super) points: Vec<[f64; 3]>,
    /// The points of the current span by axis and slot: the rows of a level are adjacent. NaN where unknown.
    pub(super) span: [[f64; PADDED_SPAN]; 3],
    /// The packed steps of the rows of the current span by slot; zero where unknown or not moved.
    pub(super) packed_steps: [u64; PADDED_SPAN],
    /// Coded steps; zero where unknown or not moved.
    pub(super) steps: Vec<Steps>,
    /// First row of the run that contains the row before the current span.
    pub(super) run_start: usize,
    /// Activities by kind of row: averages of the magnitudes of x, y, z and of their sum, in 1/256 of a lattice step.
    pub(super) activity: [[i32; 4]; KINDS],
    pub(super) anchor_errors: AnchorErrors,
    pub(super) end: Option<RunEnd>,
    pub(super) fineness: Fineness,
    /// The last choices of how to store the channel: 0 none yet, 1 no, 2 yes.
    pub(super) was_raw: usize,
    pub(super) was_fine: usize,
}

impl Track {
    pub(super) fn new() -> Self {
        Self {
            points: Vec::new(),
            span: [[f64::NAN; PADDED_SPAN]; 3],
            packed_steps: [0; PADDED_SPAN],
            steps: Vec::new(),
            run_start: 0,
            activity: Default::default(),
            anchor_errors: AnchorErrors::default(),
            end: None,
            fineness: Fineness::default(),
            was_raw: 0,
            was_fine: 0,
        }
    }

    /// Allocates memory for blocks of `n_rows` rows.
    pub(super) fn prepare(&mut self, n_rows: usize) {
        let rows = PAST_ROWS + n_rows;
        self.points.reserve(rows.saturating_sub(self.points.len()));
        self.steps.reserve(rows.saturating_sub(self.steps.len()));
    }

    pub(super) fn reset(&mut self) {
        self.forget();
        self.activity = Default::default();
        self.anchor_errors = AnchorErrors::default();
        self.end = None;
        (self.was_raw, self.was_fine) = (0, 0);
    }

    /// Marks all rows so far as unknown.
    pub(super) fn forget(&mut self) {
        self.steps.fill(Steps::default());
        self.points.fill([f64::NAN; 3]);
    }

    /// Copies the rows `rows` and the statistics of the rows before the current span.
    pub(super) fn follow(&mut self, other: &Self, rows: RangeInclusive<usize>) {
        self.points.resize(other.points.len(), [f64::NAN; 3]);
        self.steps.resize(other.steps.len(), Steps::default());
        self.points[rows.clone()].copy_from_slice(&other.points[rows.clone()]);
        self.steps[rows.clone()].copy_from_slice(&other.steps[rows]);
        self.run_start = other.run_start;
        self.activity = other.activity;
        self.anchor_errors.clone_from(&other.anchor_errors);
        (self.end, self.fineness) = (other.end, other.fineness);
    }

    /// Begins a block of `n_rows` rows.
    pub(super) fn begin(&mut self, n_rows: usize) {
        self.points.resize(PAST_ROWS, [f64::NAN; 3]);
        self.points.resize(PAST_ROWS + n_rows, [f64::NAN; 3]);
        self.steps.resize(PAST_ROWS, Steps::default());
        self.steps.resize(PAST_ROWS + n_rows, Steps::default());
    }

    /// Begins a span.
    pub(super) fn begin_span(&mut self) {
        self.span = [[f64::NAN; PADDED_SPAN]; 3];
        self.packed_steps = [0; PADDED_SPAN];
    }

    /// Ends a block of `n_rows` rows: keeps the last [`PAST_ROWS`] rows.
    pub(super) fn finish(&mut self, n_rows: usize) {
        self.points.copy_within(n_rows.., 0);
        self.points.truncate(PAST_ROWS);
        self.steps.copy_within(n_rows.., 0);
        self.steps.truncate(PAST_ROWS);
        self.run_start = self.run_start.saturating_sub(n_rows);
    }

    /// Whether a row is present and has been decoded.
    pub(super) fn is_known(&self, row: usize) -> bool {
        !self.points[row][0].is_nan()
    }

    /// The steps of the row `back` rows before `row`; zero before `start`.
    #[inline(always)]
    pub(super) fn steps_from(&self, start: usize, row: usize, back: usize) -> Steps {
        if row >= start + back { self.steps[row - back] } else { Steps::default() }
    }

    /// The point of a known row.
    pub(super) fn point(&self, row: usize) -> Point {
        integers(self.points[row])
    }

    /// Stores the points of a batch.
    #[inline(always)]
    pub(super) fn store_points<const N: usize>(&mut self, batch: Batch, points: &Points<N>) {
        for (span, axis) in self.span.iter_mut().zip(points) {
            copy(axis, &mut span[batch.slot..], batch.n);
        }
        let [x, y, z] = points;
        for i in 0..batch.n.min(N) {
            let row = batch.at(i);
            self.points[row] = [x[i], y[i], z[i]];
        }
    }

    /// Records the steps of a row that was moved, updates the activity, and returns the clamped steps. Rows that are
    /// not moved keep their zeros.
    #[inline(always)]
    pub(super) fn record_steps(
        &mut self,
        row: usize,
        slot: usize,
        steps: Point,
        activity: &mut [i32; 4],
    ) -> Steps {
        let steps = steps.map(|step| step.clamp(-MAX_ACTIVITY, MAX_ACTIVITY) as i32);
        let short = Steps::new(steps.map(|step| step.clamp(-MAX_STEP, MAX_STEP) as i16));
        self.steps[row] = short;
        self.packed_steps[slot] = short.packed();
        let [x, y, z] = steps.map(i32::abs);
        update_activity(activity, [x, y, z, x + y + z]);
        short
    }
}

/// Moves the averages a fifth of the way to `magnitudes`.
#[inline(always)]
pub(super) fn update_activity(averages: &mut [i32; 4], magnitudes: [i32; 4]) {
    for (average, magnitude) in averages.iter_mut().zip(magnitudes) {
        *average += ((magnitude * 256 - *average) * 51) >> 8;
    }
}

/// The magnitude of a step, clamped as neighbours count it.
#[inline(always)]
pub(super) fn magnitude(step: i32) -> i32 {
    step.unsigned_abs().min(MAX_MAGNITUDE) as i32
}

//! What is known of one channel: its rows of this block, the last ones before it, and its activity.

use super::{
    contexts::KINDS,
    level_prediction::{AnchorErrors, Batch, MEMORY, PADDED},
    points::{Fineness, Point, Points, copy, integers},
};

/// Magnitudes count up to this.
const MAX_MAGNITUDE: u32 = 900;
/// In activities up to this.
const MAX_ACTIVITY: i64 = 2000;
/// And are remembered with their signs up to this.
const MAX_STEP: i32 = 1000;

/// The last sample of a run.
#[derive(Debug, Clone, Copy)]
pub(super) struct End {
    /// Counted from the key block on.
    pub(super) row: u64,
    pub(super) point: Point,
    /// A later run has been found to go on from here.
    pub(super) taken: bool,
}

/// The coded magnitudes of a row with their signs, and the sum of them as neighbours count them.
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

    /// The magnitudes and their sum, 16 bits each: they can be added, three rows at least.
    #[inline(always)]
    fn marks(self) -> u64 {
        let [x, y, z] = self.axes.map(|step| magnitude(i32::from(step)) as u64);
        x | y << 16 | z << 32 | u64::from(self.weight) << 48
    }
}

/// The magnitude of an axis in a row's marks or a sum of them.
#[inline(always)]
pub(super) fn marked(marks: u64, axis: usize) -> i32 {
    i32::from((marks >> (16 * axis)) as u16)
}

/// The sum of the three.
#[inline(always)]
pub(super) fn marked_weight(marks: u64) -> i32 {
    (marks >> 48) as i32
}

/// One channel. Rows are indices into these lists, the block's first being [`MEMORY`].
#[derive(Debug)]
pub(super) struct Track {
    /// NaN where nothing is known: what comes of it is NaN, too.
    pub(super) points: Vec<[f64; 3]>,
    /// The points of the current span by axis and place in it: the rows of a level side by side. NaN as above.
    pub(super) span: [[f64; PADDED]; 3],
    /// The magnitudes of the rows of the current span by place, as [`marked`] takes them; zero where there is nothing.
    pub(super) marks: [u64; PADDED],
    /// Zero where nothing is known.
    pub(super) steps: Vec<Steps>,
    /// First row of the run that the row before the current span belongs to.
    pub(super) run_start: usize,
    /// Averages of the magnitudes, in 1/256, by kind: by axis, and of the sums.
    pub(super) activity: [[i32; 4]; KINDS],
    pub(super) anchor_errors: AnchorErrors,
    pub(super) end: Option<End>,
    pub(super) fineness: Fineness,
    /// The last two choices of how to store the channel: 0 not yet, 1 no, 2 yes.
    pub(super) was_raw: usize,
    pub(super) was_fine: usize,
}

impl Track {
    pub(super) fn new() -> Self {
        Self {
            points: Vec::new(),
            span: [[f64::NAN; PADDED]; 3],
            marks: [0; PADDED],
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

    /// Room for blocks of so many rows.
    pub(super) fn prepare(&mut self, n_rows: usize) {
        let rows = MEMORY + n_rows;
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

    /// The rows so far are not known.
    pub(super) fn forget(&mut self) {
        self.steps.fill(Steps::default());
        self.points.fill([f64::NAN; 3]);
    }

    /// A block of so many rows begins.
    pub(super) fn begin(&mut self, n_rows: usize) {
        self.points.resize(MEMORY, [f64::NAN; 3]);
        self.points.resize(MEMORY + n_rows, [f64::NAN; 3]);
        self.steps.resize(MEMORY, Steps::default());
        self.steps.resize(MEMORY + n_rows, Steps::default());
    }

    /// A span begins.
    pub(super) fn begin_span(&mut self) {
        self.span = [[f64::NAN; PADDED]; 3];
        self.marks = [0; PADDED];
    }

    /// The block of so many rows is over.
    pub(super) fn finish(&mut self, n_rows: usize) {
        self.points.copy_within(n_rows.., 0);
        self.points.truncate(MEMORY);
        self.steps.copy_within(n_rows.., 0);
        self.steps.truncate(MEMORY);
        self.run_start = self.run_start.saturating_sub(n_rows);
    }

    /// Whether a row is present and has been decoded.
    pub(super) fn is_known(&self, row: usize) -> bool {
        !self.points[row][0].is_nan()
    }

    /// Coded magnitudes of the row so many rows before; zero before `start`.
    #[inline(always)]
    pub(super) fn steps_from(&self, start: usize, row: usize, back: usize) -> Steps {
        if row >= start + back { self.steps[row - back] } else { Steps::default() }
    }

    /// A known row.
    pub(super) fn point(&self, row: usize) -> Point {
        integers(self.points[row])
    }

    /// Stores the points of some rows.
    #[inline(always)]
    pub(super) fn settle<const N: usize>(&mut self, batch: Batch, points: &Points<N>) {
        for (span, axis) in self.span.iter_mut().zip(points) {
            copy(axis, &mut span[batch.slot..], batch.n);
        }
        let [x, y, z] = points;
        for i in 0..batch.n.min(N) {
            let row = batch.at(i);
            self.points[row] = [x[i], y[i], z[i]];
        }
    }

    /// Remembers the magnitudes of a row that was moved, and gives them. Of others nothing is known so far, and that
    /// is what zeros say.
    #[inline(always)]
    pub(super) fn keep(
        &mut self,
        row: usize,
        slot: usize,
        steps: Point,
        activity: &mut [i32; 4],
    ) -> Steps {
        let steps = steps.map(|step| step.clamp(-MAX_ACTIVITY, MAX_ACTIVITY) as i32);
        let short = Steps::new(steps.map(|step| step.clamp(-MAX_STEP, MAX_STEP) as i16));
        self.steps[row] = short;
        self.marks[slot] = short.marks();
        let [x, y, z] = steps.map(i32::abs);
        follow(activity, [x, y, z, x + y + z]);
        short
    }
}

/// A fifth of the way.
#[inline(always)]
pub(super) fn follow(averages: &mut [i32; 4], magnitudes: [i32; 4]) {
    for (average, magnitude) in averages.iter_mut().zip(magnitudes) {
        *average += ((magnitude * 256 - *average) * 51) >> 8;
    }
}

/// A magnitude as neighbours count it.
#[inline(always)]
pub(super) fn magnitude(step: i32) -> i32 {
    step.unsigned_abs().min(MAX_MAGNITUDE) as i32
}

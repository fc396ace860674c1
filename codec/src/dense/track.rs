//! What is known of one channel: its rows of this block, the last ones before it, and its activity.

use super::{
    anchor::Anchor,
    lattice::{Fineness, Point},
    layout::KINDS,
};

/// Rows before the block that predictions look at.
pub(super) const MEMORY: usize = 64;

/// Magnitudes count up to this.
const MAX_MAGNITUDE: u32 = 900;
/// In activities up to this.
const MAX_ACTIVITY: i32 = 2000;

/// The last sample of a run.
#[derive(Debug, Clone, Copy)]
pub(super) struct End {
    /// Counted from the key block on.
    pub(super) row: u64,
    pub(super) point: Point,
    /// A later run has been found to go on from here.
    pub(super) taken: bool,
}

/// One channel. Rows are indices into these lists, the block's first being [`MEMORY`].
#[derive(Debug, Default)]
pub(super) struct Track {
    pub(super) points: Vec<Point>,
    /// Coded magnitudes with their signs.
    pub(super) steps: Vec<[i16; 3]>,
    pub(super) known: Vec<bool>,
    /// First row of the run that the row before the current span belongs to.
    pub(super) run_start: usize,
    /// Averages of the magnitudes, in 1/256: of the sums by kind, and by kind and axis.
    pub(super) activity: [i32; KINDS],
    pub(super) axis_activity: [[i32; 3]; KINDS],
    pub(super) anchor: Anchor,
    pub(super) end: Option<End>,
    pub(super) fineness: Fineness,
    /// The last two choices of how to store the channel: 0 not yet, 1 no, 2 yes.
    pub(super) was_raw: usize,
    pub(super) was_fine: usize,
}

impl Track {
    /// Room for blocks of so many rows.
    pub(super) fn prepare(&mut self, n_rows: usize) {
        let rows = MEMORY + n_rows;
        self.points.reserve(rows.saturating_sub(self.points.len()));
        self.steps.reserve(rows.saturating_sub(self.steps.len()));
        self.known.reserve(rows.saturating_sub(self.known.len()));
    }

    pub(super) fn reset(&mut self) {
        self.known.fill(false);
        self.activity = Default::default();
        self.axis_activity = Default::default();
        self.anchor = Anchor::default();
        self.end = None;
        (self.was_raw, self.was_fine) = (0, 0);
    }

    /// A block of so many rows begins.
    pub(super) fn begin(&mut self, n_rows: usize) {
        self.points.resize(MEMORY + n_rows, Point::default());
        self.steps.resize(MEMORY + n_rows, [0; 3]);
        self.known.resize(MEMORY, false);
        self.known.resize(MEMORY + n_rows, false);
    }

    /// The block of so many rows is over.
    pub(super) fn finish(&mut self, n_rows: usize) {
        self.points.copy_within(n_rows.., 0);
        self.steps.copy_within(n_rows.., 0);
        self.known.copy_within(n_rows.., 0);
        self.known.truncate(MEMORY);
        self.run_start = self.run_start.saturating_sub(n_rows);
    }

    /// Coded magnitudes of a row; zero before `start`.
    pub(super) fn steps_from(&self, start: usize, row: Option<usize>) -> [i32; 3] {
        match row {
            Some(row) if row >= start && self.known[row] => self.steps[row].map(i32::from),
            _ => [0; 3],
        }
    }

    /// Stores a coded row.
    pub(super) fn settle(&mut self, row: usize, kind: usize, point: Point, steps: [i64; 3]) {
        self.points[row] = point;
        self.steps[row] = steps.map(|step| step.clamp(-1000, 1000) as i16);
        self.known[row] = true;
        let magnitudes = steps.map(|step| step.unsigned_abs().min(MAX_ACTIVITY as u64) as i32);
        let sum = magnitudes.iter().sum::<i32>();
        follow(&mut self.activity[kind], sum);
        for (activity, magnitude) in self.axis_activity[kind].iter_mut().zip(magnitudes) {
            follow(activity, magnitude);
        }
    }
}

/// A fifth of the way.
fn follow(average: &mut i32, magnitude: i32) {
    *average += ((magnitude * 256 - *average) * 51) >> 8;
}

/// A magnitude as neighbours count it.
pub(super) fn magnitude(step: i32) -> i32 {
    step.unsigned_abs().min(MAX_MAGNITUDE) as i32
}

/// The sum of the three.
pub(super) fn weight(steps: [i32; 3]) -> i32 {
    steps.map(magnitude).iter().sum()
}

//! The one path through a block that encoder and decoder share: order, prediction, contexts, state.

use std::ops::Range;

use super::{
    anchor::{Anchor, REACH},
    grid::{self, Point, STEP, UNITS_PER_TOLERANCE},
    model::{BENDS, Context, Model, NEAR, ORIGIN},
    schedule::{self, Entry, LEVELS, SPAN, WEIGHT_BITS},
};
use crate::{CodecError, coding::range::BinaryCoder};

/// Decoded rows before a block that predictions reach back to.
const MEMORY: usize = SPAN + 1;
const _: () = assert!(REACH < MEMORY && 2 * SPAN / 2 < MEMORY);

/// What an encoder and a decoder do differently.
pub(super) trait Side {
    /// Range encoder or decoder.
    type Coder: BinaryCoder;

    fn coder(&mut self) -> &mut Self::Coder;

    /// The residual to code for a row, in steps, none for a skip. A decoder has nothing to say.
    fn choose(
        &mut self,
        row: usize,
        prediction: Point,
        finest: bool,
    ) -> Result<Option<Point>, CodecError>;

    /// A row is final.
    fn settle(&mut self, row: usize, point: Point, kept: bool);
}

/// What adapts, and is taken back when a block is abandoned.
#[derive(Debug, Clone, Default)]
pub(super) struct Adaptive {
    model: Model,
    anchor: Anchor,
    /// Last decoded point of any run: where the next run is expected to start.
    last: Point,
}

/// The state of a channel, the same on both sides after every block.
#[derive(Debug)]
pub(super) struct Channel {
    pub(super) adaptive: Adaptive,
    /// [`MEMORY`] rows before the block, then the block's rows.
    points: Vec<Point>,
    /// Sum of residual magnitudes of each row, saturating.
    weights: Vec<u8>,
    /// How many of the rows right before the block are decoded and contiguous with it.
    known: usize,
}

impl Default for Channel {
    fn default() -> Self {
        schedule::prepare();
        Self {
            adaptive: Adaptive::default(),
            points: vec![Point::default(); MEMORY],
            weights: vec![0; MEMORY],
            known: 0,
        }
    }
}

impl Channel {
    /// Room for blocks of so many rows.
    pub(super) fn prepare(&mut self, n_rows: usize) {
        let rows = MEMORY + n_rows;
        self.points.reserve(rows.saturating_sub(self.points.len()));
        self.weights.reserve(rows.saturating_sub(self.weights.len()));
    }

    pub(super) fn reset(&mut self) {
        self.adaptive = Adaptive::default();
        self.break_off();
    }

    /// The rows before the next block are not known.
    pub(super) fn break_off(&mut self) {
        self.known = 0;
    }

    /// Codes all runs of a block of `n_rows`.
    pub(super) fn block<S: Side>(
        &mut self,
        side: &mut S,
        n_rows: usize,
        runs: impl Iterator<Item = Range<usize>>,
    ) -> Result<(), CodecError> {
        self.points.resize(MEMORY + n_rows, Point::default());
        self.weights.resize(MEMORY + n_rows, 0);
        let mut end = 0;
        let mut known_at_end = 0;
        for run in runs {
            // Both in rows of `points`, where row 0 of the block is at MEMORY.
            let mut known = if run.start == 0 { self.known } else { 0 };
            let (mut at, stop) = (run.start + MEMORY, run.end + MEMORY);
            if known == 0 {
                self.origin(side, at)?;
                at += 1;
                known = 1;
            }
            while at < stop {
                let m = (stop - at).min(SPAN);
                self.span(side, at - 1, m, known)?;
                at += m;
                known = (known + m).min(MEMORY);
            }
            self.adaptive.last = self.points[stop - 1];
            end = run.end;
            known_at_end = known;
        }
        self.known = if end == n_rows { known_at_end } else { 0 };
        self.points.copy_within(n_rows.., 0);
        self.weights.copy_within(n_rows.., 0);
        Ok(())
    }

    /// The first row of a run.
    fn origin<S: Side>(&mut self, side: &mut S, at: usize) -> Result<(), CodecError> {
        let context = Context { kind: ORIGIN, near: 0, bend: 0 };
        self.row(side, at, self.adaptive.last, context, false)
    }

    /// `m` rows after row `zero`, of which `known` rows up to and with `zero` are decoded.
    fn span<S: Side>(
        &mut self,
        side: &mut S,
        zero: usize,
        m: usize,
        known: usize,
    ) -> Result<(), CodecError> {
        let history = &self.points[zero + 1 - known.min(REACH + 1)..=zero];
        let (prediction, guesses) = self.adaptive.anchor.guess(history, m);
        let kind = match m {
            17.. => 1,
            5.. => 2,
            _ => 3,
        };
        let near = usize::from(self.weights[zero]).min(NEAR - 1);
        self.row(side, zero + m, prediction, Context { kind, near, bend: 0 }, m == 1)?;
        self.adaptive.anchor.score(&guesses, self.points[zero + m]);
        for entry in schedule::interior(m) {
            let (prediction, context) = self.interpolate(entry, zero, known);
            self.row(side, zero + entry.row, prediction, context, entry.stride == 1)?;
        }
        Ok(())
    }

    fn interpolate(&self, entry: &Entry, zero: usize, known: usize) -> (Point, Context) {
        let taps = entry.taps(known - 1);
        let point = |row: i32| self.points[zero.wrapping_add_signed(row as isize)];
        let weight = |row: i32| self.weights[zero.wrapping_add_signed(row as isize)];
        let base = point(taps[0].row);
        let mut prediction = base;
        let mut bend = 0;
        let (left, right) = (taps[0].row, taps[1].row);
        let far = point(right);
        for axis in 0..3 {
            let mut sum = 1_i64 << (WEIGHT_BITS - 1);
            for tap in &taps[1..] {
                let off = point(tap.row)[axis].wrapping_sub(base[axis]);
                sum = sum.wrapping_add(off.wrapping_mul(tap.weight));
            }
            let curve = sum >> WEIGHT_BITS;
            prediction[axis] = base[axis].wrapping_add(curve);
            let chord = far[axis]
                .wrapping_sub(base[axis])
                .wrapping_mul(i64::from(entry.row as i32 - left))
                .div_euclid(i64::from(right - left));
            bend = curve.wrapping_sub(chord).unsigned_abs().max(bend);
        }
        let bend = match bend.saturating_mul(8) / UNITS_PER_TOLERANCE as u64 {
            0 => 0,
            1..3 => 1,
            3..8 => 2,
            8..24 => 3,
            _ => 4,
        };
        let previous = entry.row as i32 - 2 * entry.stride as i32;
        let previous = if previous + known as i32 > 0 { weight(previous) } else { 0 };
        let parents = weight(left).max(weight(right));
        let near = match (previous, parents) {
            (0, 0) => 0,
            (0, _) | (1, 0..2) => 1,
            _ => 2,
        };
        let kind = 4 + entry.stride.ilog2() as usize;
        debug_assert!(kind < 4 + LEVELS && bend < BENDS);
        (prediction, Context { kind, near, bend })
    }

    fn row<S: Side>(
        &mut self,
        side: &mut S,
        at: usize,
        prediction: Point,
        context: Context,
        finest: bool,
    ) -> Result<(), CodecError> {
        let choice = side.choose(at - MEMORY, prediction, finest)?;
        let residual = self.adaptive.model.residual(side.coder(), context, choice)?;
        let steps = residual.unwrap_or_default();
        let point = std::array::from_fn(|axis| {
            prediction[axis].wrapping_add(steps[axis].wrapping_mul(STEP))
        });
        if !grid::in_range(point) {
            return Err(CodecError::Corrupt("a position beyond every coordinate"));
        }
        self.points[at] = point;
        self.weights[at] =
            steps.iter().fold(0, |sum: u64, s| sum + s.unsigned_abs().min(64)).min(255) as u8;
        side.settle(at - MEMORY, point, residual.is_some());
        Ok(())
    }
}

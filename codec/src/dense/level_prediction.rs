//! Prediction in time: anchors are extrapolated from the rows before them, the rows of a level are interpolated
//! between decoded rows on both sides.
//!
//! No row of a level is predicted from another row of the same level, so the predictions of a whole level can be
//! computed side by side before any of its rows is coded.

use std::ops::Range;

use super::{
    SPAN,
    lattice::{LANES, Point, floor, integers, lanes, put},
};

/// Rows before the block from which predictions are made: a whole span.
pub(super) const PAST_ROWS: usize = 64;

/// Maximum number of rows of one level in a span: those of stride 1, every other row.
const MAX_LEVEL_ROWS: usize = SPAN / 2;
const _: () = assert!(MAX_LEVEL_ROWS.is_multiple_of(LANES));

/// Length of arrays with one value per row of a span, padded so that whole vectors may be read and written at its end.
pub(super) const PADDED_SPAN: usize = SPAN + 2 * LANES;

/// Length of arrays with one value per row of a level, padded to a whole vector at its end.
pub(super) const PADDED_ROWS: usize = MAX_LEVEL_ROWS + LANES;

/// One value per row of a level.
pub(super) type PerRow = [f64; PADDED_ROWS];

/// The decoded part of a run before its anchor or one of its levels: the rows `start` to `zero`, and for levels the
/// row `end`. Rows are indices into a [`Track`](super::track::Track).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct DecodedRun {
    pub(super) channel: usize,
    pub(super) start: usize,
    pub(super) zero: usize,
    pub(super) end: usize,
}

/// The rows of one level of a run, or its anchor. Rows are indices into a [`Track`](super::track::Track).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LevelLayout {
    pub(super) first: usize,
    pub(super) step: usize,
    pub(super) n: usize,
    /// Distance from a row to its neighbours, unless the run ends before; 0 for an anchor, which has none after it.
    pub(super) stride: usize,
    pub(super) run: DecodedRun,
    pub(super) before: usize,
    /// Index of the first row in the arrays of a span, where the rows of a level are adjacent.
    pub(super) slot: usize,
}

impl LevelLayout {
    /// The rows of a level, strictly between `zero` and `end`.
    pub(super) fn level(stride: usize, run: DecodedRun, before: usize) -> Self {
        let step = 2 * stride;
        let first = (run.zero - before) / step * step + stride + before;
        let first = if first <= run.zero { first + step } else { first };
        let n = if first < run.end { (run.end - first).div_ceil(step) } else { 0 };
        Self { first, step, n, stride, run, before, slot: slot(first - before) }
    }

    /// The anchor: the last row of a run.
    pub(super) fn anchor(run: DecodedRun, before: usize) -> Self {
        Self { first: run.end, step: 1, n: 1, stride: 0, run, before, slot: slot(run.end - before) }
    }

    pub(super) fn at(&self, i: usize) -> usize {
        self.first + i * self.step
    }

    /// Up to `most` rows, from index `from` of the level on.
    pub(super) fn batch(&self, from: usize, most: usize) -> Batch {
        let n = most.min(self.n - from);
        Batch {
            channel: self.run.channel,
            first: self.at(from),
            step: self.step,
            n,
            from,
            slot: self.slot + from,
        }
    }

    /// The nearest decoded rows before and after a row; an anchor has the row before it twice.
    pub(super) fn neighbours(&self, i: usize) -> (usize, usize) {
        let (at, DecodedRun { zero, end, .. }) = (self.at(i), self.run);
        if self.stride == 0 {
            return (zero, zero);
        }
        ((at - self.stride).max(zero), (at + self.stride).min(end))
    }

    /// The rows whose neighbours on both sides are exactly a stride away.
    pub(super) fn interior(&self) -> Range<usize> {
        let from = usize::from(self.first < self.run.zero + self.stride);
        let to = self.n - usize::from(self.at(self.n - 1) + self.stride > self.run.end);
        from..to.max(from)
    }

    /// The rows with four evenly spaced neighbours, two on either side.
    fn even(&self) -> Range<usize> {
        let DecodedRun { start, zero, end, .. } = self.run;
        let least = (zero + self.stride).max(start + 3 * self.stride);
        let from = least.saturating_sub(self.first).div_ceil(self.step).min(self.n);
        let to = match end.checked_sub(3 * self.stride + self.first) {
            Some(room) => (room / self.step + 1).min(self.n),
            None => 0,
        };
        from..to.max(from)
    }
}

/// Adjacent rows of one level that are coded together.
#[derive(Debug, Clone, Copy)]
pub(super) struct Batch {
    pub(super) channel: usize,
    pub(super) first: usize,
    pub(super) step: usize,
    /// Number of rows.
    pub(super) n: usize,
    /// Index of the first row within the level, and in the arrays of a span.
    pub(super) from: usize,
    pub(super) slot: usize,
}

impl Batch {
    pub(super) fn at(&self, i: usize) -> usize {
        self.first + i * self.step
    }

    /// The `i`-th row as a row of the block.
    pub(super) fn row(&self, i: usize) -> usize {
        self.at(i) - PAST_ROWS
    }
}

/// Contexts of the signs of a row's residual, by axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hints {
    /// Side of the chord between the neighbours on which the prediction lies: 0 near it, 1 above, 2 below.
    pub(super) side: [usize; 3],
    /// Sign of the references' summed residuals: 0 near zero, 1 positive, 2 negative.
    pub(super) references_side: [usize; 3],
}

/// The predictions of all rows of a level, computed before any of them is coded.
#[derive(Debug)]
pub(super) struct LevelPrediction {
    pub(super) layout: LevelLayout,
    /// By axis, in units: the prediction in time, and the prediction corrected by the references.
    pub(super) expected: [PerRow; 3],
    pub(super) prediction: [PerRow; 3],
    /// By axis, in units: distance of the prediction in time from the chord between the two nearest neighbours.
    offs: [PerRow; 3],
    /// Class of the largest of the three distances in eighths of the tolerance: 0; 1 or 2; more.
    pub(super) bends: [u8; PADDED_ROWS],
    /// By axis, in units: the sum of the references' signed residuals.
    pub(super) reference_residuals: [PerRow; 3],
    /// Scratch memory, by axis: the decoded rows around the level.
    nodes: [PerRow; 3],
}

/// Smallest distances that count as a side, in units of 1/256 tolerance: from the chord, and of the references' sum.
const SIDE_UNITS: f64 = 40.0;
const REFERENCES_SIDE_UNITS: f64 = 30.0;

/// The side of a signed distance: 0 smaller than `least`, 1 above, 2 below.
#[inline(always)]
fn side(units: f64, least: f64) -> usize {
    usize::from(units >= least) + 2 * usize::from(units <= -least)
}

/// The class of a distance from the chord, in units: below 1/8 tolerance, below 3/8, more.
#[inline(always)]
fn bend(units: f64) -> u8 {
    u8::from(units >= 32.0) + u8::from(units >= 96.0)
}

impl LevelPrediction {
    pub(super) fn new() -> Self {
        Self {
            layout: LevelLayout::default(),
            expected: [[0.0; PADDED_ROWS]; 3],
            prediction: [[0.0; PADDED_ROWS]; 3],
            offs: [[0.0; PADDED_ROWS]; 3],
            bends: [0; PADDED_ROWS],
            reference_residuals: [[0.0; PADDED_ROWS]; 3],
            nodes: [[0.0; PADDED_ROWS]; 3],
        }
    }

    #[inline(always)]
    pub(super) fn hints(&self, i: usize) -> Hints {
        let mut hints = Hints { side: [0; 3], references_side: [0; 3] };
        for axis in 0..3 {
            let referred = self.reference_residuals[axis][i];
            hints.side[axis] = side(self.offs[axis][i], SIDE_UNITS);
            hints.references_side[axis] = side(referred, REFERENCES_SIDE_UNITS);
        }
        hints
    }

    /// Starts an anchor, whose prediction in time is known.
    pub(super) fn set_expected(&mut self, layout: LevelLayout, expected: [i64; 3]) {
        self.layout = layout;
        self.store(0, expected.map(|units| units as f64), [0.0; 3]);
    }

    /// Interpolates the last row before the end of a run where its three neighbours are evenly spaced, with Lagrange's
    /// weights (-1, 6, 3)/8; `false` where they are not.
    #[inline(always)]
    fn ends_even(&mut self, points: &[[f64; 3]], i: usize) -> bool {
        let LevelLayout { stride, run: DecodedRun { start, zero, end, .. }, .. } = self.layout;
        let at = self.layout.at(i);
        if at + stride != end || at < zero + stride || at < start + 3 * stride {
            return false;
        }
        let [before, left, right] = [points[at - 3 * stride], points[at - stride], points[end]];
        let (mut expected, mut off) = ([0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            let across = right[axis] - left[axis];
            let curve = floor((across * 3.0 - (before[axis] - left[axis]) + 4.0) * 0.125);
            expected[axis] = left[axis] + curve;
            off[axis] = curve - floor(across * 0.5);
        }
        self.store(i, expected, off);
        true
    }

    /// Interpolates a row with unevenly spaced neighbours.
    fn uneven(&mut self, points: &[[f64; 3]], i: usize) {
        let stencil = Stencil::new(self.layout.at(i), self.layout.stride, self.layout.run);
        let (expected, off) = stencil.expect(|row| integers(points[row]));
        self.store(i, expected.map(|units| units as f64), off.map(|units| units as f64));
    }

    #[inline(always)]
    fn store(&mut self, i: usize, expected: [f64; 3], off: [f64; 3]) {
        let mut largest = 0.0;
        for axis in 0..3 {
            self.expected[axis][i] = expected[axis];
            self.offs[axis][i] = off[axis];
            largest = if off[axis].abs() > largest { off[axis].abs() } else { largest };
        }
        self.bends[i] = bend(largest);
    }

    /// Interpolates all rows of the level between the decoded points of their channel.
    #[inline(always)]
    pub(super) fn interpolate(&mut self, points: &[[f64; 3]]) {
        let LevelLayout { n, step, stride, .. } = self.layout;
        let Range { start: from, end: to } = self.layout.even();
        // The evenly spaced decoded rows around; values beyond them do not matter.
        let mut row = self.layout.at(from).wrapping_sub(3 * stride);
        let nodes = if from < to { to - from + 3 } else { 0 };
        for node in 0..nodes.min(PADDED_ROWS) {
            for (axis, units) in self.nodes.iter_mut().zip(points[row]) {
                axis[node] = units;
            }
            row += step;
        }
        // The last vector may reach into unevenly spaced rows, which are overwritten below.
        for first in (from..to).step_by(LANES) {
            let mut bends = [0.0; LANES];
            for axis in 0..3 {
                let [befores, lefts, rights, afters] = [0, 1, 2, 3]
                    .map(|node| lanes::<_, LANES>(&self.nodes[axis], first - from + node));
                let (mut expected, mut offs) = ([0.0; LANES], [0.0; LANES]);
                for i in 0..LANES {
                    let (before, left) = (befores[i], lefts[i]);
                    let (right, after) = (rights[i], afters[i]);
                    let outer = (after - left) + (before - left);
                    let curve = floor(((right - left) * 9.0 - outer + 8.0) * 0.0625);
                    expected[i] = left + curve;
                    offs[i] = curve - floor((right - left) * 0.5);
                    let size = offs[i].abs();
                    bends[i] = if size > bends[i] { size } else { bends[i] };
                }
                put(&mut self.expected[axis], first, expected);
                put(&mut self.offs[axis], first, offs);
            }
            if let Some(classes) = self.bends[first..].first_chunk_mut() {
                *classes = bends.map(bend);
            }
        }
        for i in (0..from).chain(to..n) {
            if !self.ends_even(points, i) {
                self.uneven(points, i);
            }
        }
    }
}

/// Index of a row (1 to 64 of a span) in arrays where the rows of a level are adjacent: the end of a whole span, then
/// stride 32, stride 16, and so on.
pub(super) fn slot(row: usize) -> usize {
    let odd_half = (SPAN + row) >> (row.trailing_zeros() + 1);
    if row == SPAN { 0 } else { odd_half % SPAN }
}

/// The extrapolations of an anchor: (rows over which the velocity is measured, its weight in quarters).
const EXTRAPOLATORS: [(usize, i64); 7] = [(1, 0), (2, 4), (4, 4), (8, 4), (8, 2), (32, 4), (32, 2)];

/// Errors are clamped to this, in units: one jump must not decide for seconds.
const MAX_ERROR: u64 = 1 << 24;

/// Recent errors of each extrapolation by axis, in eighths of a unit: averages that forget an eighth per anchor.
#[derive(Debug, Clone, Default)]
pub(super) struct AnchorErrors {
    errors: [[u64; EXTRAPOLATORS.len()]; 3],
}

/// The extrapolations of one anchor, to be scored once the anchor is decoded.
#[derive(Debug)]
pub(super) struct Extrapolations([[i64; EXTRAPOLATORS.len()]; 3]);

impl AnchorErrors {
    /// Predicts an anchor `m` rows after row 0: on each axis by the extrapolation with the smallest recent error.
    /// `known(k)` is the point `k` rows before row 0, for `k` up to `n_before`.
    pub(super) fn extrapolate(
        &self,
        known: impl Fn(usize) -> Point,
        n_before: usize,
        m: usize,
    ) -> (Point, Extrapolations) {
        let mut extrapolations = Extrapolations(Default::default());
        let mut best = Point::default();
        let last = known(0);
        for (i, (window, quarters)) in EXTRAPOLATORS.into_iter().enumerate() {
            let window = window.min(n_before);
            let before = known(window);
            for axis in 0..3 {
                let travelled = last[axis].wrapping_sub(before[axis]);
                let advance = travelled.wrapping_mul(m as i64 * quarters);
                let advance = match window {
                    0 => 0,
                    _ if window.is_power_of_two() => advance >> (2 + window.ilog2()),
                    _ => advance.div_euclid(4 * window as i64),
                };
                extrapolations.0[axis][i] = last[axis].wrapping_add(advance);
            }
        }
        for (axis, best) in best.iter_mut().enumerate() {
            let pick = (0..EXTRAPOLATORS.len()).min_by_key(|&i| self.errors[axis][i]).unwrap_or(0);
            *best = extrapolations.0[axis][pick];
        }
        (best, extrapolations)
    }

    /// Updates the errors with the decoded anchor.
    pub(super) fn score(&mut self, extrapolations: &Extrapolations, anchor: Point) {
        for ((errors, extrapolations), anchor) in
            self.errors.iter_mut().zip(&extrapolations.0).zip(anchor)
        {
            for (error, extrapolated) in errors.iter_mut().zip(extrapolations) {
                let off = extrapolated.wrapping_sub(anchor).unsigned_abs().min(MAX_ERROR);
                // In eighths, so that the average can fall to zero.
                *error = *error - *error / 8 + off;
            }
        }
    }
}

/// Fraction bits of a stencil's weights.
const WEIGHT_BITS: u32 = 16;

/// The interpolation stencil of a row: the decoded rows around it.
///
/// Interpolates by Lagrange's polynomial through two rows on either side, with the weights (-1, 9, 9, -1)/16 on even
/// spacing. Near the ends of a run the spacing is uneven or a row is missing.
#[derive(Debug, Clone, Copy)]
struct Stencil {
    /// The row to interpolate.
    at: usize,
    /// The nearest decoded rows before it and after it.
    left: usize,
    right: usize,
    outer_right: Option<usize>,
    outer_left: Option<usize>,
}

impl Stencil {
    /// The stencil of row `at` of a level.
    fn new(at: usize, stride: usize, DecodedRun { start, zero, end, .. }: DecodedRun) -> Self {
        let left = (at - stride).max(zero);
        let right = (at + stride).min(end);
        let outer_right = Some((at + 3 * stride).min(end)).filter(|&row| row > right);
        let outer_left = match at.checked_sub(3 * stride).filter(|&row| row >= start) {
            Some(row) => Some(row),
            None if left == zero => Some(zero.saturating_sub(2 * stride).max(start)),
            None => None,
        };
        let outer_left = outer_left.filter(|&row| row < left);
        Self { at, left, right, outer_right, outer_left }
    }

    /// The interpolated point, and its distance from the chord between the two nearest neighbours, in units.
    fn expect(&self, points: impl Fn(usize) -> Point) -> (Point, Point) {
        let (base, far) = (points(self.left), points(self.right));
        let curve = self.curve(&points);
        let (before, whole) = ((self.at - self.left) as i64, (self.right - self.left) as i64);
        let (mut point, mut off) = (base, curve);
        for axis in 0..3 {
            point[axis] = base[axis].wrapping_add(curve[axis]);
            let across = far[axis].wrapping_sub(base[axis]);
            let chord = across.wrapping_mul(before).div_euclid(whole);
            off[axis] = curve[axis].wrapping_sub(chord);
        }
        (point, off)
    }

    /// The polynomial's offset from the left neighbour, in units; weights in 2^-16, rounded half up.
    fn curve(&self, points: &impl Fn(usize) -> Point) -> Point {
        let base = points(self.left);
        let nodes = [Some(self.left), Some(self.right), self.outer_right, self.outer_left];
        let mut sum = [1_i64 << (WEIGHT_BITS - 1); 3];
        for node in nodes.into_iter().skip(1).flatten() {
            let (mut numerator, mut denominator) = (1_i64 << WEIGHT_BITS, 1_i64);
            for other in nodes.into_iter().flatten().filter(|&other| other != node) {
                numerator *= self.at as i64 - other as i64;
                denominator *= node as i64 - other as i64;
            }
            if denominator < 0 {
                (numerator, denominator) = (-numerator, -denominator);
            }
            let weight = (2 * numerator + denominator).div_euclid(2 * denominator);
            let point = points(node);
            for axis in 0..3 {
                let off = point[axis].wrapping_sub(base[axis]);
                sum[axis] = sum[axis].wrapping_add(off.wrapping_mul(weight));
            }
        }
        sum.map(|sum| sum >> WEIGHT_BITS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cubic(row: usize) -> Point {
        let t = row as i64 - 40;
        [t * t * t * 64, t * t * 1024 - 7, 300 * t]
    }

    #[test]
    fn four_known_rows_reproduce_a_cubic() {
        let points: Vec<Point> = (0..200).map(cubic).collect();
        for (start, zero, end) in [(0, 64, 128), (60, 64, 128), (64, 64, 128), (0, 70, 97)] {
            for stride in [1, 2, 4, 8, 16, 32] {
                for at in (64 + stride..end).step_by(2 * stride).filter(|&at| at > zero) {
                    let stencil =
                        Stencil::new(at, stride, DecodedRun { channel: 0, start, zero, end });
                    if stencil.outer_left.is_none() || stencil.outer_right.is_none() {
                        continue;
                    }
                    let expected = stencil.expect(|row| points[row]).0;
                    for axis in 0..3 {
                        let off = (expected[axis] - points[at][axis]).abs();
                        // A weight is off by at most 2^-17.
                        let scale = points.iter().map(|p| p[axis].abs()).max().unwrap();
                        assert!(off <= 1 + scale / (1 << 14), "{stencil:?} axis {axis}: {off}");
                    }
                }
            }
        }
    }

    #[test]
    fn even_spacing_gives_the_four_point_weights() {
        let mut points = vec![[0; 3]; 33];
        points[16] = [160, 0, 0];
        let run = DecodedRun { channel: 0, start: 0, zero: 8, end: 32 };
        let weight = |at| Stencil::new(at, 2, run).expect(|row| points[row]).0[0];
        assert_eq!((weight(10), weight(14), weight(18), weight(22)), (-10, 90, 90, -10));
    }
}

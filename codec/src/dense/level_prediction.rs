//! Where rows are expected in time: the last row of a span from the rows before it, the rows of a level from the
//! decoded rows on either side.
//!
//! Rows of one level are not predicted from one another, so that all that their neighbours in time and the
//! other channels say of them can be worked out for many rows at once.

use std::ops::Range;

use super::{
    SPAN,
    points::{LANES, Point, floor, integers, lanes, put},
};

/// Rows before the block that predictions look at.
pub(super) const MEMORY: usize = 64;

/// Rows of a level in a span.
const MOST: usize = SPAN / 2;
const _: () = assert!(MOST.is_multiple_of(LANES));

/// Values of a span, and room for whole lanes behind the last.
pub(super) const PADDED: usize = SPAN + 2 * LANES;

/// Values of the rows of a level, and room for the rest of the last lanes.
pub(super) const ROOM: usize = MOST + LANES;

/// One value a row.
pub(super) type PerRow = [f64; ROOM];

/// What is decoded of a run before its anchor or a level of it: the rows from `start` to `zero`, and from its levels
/// on the row `end`. As rows of a track.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Decoded {
    pub(super) channel: usize,
    pub(super) start: usize,
    pub(super) zero: usize,
    pub(super) end: usize,
}

/// Where the rows lie. Indices are those of a track.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sites {
    pub(super) first: usize,
    pub(super) step: usize,
    pub(super) n: usize,
    /// From a row to its neighbours, where they are not nearer; 0 for none to the right.
    pub(super) stride: usize,
    pub(super) run: Decoded,
    pub(super) before: usize,
    /// The place of the first row where rows of a level lie side by side.
    pub(super) slot: usize,
}

impl Sites {
    /// The rows of a level between `zero` and `end`.
    pub(super) fn level(stride: usize, run: Decoded, before: usize) -> Self {
        let step = 2 * stride;
        let first = (run.zero - before) / step * step + stride + before;
        let first = if first <= run.zero { first + step } else { first };
        let n = if first < run.end { (run.end - first).div_ceil(step) } else { 0 };
        Self { first, step, n, stride, run, before, slot: slot(first - before) }
    }

    /// The last row of a run.
    pub(super) fn anchor(run: Decoded, before: usize) -> Self {
        Self { first: run.end, step: 1, n: 1, stride: 0, run, before, slot: slot(run.end - before) }
    }

    pub(super) fn at(&self, i: usize) -> usize {
        self.first + i * self.step
    }

    /// Some of the rows, from the one at a place on.
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

    /// The nearest decoded rows before and after a row; the same where there is none after it.
    pub(super) fn neighbours(&self, i: usize) -> (usize, usize) {
        let (at, Decoded { zero, end, .. }) = (self.at(i), self.run);
        if self.stride == 0 {
            return (zero, zero);
        }
        ((at - self.stride).max(zero), (at + self.stride).min(end))
    }

    /// The rows that have both neighbours at the stride.
    pub(super) fn whole(&self) -> Range<usize> {
        let from = usize::from(self.first < self.run.zero + self.stride);
        let to = self.n - usize::from(self.at(self.n - 1) + self.stride > self.run.end);
        from..to.max(from)
    }

    /// The rows that are expected by the four-point rule.
    fn even(&self) -> Range<usize> {
        let Decoded { start, zero, end, .. } = self.run;
        let least = (zero + self.stride).max(start + 3 * self.stride);
        let from = least.saturating_sub(self.first).div_ceil(self.step).min(self.n);
        let to = match end.checked_sub(3 * self.stride + self.first) {
            Some(room) => (room / self.step + 1).min(self.n),
            None => 0,
        };
        from..to.max(from)
    }
}

/// A few rows of one level, as rows of a track.
#[derive(Debug, Clone, Copy)]
pub(super) struct Batch {
    pub(super) channel: usize,
    pub(super) first: usize,
    pub(super) step: usize,
    /// At most as many as are coded together.
    pub(super) n: usize,
    /// The place of the first among the rows of the level, and in the span.
    pub(super) from: usize,
    pub(super) slot: usize,
}

impl Batch {
    pub(super) fn at(&self, i: usize) -> usize {
        self.first + i * self.step
    }

    /// As a row of the block.
    pub(super) fn row(&self, i: usize) -> usize {
        self.at(i) - MEMORY
    }
}

/// Classes of what is around a row that is moved, by axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hints {
    /// On which side of the chord the row is expected: 0 none to speak of, 1 above, 2 below.
    pub(super) side: [usize; 3],
    /// On which side of nothing the references are.
    pub(super) references_side: [usize; 3],
}

/// Where the rows of a level are expected, before any of them is coded.
#[derive(Debug)]
pub(super) struct LevelPrediction {
    pub(super) sites: Sites,
    /// By axis: by time alone, and with what the references say.
    pub(super) expected: [PerRow; 3],
    pub(super) prediction: [PerRow; 3],
    /// By axis: how far the expectation lies from the chord of the two near neighbours, in units.
    offs: [PerRow; 3],
    /// The class of the largest of the three, in eighths of the tolerance: 0; 1 or 2; more.
    pub(super) bends: [u8; ROOM],
    /// By axis: the residuals of the references, added up.
    pub(super) referred: [PerRow; 3],
    /// Room to work in.
    nodes: [PerRow; 3],
}

/// The sides count from here, in units.
const SIDE_UNITS: f64 = 40.0;
const REFERENCES_SIDE_UNITS: f64 = 30.0;

/// 0 near nothing, 1 above, 2 below.
#[inline(always)]
fn side(units: f64, least: f64) -> usize {
    usize::from(units >= least) + 2 * usize::from(units <= -least)
}

/// The class of a distance from the chord, in units.
#[inline(always)]
fn bend(units: f64) -> u8 {
    u8::from(units >= 32.0) + u8::from(units >= 96.0)
}

impl LevelPrediction {
    pub(super) fn new() -> Self {
        Self {
            sites: Sites::default(),
            expected: [[0.0; ROOM]; 3],
            prediction: [[0.0; ROOM]; 3],
            offs: [[0.0; ROOM]; 3],
            bends: [0; ROOM],
            referred: [[0.0; ROOM]; 3],
            nodes: [[0.0; ROOM]; 3],
        }
    }

    #[inline(always)]
    pub(super) fn hints(&self, i: usize) -> Hints {
        let mut hints = Hints { side: [0; 3], references_side: [0; 3] };
        for axis in 0..3 {
            hints.side[axis] = side(self.offs[axis][i], SIDE_UNITS);
            hints.references_side[axis] = side(self.referred[axis][i], REFERENCES_SIDE_UNITS);
        }
        hints
    }

    /// Rows that have neighbours on one side only.
    pub(super) fn guessed(&mut self, sites: Sites, expected: [i64; 3]) {
        self.sites = sites;
        self.store(0, expected.map(|units| units as f64), [0.0; 3]);
    }

    /// The last row before the end of a run, where the three rows around it are as far apart as those of the others:
    /// (-1, 6, 3)/8 are Lagrange's weights.
    #[inline(always)]
    fn ends_even(&mut self, points: &[[f64; 3]], i: usize) -> bool {
        let Sites { stride, run: Decoded { start, zero, end, .. }, .. } = self.sites;
        let at = self.sites.at(i);
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

    /// What is not evenly spaced.
    fn uneven(&mut self, points: &[[f64; 3]], i: usize) {
        let stencil = Stencil::new(self.sites.at(i), self.sites.stride, self.sites.run);
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

    /// Interpolates all rows between the points of a channel.
    #[inline(always)]
    pub(super) fn interpolate(&mut self, points: &[[f64; 3]]) {
        let Sites { n, step, stride, .. } = self.sites;
        let Range { start: from, end: to } = self.sites.even();
        // The decoded rows around, evenly spaced; what is beyond them counts for nothing.
        let mut row = self.sites.at(from).wrapping_sub(3 * stride);
        let nodes = if from < to { to - from + 3 } else { 0 };
        for node in 0..nodes.min(ROOM) {
            for (axis, units) in self.nodes.iter_mut().zip(points[row]) {
                axis[node] = units;
            }
            row += step;
        }
        // The last lanes may reach into rows that are not even: those come after.
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

/// The place of a row (1 to 64 of a span) where the rows of a level lie side by side: the end of a whole
/// span, stride 32, stride 16, and so on.
fn slot(row: usize) -> usize {
    let odd_half = (SPAN + row) >> (row.trailing_zeros() + 1);
    if row == SPAN { 0 } else { odd_half % SPAN }
}

/// (rows that the velocity is measured over, its weight in quarters).
const GUESSES: [(usize, i64); 7] = [(1, 0), (2, 4), (4, 4), (8, 4), (8, 2), (32, 4), (32, 2)];

/// An error beyond this counts as this much: one jump must not decide for seconds.
const MAX_ERROR: u64 = 1 << 24;

/// How far each guess was off lately, per axis: an average that forgets an eighth a span.
#[derive(Debug, Clone, Default)]
pub(super) struct AnchorErrors {
    errors: [[u64; GUESSES.len()]; 3],
}

/// The guesses for one span, to be scored once its anchor is known.
#[derive(Debug)]
pub(super) struct Guesses([[i64; GUESSES.len()]; 3]);

impl AnchorErrors {
    /// `known` gives a row so far before row 0, up to `n_before`; `m` is the distance to the anchor.
    pub(super) fn guess(
        &self,
        known: impl Fn(usize) -> Point,
        n_before: usize,
        m: usize,
    ) -> (Point, Guesses) {
        let mut guesses = Guesses(Default::default());
        let mut best = Point::default();
        let last = known(0);
        for (i, (window, quarters)) in GUESSES.into_iter().enumerate() {
            let window = window.min(n_before);
            let before = known(window);
            for axis in 0..3 {
                let travelled = last[axis].wrapping_sub(before[axis]);
                let ahead = travelled.wrapping_mul(m as i64 * quarters);
                let ahead = match window {
                    0 => 0,
                    _ if window.is_power_of_two() => ahead >> (2 + window.ilog2()),
                    _ => ahead.div_euclid(4 * window as i64),
                };
                guesses.0[axis][i] = last[axis].wrapping_add(ahead);
            }
        }
        for (axis, best) in best.iter_mut().enumerate() {
            let pick = (0..GUESSES.len()).min_by_key(|&i| self.errors[axis][i]).unwrap_or(0);
            *best = guesses.0[axis][pick];
        }
        (best, guesses)
    }

    /// Remembers how far each guess was from the decoded anchor.
    pub(super) fn score(&mut self, guesses: &Guesses, anchor: Point) {
        for ((errors, guesses), anchor) in self.errors.iter_mut().zip(&guesses.0).zip(anchor) {
            for (error, guess) in errors.iter_mut().zip(guesses) {
                let off = guess.wrapping_sub(anchor).unsigned_abs().min(MAX_ERROR);
                // In eighths, so that the average does not stall above zero.
                *error = *error - *error / 8 + off;
            }
        }
    }
}

/// Fraction bits of a stencil's weights.
const WEIGHT_BITS: u32 = 16;

/// From which rows a row is interpolated.
///
/// The polynomial through two rows on either side (Lagrange), which on even spacing is
/// (-1, 9, 9, -1)/16. Near the ends of a run the spacing is uneven, or there is one row less.
#[derive(Debug, Clone, Copy)]
struct Stencil {
    /// The row.
    at: usize,
    /// The nearest decoded rows before it and after it.
    left: usize,
    right: usize,
    outer_right: Option<usize>,
    outer_left: Option<usize>,
}

impl Stencil {
    /// For row `at` of a level.
    fn new(at: usize, stride: usize, Decoded { start, zero, end, .. }: Decoded) -> Self {
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

    /// Interpolates: the point, and how far it lies from the chord of the two near neighbours, in units.
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

    /// Distance of the polynomial from the left neighbour, weights in 2^-16 rounded half up.
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
    fn cubics_are_met_wherever_four_rows_are_known() {
        let points: Vec<Point> = (0..200).map(cubic).collect();
        for (start, zero, end) in [(0, 64, 128), (60, 64, 128), (64, 64, 128), (0, 70, 97)] {
            for stride in [1, 2, 4, 8, 16, 32] {
                for at in (64 + stride..end).step_by(2 * stride).filter(|&at| at > zero) {
                    let stencil =
                        Stencil::new(at, stride, Decoded { channel: 0, start, zero, end });
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
    fn even_spacing_is_the_four_point_rule() {
        let mut points = vec![[0; 3]; 33];
        points[16] = [160, 0, 0];
        let run = Decoded { channel: 0, start: 0, zero: 8, end: 32 };
        let weight = |at| Stencil::new(at, 2, run).expect(|row| points[row]).0[0];
        assert_eq!((weight(10), weight(14), weight(18), weight(22)), (-10, 90, 90, -10));
    }
}

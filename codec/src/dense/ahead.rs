//! What is known of the rows of a run of one level before any of them is coded.
//!
//! Rows of one level are not predicted from one another, so that all that their neighbours in time and the
//! other channels say of them can be worked out for many rows at once.

use crate::coding::isa::Kernel;

use super::{
    SPAN,
    lengths::PARTNERS,
    taps::{SIDE_UNITS, Site},
    track::{Track, slot},
    weave::{REFERENCES, References, Weave},
};

/// Rows of a level in a span.
pub(super) const MOST: usize = SPAN / 2;

/// One value a row.
pub(super) type PerRow = [f64; MOST];

/// Where the rows lie. Indices are those of a track.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sites {
    pub(super) first: usize,
    pub(super) step: usize,
    pub(super) n: usize,
    /// From a row to its neighbours, where they are not nearer; 0 for none to the right.
    pub(super) stride: usize,
    pub(super) start: usize,
    pub(super) zero: usize,
    pub(super) end: usize,
    pub(super) before: usize,
    /// The place of the first row where rows of a level lie side by side.
    pub(super) slot: usize,
}

impl Sites {
    /// The rows of a level between `zero` and `end`.
    pub(super) fn level(
        stride: usize,
        (start, zero, end): (usize, usize, usize),
        before: usize,
    ) -> Self {
        let step = 2 * stride;
        let first = (zero - before) / step * step + stride + before;
        let first = if first <= zero { first + step } else { first };
        let n = if first < end { (end - first).div_ceil(step) } else { 0 };
        let slot = slot(first - before);
        Self { first, step, n, stride, start, zero, end, before, slot }
    }

    /// The last row of a run.
    pub(super) fn anchor((start, zero, end): (usize, usize, usize), before: usize) -> Self {
        let slot = slot(end - before);
        Self { first: end, step: 1, n: 1, stride: 0, start, zero, end, before, slot }
    }

    pub(super) fn at(&self, i: usize) -> usize {
        self.first + i * self.step
    }

    /// The nearest decoded rows before and after a row; the same where there is none after it.
    pub(super) fn neighbours(&self, i: usize) -> (usize, usize) {
        let at = self.at(i);
        if self.stride == 0 {
            return (self.zero, self.zero);
        }
        ((at - self.stride).max(self.zero), (at + self.stride).min(self.end))
    }

    /// The rows that are expected by the four-point rule.
    fn even(&self) -> (usize, usize) {
        let least = (self.zero + self.stride).max(self.start + 3 * self.stride);
        let from = least.saturating_sub(self.first).div_ceil(self.step).min(self.n);
        let to = match self.end.checked_sub(3 * self.stride + self.first) {
            Some(room) => (room / self.step + 1).min(self.n),
            None => 0,
        };
        (from, to.max(from))
    }
}

/// The rows of a run.
#[derive(Debug)]
pub(super) struct Ahead {
    pub(super) sites: Sites,
    /// By axis: by time alone, and with what the references say.
    pub(super) expected: [PerRow; 3],
    pub(super) prediction: [PerRow; 3],
    /// See [`Expected`](super::taps::Expected).
    pub(super) bend: [u8; MOST],
    pub(super) side: [[u8; MOST]; 3],
    /// On which side of nothing the references are.
    pub(super) references_side: [[u8; MOST]; 3],
    /// The distances that the partners should have; NaN where nothing says so.
    pub(super) lengths: [PerRow; PARTNERS],
}

impl Ahead {
    pub(super) fn new() -> Self {
        Self {
            sites: Sites::default(),
            expected: [[0.0; MOST]; 3],
            prediction: [[0.0; MOST]; 3],
            bend: [0; MOST],
            side: [[0; MOST]; 3],
            references_side: [[0; MOST]; 3],
            lengths: [[f64::NAN; MOST]; PARTNERS],
        }
    }

    /// Rows that have neighbours on one side only.
    pub(super) fn guessed(&mut self, sites: Sites, expected: [i64; 3]) {
        self.sites = sites;
        for axis in 0..3 {
            self.expected[axis][0] = expected[axis] as f64;
            self.side[axis][0] = 0;
        }
        self.bend[0] = 0;
    }

    /// What is not evenly spaced.
    fn uneven(&mut self, track: &Track, i: usize) {
        let Sites { stride, start, zero, end, .. } = self.sites;
        let site = Site::new(self.sites.at(i), stride, (start, zero, end));
        let expected = site.expect(|row| track.point(row));
        for axis in 0..3 {
            self.expected[axis][i] = expected.point[axis] as f64;
            self.side[axis][i] = expected.side[axis] as u8;
        }
        self.bend[i] = expected.bend as u8;
    }
}

/// The largest integer that is not above `value`, which is below 2^51 in size.
#[inline(always)]
pub(super) fn floor(value: f64) -> f64 {
    /// A sum with it has no room for a fraction.
    const WHOLE: f64 = (3_u64 << 51) as f64;
    let near = (value + WHOLE) - WHOLE;
    near - if near > value { 1.0 } else { 0.0 }
}

/// Interpolates all rows.
#[derive(Debug)]
pub(super) struct Interpolating<'a> {
    pub(super) ahead: &'a mut Ahead,
    pub(super) track: &'a Track,
}

impl Kernel for Interpolating<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { ahead, track } = self;
        let Sites { n, step, stride, .. } = ahead.sites;
        let (from, to) = ahead.sites.even();
        (0..from).chain(to..n).for_each(|i| ahead.uneven(track, i));
        if from == to {
            return;
        }
        let mut bends = [0.0; MOST];
        for axis in 0..3 {
            // The decoded rows around, evenly spaced.
            let mut nodes = [0.0; MOST + 3];
            let rows = &track.points[axis][ahead.sites.at(from) - 3 * stride..];
            for (node, row) in nodes[..to - from + 3].iter_mut().zip(rows.iter().step_by(step)) {
                *node = *row;
            }
            let (expected, side) = (&mut ahead.expected[axis][from..to], &mut ahead.side[axis]);
            for i in 0..to - from {
                let [before, left, right, after] =
                    [nodes[i], nodes[i + 1], nodes[i + 2], nodes[i + 3]];
                let outer = (after - left) + (before - left);
                let curve = floor(((right - left) * 9.0 - outer + 8.0) * 0.0625);
                expected[i] = left + curve;
                let off = curve - floor((right - left) * 0.5);
                let size = off.abs();
                bends[i] = if size > bends[i] { size } else { bends[i] };
                let above = if off > 0.0 { 1 } else { 2 };
                side[from + i] = if size >= SIDE_UNITS as f64 { above } else { 0 };
            }
        }
        for (bend, size) in ahead.bend[from..to].iter_mut().zip(bends) {
            // In eighths of the tolerance: 0; 1 or 2; more.
            *bend = u8::from(size >= 32.0) + u8::from(size >= 96.0);
        }
    }
}

/// What the references say of all rows.
#[derive(Debug)]
pub(super) struct Referring<'a> {
    pub(super) ahead: &'a mut Ahead,
    pub(super) weave: &'a Weave,
    pub(super) references: &'a References,
}

impl Kernel for Referring<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { ahead, weave, references } = self;
        let Sites { n, slot, .. } = ahead.sites;
        let found = references.n.min(REFERENCES);
        for axis in 0..3 {
            let (mut sums, mut sides) = ([0.0; MOST], [0.0; MOST]);
            for i in 0..found {
                let residuals = &weave.by_channel[references.channels[i]].0[axis][slot..slot + n];
                let (weight, sign) = (references.weights[i], references.signs[i]);
                for ((sum, side), residual) in sums.iter_mut().zip(&mut sides).zip(residuals) {
                    *sum += weight * residual;
                    *side += residual * sign;
                }
            }
            for i in 0..n {
                ahead.prediction[axis][i] = ahead.expected[axis][i] + floor(sums[i] + 0.5);
                ahead.references_side[axis][i] =
                    u8::from(sides[i] >= 30.0) + 2 * u8::from(sides[i] <= -30.0);
            }
        }
    }
}

//! What is known of the rows of a run of one level before any of them is coded.
//!
//! Rows of one level are not predicted from one another, so that all that their neighbours in time and the
//! other channels say of them can be worked out for many rows at once.

use crate::coding::isa::Kernel;

use super::{
    SPAN,
    lattice::{floor, round},
    lengths::PARTNERS,
    taps::{SIDE_UNITS, Site},
    track::{Track, slot},
    weave::{REFERENCES, References, Weave},
};

/// Rows of a level in a span.
pub(super) const MOST: usize = SPAN / 2;

/// Rows side by side.
pub(super) const LANES: usize = 4;
const _: () = assert!(MOST.is_multiple_of(LANES));

/// Values of a span, and room for whole lanes behind the last.
pub(super) const PADDED: usize = SPAN + 2 * LANES;

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

/// Classes of what is around a row.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Hints {
    /// See [`Expected`](super::taps::Expected).
    pub(super) bend: u8,
    pub(super) side: [u8; 3],
    /// On which side of nothing the references are.
    pub(super) references_side: [u8; 3],
}

/// The rows of a run.
#[derive(Debug)]
pub(super) struct Ahead {
    pub(super) sites: Sites,
    /// By axis: by time alone, and with what the references say.
    pub(super) expected: [PerRow; 3],
    pub(super) prediction: [PerRow; 3],
    pub(super) hints: [Hints; MOST],
    /// The distances that the partners should have; NaN where nothing says so.
    pub(super) lengths: [PerRow; PARTNERS],
    /// Room to work in.
    spill: [PerRow; 3],
    offs: [PerRow; 3],
}

impl Ahead {
    pub(super) fn new() -> Self {
        Self {
            sites: Sites::default(),
            expected: [[0.0; MOST]; 3],
            prediction: [[0.0; MOST]; 3],
            hints: [Hints::default(); MOST],
            lengths: [[f64::NAN; MOST]; PARTNERS],
            spill: [[0.0; MOST]; 3],
            offs: [[0.0; MOST]; 3],
        }
    }

    /// Rows that have neighbours on one side only.
    pub(super) fn guessed(&mut self, sites: Sites, expected: [i64; 3]) {
        self.sites = sites;
        for (lane, units) in self.expected.iter_mut().zip(expected) {
            lane[0] = units as f64;
        }
        self.hints[0] = Hints::default();
    }

    /// What is not evenly spaced.
    fn uneven(&mut self, track: &Track, i: usize) {
        let Sites { stride, start, zero, end, .. } = self.sites;
        let site = Site::new(self.sites.at(i), stride, (start, zero, end));
        let expected = site.expect(|row| track.point(row));
        for axis in 0..3 {
            self.expected[axis][i] = expected.point[axis] as f64;
        }
        self.hints[i].side = expected.side.map(|side| side as u8);
        self.hints[i].bend = expected.bend as u8;
    }
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
        let rows = to - from;
        let mut bends = [[0.0; LANES]; MOST / LANES];
        for axis in 0..3 {
            // The decoded rows around, evenly spaced; what is beyond them counts for nothing.
            let mut nodes = [0.0; MOST + LANES];
            let points = &track.points[ahead.sites.at(from) - 3 * stride..];
            for (node, row) in nodes[..rows + 3].iter_mut().zip(points.chunks(step)) {
                *node = row[0][axis];
            }
            for (block, bends) in bends[..rows.div_ceil(LANES)].iter_mut().enumerate() {
                let first = block * LANES;
                let [befores, lefts, rights, afters] =
                    [0, 1, 2, 3].map(|node| lanes::<LANES>(&nodes, first + node));
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
                ahead.spill[axis][first..first + LANES].copy_from_slice(&expected);
                ahead.offs[axis][first..first + LANES].copy_from_slice(&offs);
            }
            ahead.expected[axis][from..to].copy_from_slice(&ahead.spill[axis][..rows]);
            for (hints, off) in ahead.hints[from..to].iter_mut().zip(&ahead.offs[axis]) {
                hints.side[axis] =
                    u8::from(*off >= SIDE_UNITS as f64) + 2 * u8::from(*off <= -SIDE_UNITS as f64);
            }
        }
        for (hints, size) in ahead.hints[from..to].iter_mut().zip(bends.as_flattened()) {
            // In eighths of the tolerance: 0; 1 or 2; more.
            hints.bend = u8::from(*size >= 32.0) + u8::from(*size >= 96.0);
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
            for first in (0..n).step_by(LANES) {
                let (mut sums, mut sides) = ([0.0; LANES], [0.0; LANES]);
                for i in 0..found {
                    let by_channel = &weave.by_channel[references.channels[i]].0;
                    let residuals: [f32; LANES] =
                        by_channel[axis][slot + first..].first_chunk().copied().unwrap_or_default();
                    let residuals = residuals.map(f64::from);
                    let (weight, sign) = (references.weights[i], references.signs[i]);
                    for lane in 0..LANES {
                        let weighed = weight * residuals[lane];
                        sums[lane] += weighed;
                        sides[lane] += residuals[lane] * sign;
                    }
                }
                let expected: [f64; LANES] = lanes(&ahead.expected[axis], first);
                let prediction: [f64; LANES] =
                    std::array::from_fn(|lane| expected[lane] + round(sums[lane]));
                ahead.prediction[axis][first..first + LANES].copy_from_slice(&prediction);
                for (hints, side) in ahead.hints[first..first + LANES].iter_mut().zip(sides) {
                    hints.references_side[axis] =
                        u8::from(side >= 30.0) + 2 * u8::from(side <= -30.0);
                }
            }
        }
    }
}

/// Some rows side by side; the lanes are long enough.
#[inline(always)]
pub(super) fn lanes<const N: usize>(values: &[f64], first: usize) -> [f64; N] {
    values[first..].first_chunk().copied().unwrap_or([0.0; N])
}

//! What is known of the rows of a run of one level before any of them is coded.
//!
//! Rows of one level are not predicted from one another, so that all that their neighbours in time and the
//! other channels say of them can be worked out for many rows at once.

use super::{
    SPAN,
    lattice::{Point, floor, round},
    lengths::PARTNERS,
    taps::Site,
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

/// Values of the rows of a level, and room for the rest of the last lanes.
pub(super) const ROOM: usize = MOST + LANES;

/// One value a row.
pub(super) type PerRow = [f64; ROOM];

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

    /// The rows that have both neighbours at the stride.
    pub(super) fn whole(&self) -> (usize, usize) {
        let from = usize::from(self.first < self.zero + self.stride);
        let to = self.n - usize::from(self.at(self.n - 1) + self.stride > self.end);
        (from, to.max(from))
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

/// Classes of what is around a row that is moved, by axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hints {
    /// On which side of the chord the row is expected: 0 none to speak of, 1 above, 2 below.
    pub(super) side: [usize; 3],
    /// On which side of nothing the references are.
    pub(super) references_side: [usize; 3],
}

/// The rows of a run.
#[derive(Debug)]
pub(super) struct Ahead {
    pub(super) sites: Sites,
    /// By axis: by time alone, and with what the references say.
    pub(super) expected: [PerRow; 3],
    pub(super) prediction: [PerRow; 3],
    /// The distances that the partners should have; NaN where nothing says so.
    pub(super) lengths: [PerRow; PARTNERS],
    /// By axis: how far the expectation lies from the chord of the two near neighbours, in units.
    offs: [PerRow; 3],
    /// The class of the largest of the three, in eighths of the tolerance: 0; 1 or 2; more.
    pub(super) bends: [u8; ROOM],
    /// By axis: the residuals of the references, added up.
    referred: [PerRow; 3],
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

impl Ahead {
    pub(super) fn new() -> Self {
        Self {
            sites: Sites::default(),
            expected: [[0.0; ROOM]; 3],
            prediction: [[0.0; ROOM]; 3],
            lengths: [[f64::NAN; ROOM]; PARTNERS],
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
        self.store(0, expected, [0; 3]);
    }

    /// The last row before the end of a run, where the three rows around it are as far apart as those of the others:
    /// (-1, 6, 3)/8 are Lagrange's weights.
    #[inline(always)]
    fn ends_even(&mut self, track: &Track, i: usize) -> bool {
        let Sites { stride, start, zero, end, .. } = self.sites;
        let at = self.sites.at(i);
        if at + stride != end || at < zero + stride || at < start + 3 * stride {
            return false;
        }
        let [before, left, right] = [at - 3 * stride, at - stride, end].map(|row| track.at(row));
        let mut largest = 0.0;
        for axis in 0..3 {
            let across = right[axis] - left[axis];
            let curve = floor((across * 3.0 - (before[axis] - left[axis]) + 4.0) * 0.125);
            let off = curve - floor(across * 0.5);
            self.expected[axis][i] = left[axis] + curve;
            self.offs[axis][i] = off;
            largest = if off.abs() > largest { off.abs() } else { largest };
        }
        self.bends[i] = bend(largest);
        true
    }

    /// What is not evenly spaced.
    fn uneven(&mut self, track: &Track, i: usize) {
        let Sites { stride, start, zero, end, .. } = self.sites;
        let site = Site::new(self.sites.at(i), stride, (start, zero, end));
        let expected = site.expect(|row| track.point(row));
        self.store(i, expected.point, expected.off);
    }

    fn store(&mut self, i: usize, expected: Point, off: Point) {
        let mut largest = 0.0_f64;
        for axis in 0..3 {
            self.expected[axis][i] = expected[axis] as f64;
            self.offs[axis][i] = off[axis] as f64;
            largest = largest.max((off[axis] as f64).abs());
        }
        self.bends[i] = bend(largest);
    }
}

impl Ahead {
    /// Interpolates all rows.
    #[inline(always)]
    pub(super) fn interpolate(&mut self, track: &Track) {
        let ahead = self;
        let Sites { n, step, stride, .. } = ahead.sites;
        let (from, to) = ahead.sites.even();
        // The decoded rows around, evenly spaced; what is beyond them counts for nothing.
        let mut row = ahead.sites.at(from).wrapping_sub(3 * stride);
        let nodes = if from < to { to - from + 3 } else { 0 };
        for node in 0..nodes.min(ROOM) {
            let point = track.points[row];
            for (axis, units) in ahead.nodes.iter_mut().zip(point) {
                axis[node] = units;
            }
            row += step;
        }
        // The last lanes may reach into rows that are not even: those come after.
        for first in (from..to).step_by(LANES) {
            let mut bends = [0.0; LANES];
            for axis in 0..3 {
                let [befores, lefts, rights, afters] = [0, 1, 2, 3]
                    .map(|node| lanes::<_, LANES>(&ahead.nodes[axis], first - from + node));
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
                put(&mut ahead.expected[axis], first, expected);
                put(&mut ahead.offs[axis], first, offs);
            }
            if let Some(classes) = ahead.bends[first..].first_chunk_mut() {
                *classes = bends.map(bend);
            }
        }
        for i in (0..from).chain(to..n) {
            if !ahead.ends_even(track, i) {
                ahead.uneven(track, i);
            }
        }
    }
}

impl Ahead {
    /// Adds what the references say of all rows.
    #[inline(always)]
    pub(super) fn refer(&mut self, weave: &Weave, references: &References) {
        let ahead = self;
        let Sites { n, slot, .. } = ahead.sites;
        let found = references.n.min(REFERENCES);
        for first in (0..n).step_by(LANES) {
            for axis in 0..3 {
                let (mut sums, mut referred) = ([0.0; LANES], [0.0; LANES]);
                for i in 0..found {
                    let by_channel = &weave.by_channel[references.channels[i]].0;
                    let residuals: [f32; LANES] = lanes(&by_channel[axis], slot + first);
                    let residuals = residuals.map(f64::from);
                    let (weight, sign) = (references.weights[i], references.signs[i]);
                    for lane in 0..LANES {
                        let weighed = weight * residuals[lane];
                        sums[lane] += weighed;
                        referred[lane] += residuals[lane] * sign;
                    }
                }
                let expected: [f64; LANES] = lanes(&ahead.expected[axis], first);
                let prediction = std::array::from_fn(|lane| expected[lane] + round(sums[lane]));
                put(&mut ahead.prediction[axis], first, prediction);
                put(&mut ahead.referred[axis], first, referred);
            }
        }
    }
}

/// Stores some rows side by side; there is room.
#[inline(always)]
pub(super) fn put(values: &mut [f64], first: usize, lanes: [f64; LANES]) {
    if let Some(values) = values[first..].first_chunk_mut() {
        *values = lanes;
    }
}

/// Some rows side by side; the lanes are long enough.
#[inline(always)]
pub(super) fn lanes<T: Copy + Default, const N: usize>(values: &[T], first: usize) -> [T; N] {
    let mut lanes = [T::default(); N];
    lanes.copy_from_slice(&values[first..first + N]);
    lanes
}

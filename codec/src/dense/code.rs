//! The rows of one level and run: what their references and partners say, their residuals, and what is
//! learnt from them.

use super::{
    ahead::{LANES, Sites, lanes},
    lattice::{self, Lattice, Point},
    layout::INTERPOLATED,
    row::{self, Near, Residual},
    track::{Steps, follow, slot},
    walk::{Batch, Group, Question, Side},
};
use crate::{CodecError, coding::isa::Kernel};

/// Rows of a fine level that are held against the partners together: what they teach holds for those after them.
/// Of other levels there are no more than [`LANES`].
pub(super) const TOGETHER: usize = 8;

/// Copies the first `n` of some values to where there is room for all.
#[inline(always)]
pub(super) fn copy<T: Copy, const N: usize>(values: &[T; N], out: &mut [T], n: usize) {
    match out.first_chunk_mut() {
        // Most often: one store.
        Some(out) if n == N => *out = *values,
        Some(out) => {
            for i in 0..N {
                if i < n {
                    out[i] = values[i];
                }
            }
        }
        None => {}
    }
}

/// Strides 1, 2 and 4, which are off by little.
const FINE: std::ops::Range<usize> = INTERPOLATED..INTERPOLATED + 3;

/// Points of some rows by axis, in units.
pub(super) type Points<const N: usize> = [[f64; N]; 3];

impl Group {
    /// The rows that are [`ahead`](Self::ahead): of anchors it is known where time alone puts them.
    pub(super) fn rows<S: Side>(
        &mut self,
        side: &mut S,
        channel: usize,
        kind: usize,
    ) -> Result<(), CodecError> {
        let isa = self.isa;
        if FINE.contains(&kind) {
            isa.run(Level::<S, TOGETHER, false> { group: self, side, channel, kind })
        } else {
            isa.run(Level::<S, LANES, true> { group: self, side, channel, kind })
        }
    }

    /// The marks of the references, summed, at some rows that lie side by side.
    #[inline(always)]
    fn referred<const N: usize>(&self, channel: usize, class: usize, slot: usize) -> [u64; N] {
        let found = self.weave.references(class, channel);
        let marks = |k: usize| -> [u64; N] { lanes(&self.tracks[k].marks.0, slot) };
        if found.n == 0 && channel > 0 {
            return marks(channel - 1).map(|marks| 2 * marks);
        }
        let mut sums = [0; N];
        for &k in &found.channels[..found.n] {
            for (sum, marks) in sums.iter_mut().zip(marks(k)) {
                *sum += marks;
            }
        }
        sums
    }

    /// Stores a first row.
    pub(super) fn settle_first<S: Side>(
        &mut self,
        side: &mut S,
        (channel, at, before): (usize, usize, usize),
        kind: usize,
        (point, magnitudes): (Point, Point),
    ) -> Result<(), CodecError> {
        let points = point.map(|units| [units as f64; 1]);
        let batch = Batch { first: at, step: 1, n: 1, from: 0 };
        side.ahead(channel, &Sites::anchor((at, at, at), before));
        let track = &mut self.tracks[channel];
        let mut activity = track.activity[kind];
        track.keep((at, slot(at - before)), magnitudes, &mut activity);
        track.activity[kind] = activity;
        self.settle(side, channel, (batch, slot(at - before)), (&points, 1))
    }

    /// Stores the points of some rows, of which those are kept whose bit is set.
    #[inline(always)]
    fn settle<S: Side, const N: usize>(
        &mut self,
        side: &mut S,
        channel: usize,
        (batch, slot): (Batch, usize),
        (points, kept): (&Points<N>, u32),
    ) -> Result<(), CodecError> {
        if !lattice::in_range(points, batch.n) {
            return Err(CodecError::Corrupt("a position beyond every coordinate"));
        }
        self.tracks[channel].settle(batch, slot, points);
        side.settle(channel, batch, points, kept);
        Ok(())
    }

    /// Codes some of the rows that are ahead: those from `from` to `to`, `N` at most.
    #[inline(always)]
    fn code<S: Side, const N: usize, const FAR: bool>(
        &mut self,
        side: &mut S,
        (channel, kind, class): (usize, usize, usize),
        (from, to): (usize, usize),
    ) -> Result<(), CodecError> {
        let sites = self.ahead.sites;
        let slot = sites.slot + from;
        let batch = Batch { first: sites.at(from), step: sites.step, n: to - from, from };
        let referred = self.referred::<N>(channel, class, slot);
        let shares = self.lengths.shares(channel, kind);
        let (partners, n_partners) = self.lengths.partners(channel);
        let partners = &partners.map(|k| &self.tracks[k])[..n_partners];
        let mut points = self.pulls.pull::<N, FAR>(&self.ahead, partners, shares, from);
        let outside = side.outside(channel, batch, &points);
        let track = &mut self.tracks[channel];
        let mut activity = track.activity[kind];
        let mut kept = 0;
        let levels = sites.stride > 0;
        let only = |steps: Steps| if levels { steps } else { Steps::default() };
        // What is right of a row is left of the next, and what is before it was the row itself.
        let mut left = track.steps[sites.neighbours(from).0];
        let mut before = only(track.steps_from(sites.start, batch.first, 2 * sites.stride));
        let mut before_that = only(track.steps_from(sites.start, batch.first, 4 * sites.stride));
        for i in 0..batch.n.min(N) {
            let at = batch.at(i);
            let right = only(track.steps[(at + sites.stride).min(sites.end)]);
            let near =
                Near { kind, left, right, before, before_that, references: referred[i], activity };
            left = right;
            before_that = before;
            before = Steps::default();
            let mut steps = [0; 3];
            if outside >> i & 1 == 1 {
                let lattice = Lattice::of(&activity);
                let [x, y, z, _] = activity;
                steps = side.choose(Question {
                    place: from + i,
                    prediction: points.each_ref().map(|axis| axis[i]),
                    kind,
                    lattice,
                    fineness: track.fineness,
                    activity: [x, y, z],
                    last_level: kind == 4 || (kind < 4 && at == sites.zero + 1),
                });
            }
            let moved = steps != [0; 3];
            let bend = self.ahead.bends[from + i];
            if !row::moving(side.coder(), &mut self.model, &near, bend, moved) {
                follow(&mut activity, [0; 4]);
                continue;
            }
            let lattice = Lattice::of(&activity);
            let hints = self.ahead.hints(from + i);
            let coded = self.isa.run(Residual {
                coder: side.coder(),
                model: &mut self.model,
                near: &near,
                hints: &hints,
                lattice,
                steps,
            })?;
            let step = track.fineness.step(lattice);
            for (axis, steps) in points.iter_mut().zip(coded.0) {
                axis[i] = (axis[i] as i64).wrapping_add(steps.wrapping_mul(step)) as f64;
            }
            kept |= 1 << i;
            before = track.keep((at, slot + i), coded.1, &mut activity);
            let expected = self.ahead.prediction.each_ref().map(|axis| axis[from + i]);
            let point = points.each_ref().map(|axis| axis[i]);
            let shares = self.lengths.shares_mut(channel, kind);
            self.pulls.score(i, (expected, point), shares);
        }
        track.activity[kind] = activity;
        let mut residuals = points;
        for (residuals, expected) in residuals.iter_mut().zip(&self.ahead.expected) {
            let expected: [f64; N] = lanes(expected, from);
            for i in 0..N {
                residuals[i] -= expected[i];
            }
        }
        self.weave.remember(channel, (slot, batch.n), &mut residuals);
        self.settle(side, channel, (batch, slot), (&points, kept))
    }
}

/// Codes the rows that are ahead, so many together.
#[derive(Debug)]
struct Level<'a, S, const N: usize, const FAR: bool> {
    group: &'a mut Group,
    side: &'a mut S,
    channel: usize,
    kind: usize,
}

impl<S: Side, const N: usize, const FAR: bool> Kernel for Level<'_, S, N, FAR> {
    type Output = Result<(), CodecError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { group, side, channel, kind } = self;
        let class = [0, 0, 0, 0, 4, 3, 2].get(kind).copied().unwrap_or(1);
        side.ahead(channel, &group.ahead.sites);
        if kind >= INTERPOLATED {
            group.ahead.interpolate(&group.tracks[channel]);
        }
        group.ahead.refer(&group.weave, group.weave.references(class, channel));
        group.expect_lengths(channel);
        group.lengths.begin(channel, kind);
        let n = group.ahead.sites.n;
        for first in (0..n).step_by(N) {
            let rows = (first, n.min(first + N));
            group.code::<S, N, FAR>(side, (channel, kind, class), rows)?;
        }
        if FAR {
            group.learn_lengths(channel);
        }
        if class == 0 {
            group.weave.learn_anchor(channel, group.ahead.sites.slot);
        }
        // The last level is between no other rows.
        if kind != INTERPOLATED {
            group.remember_lengths(channel);
        }
        Ok(())
    }
}

//! The rows of one level and run: what their references and partners say, their residuals, and what is
//! learnt from them.

use super::{
    ahead::{LANES, Referring, lanes},
    lattice::{self, Lattice, Point},
    layout::INTERPOLATED,
    pulls::Aiming,
    row::{self, Near},
    track::{Steps, follow, slot},
    walk::{Batch, Group, Question, Side},
};
use crate::{CodecError, coding::isa::Kernel};

/// Rows of a level that are held against the partners together: what they teach holds for those after them.
pub(super) const TOGETHER: usize = 8;
const _: () = assert!(TOGETHER.is_multiple_of(LANES));

/// Copies the first `n` of some values; to copy a fixed number, most often, takes no call.
#[inline(always)]
pub(super) fn copy<T: Copy>(values: &[T; TOGETHER], out: &mut [T], n: usize) {
    match out.first_chunk_mut() {
        Some(out) if n == TOGETHER => *out = *values,
        _ => out.iter_mut().zip(values).take(n).for_each(|(out, value)| *out = *value),
    }
}

/// Strides 1, 2 and 4.
const FINE: std::ops::Range<usize> = INTERPOLATED..INTERPOLATED + 3;

/// Points of some rows by axis, in units.
pub(super) type Points = [[f64; TOGETHER]; 3];

impl Group {
    /// The rows that are [`ahead`](Self::ahead), of which it is known where time alone puts them.
    pub(super) fn rows<S: Side>(
        &mut self,
        side: &mut S,
        channel: usize,
        kind: usize,
    ) -> Result<(), CodecError> {
        let class = [0, 0, 0, 0, 4, 3, 2].get(kind).copied().unwrap_or(1);
        let references = self.weave.references(class, channel);
        self.isa.run(Referring { ahead: &mut self.ahead, weave: &self.weave, references });
        self.expect_lengths(channel);
        self.lengths.begin(channel, kind);
        // Fine levels are off by little.
        if FINE.contains(&kind) {
            let (partners, n_partners) = self.lengths.partners(channel);
            self.isa.run(Aiming {
                pulls: &mut self.pulls,
                ahead: &self.ahead,
                partners: &partners.map(|k| &self.tracks[k])[..n_partners],
            });
        }
        let n = self.ahead.sites.n;
        for first in (0..n).step_by(TOGETHER) {
            let rows = (first, n.min(first + TOGETHER));
            self.isa.run(Coding { group: self, side, channel, kind, class, rows })?;
        }
        if !FINE.contains(&kind) {
            self.learn_lengths(channel);
        }
        if class == 0 {
            self.weave.learn_anchor(channel, self.ahead.sites.slot);
        }
        // The last level is between no other rows.
        if kind != 4 {
            self.remember_lengths(channel);
        }
        Ok(())
    }

    /// The marks of the references, summed, at some rows that lie side by side.
    #[inline(always)]
    fn referred(&self, channel: usize, class: usize, slot: usize) -> [u64; TOGETHER] {
        let found = self.weave.references(class, channel);
        let marks = |k: usize| -> [u64; TOGETHER] {
            self.tracks[k].marks.0[slot..].first_chunk().copied().unwrap_or([0; TOGETHER])
        };
        if found.n == 0 && channel > 0 {
            return marks(channel - 1).map(|marks| 2 * marks);
        }
        let mut sums = [0; TOGETHER];
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
        let points: Points = point.map(|units| [units as f64; TOGETHER]);
        let batch = Batch { first: at, step: 1, n: 1 };
        let track = &mut self.tracks[channel];
        let mut activity = track.activity[kind];
        track.keep((at, slot(at - before)), magnitudes, &mut activity);
        track.activity[kind] = activity;
        self.settle(side, channel, (batch, slot(at - before)), (&points, 1))
    }

    /// Stores the points of some rows, of which those are kept whose bit is set.
    #[inline(always)]
    fn settle<S: Side>(
        &mut self,
        side: &mut S,
        channel: usize,
        (batch, slot): (Batch, usize),
        (points, kept): (&Points, u32),
    ) -> Result<(), CodecError> {
        if !points.iter().all(|axis| lattice::in_range(&axis[..batch.n])) {
            return Err(CodecError::Corrupt("a position beyond every coordinate"));
        }
        self.tracks[channel].settle(batch, slot, points);
        side.settle(channel, batch, points, kept);
        Ok(())
    }
}

/// Codes the rows that are ahead.
#[derive(Debug)]
struct Coding<'a, S> {
    group: &'a mut Group,
    side: &'a mut S,
    channel: usize,
    kind: usize,
    class: usize,
    /// The first of them, and the one behind the last.
    rows: (usize, usize),
}

impl<S: Side> Kernel for Coding<'_, S> {
    type Output = Result<(), CodecError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { group, side, channel, kind, class, rows: (from, to) } = self;
        let sites = group.ahead.sites;
        let slot = sites.slot + from;
        let batch = Batch { first: sites.at(from), step: sites.step, n: to - from };
        let referred = group.referred(channel, class, slot);
        let shares = group.lengths.shares(channel, kind);
        let (partners, n_partners) = group.lengths.partners(channel);
        let partners = &partners.map(|k| &group.tracks[k])[..n_partners];
        let how = (partners, !FINE.contains(&kind));
        let mut points: Points = group.pulls.pull(&group.ahead, how, shares, from);
        let bends: [u8; TOGETHER] =
            group.ahead.bends[from..].first_chunk().copied().unwrap_or_default();
        let outside = side.outside(channel, batch, &points);
        let track = &mut group.tracks[channel];
        let mut activity = track.activity[kind];
        let mut kept = 0;
        for i in 0..batch.n.min(TOGETHER) {
            let at = batch.at(i);
            let (left, right) = sites.neighbours(from + i);
            let levels = sites.stride > 0;
            let only = |steps: Steps| if levels { steps } else { Steps::default() };
            let near = Near {
                kind,
                left: track.steps[left],
                right: only(track.steps[right]),
                before: only(track.steps_from(sites.start, at, 2 * sites.stride)),
                before_that: only(track.steps_from(sites.start, at, 4 * sites.stride)),
                references: referred[i],
                activity,
            };
            let mut steps = [0; 3];
            if outside >> i & 1 == 1 {
                let lattice = Lattice::of(&activity);
                let [x, y, z, _] = activity;
                steps = side.choose(Question {
                    channel,
                    row: batch.row(i),
                    prediction: points.each_ref().map(|axis| axis[i]),
                    kind,
                    lattice,
                    step: track.fineness.step(lattice),
                    activity: [x, y, z],
                    last_level: kind == 4 || (kind < 4 && at == left + 1),
                });
            }
            let moved = steps != [0; 3];
            if !row::moving(side.coder(), &mut group.model, &near, bends[i], moved) {
                follow(&mut activity, [0; 4]);
                continue;
            }
            let lattice = Lattice::of(&activity);
            let hints = group.ahead.hints(from + i);
            let around = (&near, &hints);
            let coded = row::residual(side.coder(), &mut group.model, around, lattice, steps)?;
            let step = track.fineness.step(lattice);
            for (axis, steps) in points.iter_mut().zip(coded.0) {
                axis[i] = (axis[i] as i64).wrapping_add(steps.wrapping_mul(step)) as f64;
            }
            kept |= 1 << i;
            track.keep((at, slot + i), coded.1, &mut activity);
            let expected = group.ahead.prediction.each_ref().map(|axis| axis[from + i]);
            let point = points.each_ref().map(|axis| axis[i]);
            let shares = group.lengths.shares_mut(channel, kind);
            group.pulls.score(from + i, (expected, point), shares);
        }
        track.activity[kind] = activity;
        let mut residuals = points;
        for (residuals, expected) in residuals.iter_mut().zip(&group.ahead.expected) {
            let expected: [f64; TOGETHER] = lanes(expected, from);
            residuals.iter_mut().zip(expected).for_each(|(units, expected)| *units -= expected);
        }
        group.weave.remember(channel, (slot, batch.n), &mut residuals);
        group.settle(side, channel, (batch, slot), (&points, kept))
    }
}

//! The rows of one level and run: what their references and partners say, their residuals, and what is
//! learnt from them.

use super::{
    ahead::{LANES, PADDED, Referring, Sites},
    lattice::{self, Lattice, Point},
    lengths::distance,
    pulls::Pulling,
    row::{self, Near},
    track::{MEMORY, Steps, slot},
    walk::{Group, Question, Side},
};
use crate::{CodecError, coding::isa::Kernel};

/// Rows of a level that are held against the partners together: what they teach holds for those after them.
const TOGETHER: usize = 8;
const _: () = assert!(TOGETHER.is_multiple_of(LANES));

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
        let n = self.ahead.sites.n;
        for first in (0..n).step_by(TOGETHER) {
            let rows = (first, n.min(first + TOGETHER));
            self.pull(channel, kind, rows);
            self.isa.run(Coding { group: self, side, channel, kind, class, rows })?;
        }
        self.weave.learn(class, channel, &self.ahead, &self.tracks[channel].span);
        // The last level is between no other rows.
        if kind > 4 {
            self.remember_lengths(channel);
        }
        Ok(())
    }

    /// Where the partners put some of the rows.
    fn pull(&mut self, channel: usize, kind: usize, rows: (usize, usize)) {
        let (partners, n_partners) = self.lengths.partners(channel);
        let shares = self.lengths.shares(channel, kind);
        let partner = |slot: usize| (slot < n_partners).then(|| &self.tracks[partners[slot]]);
        self.isa.run(Pulling {
            pulls: &mut self.pulls,
            ahead: &self.ahead,
            partners: std::array::from_fn(partner),
            shares,
            rows,
        });
    }

    /// One row: its residual.
    #[inline(always)]
    fn code<S: Side>(
        &mut self,
        side: &mut S,
        channel: usize,
        (kind, class): (usize, usize),
        i: usize,
    ) -> Result<(), CodecError> {
        let at = self.ahead.sites.at(i);
        let (left, right) = self.ahead.sites.neighbours(i);
        let near = self.around(channel, (kind, class), i);
        let prediction = self.pulls.point.each_ref().map(|axis| axis[i]);
        let lattice = if near.activity[3] >= 256 { Lattice::Centred } else { Lattice::Cubic };
        let step = self.tracks[channel].fineness.step(lattice);
        let [x, y, z, _] = near.activity;
        let steps = side.choose(Question {
            channel,
            row: at - MEMORY,
            prediction,
            kind,
            lattice,
            step,
            activity: [x, y, z],
            last_level: kind == 4 || (kind < 4 && at == left + 1),
        });
        let hints = &self.ahead.hints[i];
        let (coder, moved) = (side.coder(), steps != [0; 3]);
        let (mut point, mut magnitudes) = (prediction, None);
        if row::moving(coder, &mut self.model, &near, hints.bend, moved) {
            let around = (&near, hints);
            let coded = row::residual(coder, &mut self.model, around, lattice, steps)?;
            point = std::array::from_fn(|axis| {
                let moved = coded.0[axis].wrapping_mul(step);
                (point[axis] as i64).wrapping_add(moved) as f64
            });
            magnitudes = Some(coded.1);
        }
        let place = (at, self.ahead.sites.slot + i);
        let kept = magnitudes.is_some();
        self.settle_at(side, channel, place, kind, (point, magnitudes))?;
        if kept {
            let expected = self.ahead.prediction.each_ref().map(|axis| axis[i]);
            self.pulls.score(i, (expected, point), self.lengths.shares_mut(channel, kind));
        }
        if !(4..7).contains(&kind) {
            let (near, n_near) = self.lengths.near(channel);
            for &k in &near[..n_near] {
                let length = self.length(channel, k, at, (left, right));
                let distance = distance(point, self.tracks[k].at(at));
                if !(length.is_nan() || distance.is_nan()) {
                    self.lengths.learn(channel, k, distance, length);
                }
            }
        }
        Ok(())
    }

    /// What the neighbours and references of a row did.
    #[inline(always)]
    fn around(&self, channel: usize, (kind, class): (usize, usize), i: usize) -> Near {
        let Sites { stride, start, slot, .. } = self.ahead.sites;
        let at = self.ahead.sites.at(i);
        let (left, right) = self.ahead.sites.neighbours(i);
        let found = self.weave.references(class, channel);
        let mut references = 0;
        for &k in &found.channels[..found.n] {
            references += self.tracks[k].marks.0[slot + i];
        }
        if found.n == 0 && channel > 0 {
            references = 2 * self.tracks[channel - 1].marks.0[slot + i];
        }
        let track = &self.tracks[channel];
        let earlier = |back: usize| track.steps_from(start, at, back);
        let levels = stride > 0;
        let only = |steps: Steps| if levels { steps } else { Steps::default() };
        Near {
            kind,
            left: track.steps[left],
            right: only(track.steps[right]),
            before: only(earlier(2 * stride)),
            before_that: only(earlier(4 * stride)),
            references,
            activity: track.activity[kind],
        }
    }

    /// The distance that two channels should have at a row, in tolerances: linear between its neighbours.
    /// NaN where one of them is not known.
    fn length(&self, channel: usize, k: usize, at: usize, (left, right): (usize, usize)) -> f64 {
        let (own, other) = (&self.tracks[channel], &self.tracks[k]);
        let before = distance(own.at(left), other.at(left));
        if left == right {
            return before;
        }
        along(before, distance(own.at(right), other.at(right)), (left, at, right))
    }

    /// The distances that the partners should have at the rows ahead.
    fn expect_lengths(&mut self, channel: usize) {
        let sites = self.ahead.sites;
        let Sites { before, zero, end, stride, step, n, .. } = sites;
        let (partners, n_partners) = self.lengths.partners(channel);
        for (slot, &k) in partners[..n_partners].iter().enumerate() {
            let distances = self.lengths.distances(channel, slot);
            // What was there before this level, but for the ends, was remembered.
            for row in [zero, end] {
                let known = &mut distances[row - before];
                if known.is_nan() {
                    *known = distance(self.tracks[channel].at(row), self.tracks[k].at(row));
                }
            }
            let lengths = &mut self.ahead.lengths[slot];
            if stride == 0 {
                lengths[0] = distances[zero - before];
                continue;
            }
            let whole =
                |i: usize| sites.neighbours(i) == (sites.at(i) - stride, sites.at(i) + stride);
            let (from, to) = (usize::from(!whole(0)), n - usize::from(!whole(n - 1)));
            if from < to {
                let rows = &distances[sites.at(from) - stride - before..];
                let pairs = rows.iter().step_by(step).zip(rows[step..].iter().step_by(step));
                for (length, (first, last)) in lengths[from..to].iter_mut().zip(pairs) {
                    *length = first + (last - first) * 0.5;
                }
            }
            for i in (0..from).chain(to.max(from)..n) {
                let (left, right) = sites.neighbours(i);
                let (first, last) = (distances[left - before], distances[right - before]);
                lengths[i] = along(first, last, (left, sites.at(i), right));
            }
        }
    }

    /// The distances to the partners at the rows that were just coded, for the levels below.
    fn remember_lengths(&mut self, channel: usize) {
        let Sites { n, slot: first, step, before, .. } = self.ahead.sites;
        let row = self.ahead.sites.first - before;
        let (partners, n_partners) = self.lengths.partners(channel);
        for (slot, &k) in partners[..n_partners].iter().enumerate() {
            let distances = &mut self.lengths.distances(channel, slot)[row..];
            let (own, other) = (&self.tracks[channel].span.0, &self.tracks[k].span.0);
            for (i, known) in (first..first + n).zip(distances.iter_mut().step_by(step)) {
                let place =
                    |points: &[[f64; PADDED]; 3]| [points[0][i], points[1][i], points[2][i]];
                *known = distance(place(own), place(other));
            }
        }
    }

    /// Stores a row that was moved, wherever it is in the span.
    pub(super) fn settle<S: Side>(
        &mut self,
        side: &mut S,
        (channel, at, before): (usize, usize, usize),
        kind: usize,
        (point, magnitudes): ([f64; 3], Point),
    ) -> Result<(), CodecError> {
        let place = (at, slot(at - before));
        self.settle_at(side, channel, place, kind, (point, Some(magnitudes)))
    }

    /// Stores a row, with its magnitudes where it was moved.
    #[inline(always)]
    fn settle_at<S: Side>(
        &mut self,
        side: &mut S,
        channel: usize,
        (at, slot): (usize, usize),
        kind: usize,
        (point, magnitudes): ([f64; 3], Option<Point>),
    ) -> Result<(), CodecError> {
        if !lattice::in_range(point) {
            return Err(CodecError::Corrupt("a position beyond every coordinate"));
        }
        self.tracks[channel].settle((at, slot), kind, point, magnitudes);
        side.settle(channel, at - MEMORY, point, magnitudes.is_some());
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
        let Self { group, side, channel, kind, class, rows } = self;
        // Not `try_for_each`: its body would be a function of its own.
        for i in rows.0..rows.1 {
            group.code(side, channel, (kind, class), i)?;
        }
        Ok(())
    }
}

/// Linear between two rows.
fn along(first: f64, last: f64, (left, at, right): (usize, usize, usize)) -> f64 {
    first + (last - first) * (at - left) as f64 / (right - left) as f64
}

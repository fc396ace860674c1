//! The rows of one level and run: what their references and partners say, their residuals, and what is
//! learnt from them.

use super::{
    SPAN,
    ahead::{Referring, Sites},
    lattice::{self, Lattice, Point},
    lengths::{PARTNERS, Pull, distance},
    row::{self, Surroundings},
    track::{MEMORY, magnitude, slot},
    walk::{Group, Question, Side},
};
use crate::CodecError;

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
        for i in 0..self.ahead.sites.n {
            self.code(side, channel, (kind, class), i)?;
        }
        // The last level is between no other rows.
        if kind > 4 {
            self.remember_lengths(channel);
        }
        Ok(())
    }

    /// One row: its partners, its residual.
    fn code<S: Side>(
        &mut self,
        side: &mut S,
        channel: usize,
        (kind, class): (usize, usize),
        i: usize,
    ) -> Result<(), CodecError> {
        let Sites { before, .. } = self.ahead.sites;
        let at = self.ahead.sites.at(i);
        let (left, right) = self.ahead.sites.neighbours(i);
        let around = self.around(channel, (kind, class), i);
        let expected: [f64; 3] = std::array::from_fn(|axis| self.ahead.expected[axis][i]);
        let (prediction, pulls, n_pulls) = self.pull(channel, kind, i);

        let track = &self.tracks[channel];
        let centred = track.activity[kind] >= 256;
        let lattice = if centred { Lattice::Centred } else { Lattice::Cubic };
        let step = track.fineness.step(lattice);
        let steps = side.choose(Question {
            channel,
            row: at - MEMORY,
            prediction,
            lattice,
            step,
            activity: track.axis_activity[kind],
            last_level: kind == 4 || (kind < 4 && at == left + 1),
        });
        let coder = side.coder();
        let coded = row::residual(coder, &mut self.model, track, &around, lattice, steps)?;
        let (steps, magnitudes) = coded.unwrap_or_default();
        let point: Point = std::array::from_fn(|axis| {
            prediction[axis].wrapping_add(steps[axis].wrapping_mul(step))
        });
        self.settle(side, (channel, at, before), kind, (point, magnitudes), coded.is_some())?;
        for pull in &pulls[..n_pulls] {
            self.lengths.score(channel, kind, pull, point);
        }
        let point = point.map(|units| units as f64);
        let residual = std::array::from_fn(|axis| point[axis] - expected[axis]);
        self.weave.learn(class, channel, at - before, residual);
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
    fn around(&self, channel: usize, (kind, class): (usize, usize), i: usize) -> Surroundings {
        let ahead = &self.ahead;
        let Sites { stride, start, .. } = ahead.sites;
        let at = ahead.sites.at(i);
        let (left, right) = ahead.sites.neighbours(i);
        let mut around = Surroundings {
            kind,
            bend: usize::from(ahead.bend[i]),
            side: std::array::from_fn(|axis| usize::from(ahead.side[axis][i])),
            references_side: std::array::from_fn(|axis| {
                usize::from(ahead.references_side[axis][i])
            }),
            ..Surroundings::default()
        };
        let references = self.weave.references(class, channel);
        for &k in &references.channels[..references.n] {
            let steps = self.tracks[k].steps[at];
            for (sum, step) in around.references.iter_mut().zip(steps) {
                *sum += magnitude(i32::from(step));
            }
        }
        if references.n == 0 && channel > 0 {
            let steps = self.tracks[channel - 1].steps[at];
            around.references = steps.map(|step| 2 * magnitude(i32::from(step)));
        }
        let track = &self.tracks[channel];
        around.left = track.steps_from(start, Some(left));
        if stride > 0 {
            around.right = track.steps_from(start, Some(right));
            around.before = track.steps_from(start, at.checked_sub(2 * stride));
            around.before_that = track.steps_from(start, at.checked_sub(4 * stride));
        }
        around
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
            let mut fix = 0..0;
            if stride == 0 {
                lengths[0] = distances[zero - before];
                continue;
            }
            let whole = |i: usize| sites.neighbours(i) == (sites.at(i) - stride, sites.at(i) + stride);
            let (from, to) = (usize::from(!whole(0)), n - usize::from(!whole(n - 1)));
            if from < to {
                let rows = &distances[sites.at(from) - stride - before..];
                let pairs = rows.iter().step_by(step).zip(rows[step..].iter().step_by(step));
                for (length, (first, last)) in lengths[from..to].iter_mut().zip(pairs) {
                    *length = first + (last - first) * 0.5;
                }
            } else {
                fix = 0..n;
            }
            for i in (0..from).chain(to.max(from)..n).chain(fix) {
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
                let place = |points: &[[f64; SPAN]; 3]| [points[0][i], points[1][i], points[2][i]];
                *known = distance(place(own), place(other));
            }
        }
    }

    fn pull(&self, channel: usize, kind: usize, i: usize) -> (Point, [Pull; PARTNERS], usize) {
        let (mut pulls, mut n) = ([Pull::default(); PARTNERS], 0);
        let mut moved: [f64; 3] = std::array::from_fn(|axis| self.ahead.prediction[axis][i]);
        let (partners, n_partners) = self.lengths.partners(channel);
        let at = self.ahead.sites.slot + i;
        for (slot, &k) in partners[..n_partners].iter().enumerate() {
            let span = &self.tracks[k].span.0;
            let (partner, length) = ([span[0][at], span[1][at], span[2][at]], self.ahead.lengths[slot][i]);
            if let Some(pull) = self.lengths.pull((channel, kind, slot), &mut moved, partner, length)
            {
                pulls[n] = pull;
                n += 1;
            }
        }
        (moved.map(lattice::round), pulls, n)
    }

    pub(super) fn settle<S: Side>(
        &mut self,
        side: &mut S,
        (channel, at, before): (usize, usize, usize),
        kind: usize,
        (point, magnitudes): (Point, Point),
        kept: bool,
    ) -> Result<(), CodecError> {
        if !lattice::in_range(point) {
            return Err(CodecError::Corrupt("a position beyond every coordinate"));
        }
        self.tracks[channel].settle((at, slot(at - before)), kind, point, magnitudes);
        side.settle(channel, at - MEMORY, point, kept);
        Ok(())
    }
}

/// Linear between two rows.
fn along(first: f64, last: f64, (left, at, right): (usize, usize, usize)) -> f64 {
    first + (last - first) * (at - left) as f64 / (right - left) as f64
}

//! One row of a group: what its references and partners say, its residual, and what is learnt from it.

use super::{
    lattice::{self, Lattice, Point},
    lengths::{PARTNERS, Pull, distance},
    row::{self, Surroundings},
    track::{MEMORY, magnitude},
    walk::{Group, Question, Side},
};
use crate::CodecError;

impl Group {
    /// One row with an expectation: its references, its partners, its residual.
    pub(super) fn code<S: Side>(
        &mut self,
        side: &mut S,
        (channel, at): (usize, usize),
        expected: Point,
        mut around: Surroundings,
        (left, right): (usize, usize),
        before: usize,
    ) -> Result<(), CodecError> {
        let kind = around.kind;
        let class = [0, 0, 0, 0, 4, 3, 2].get(kind).copied().unwrap_or(1);
        let row = at - before;
        self.refer(&mut around, class, channel, at, row);
        let off = self.weave.expect(class, channel, row);
        let mut prediction: Point =
            std::array::from_fn(|axis| expected[axis].wrapping_add(lattice::round(off[axis])));
        let (pulls, n_pulls) =
            self.pull((channel, at, before), kind, &mut prediction, (left, right));

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
        self.settle(side, (channel, at, kind), (point, magnitudes), coded.is_some())?;
        for pull in &pulls[..n_pulls] {
            self.lengths.score(channel, kind, pull, point);
        }
        let residual = std::array::from_fn(|axis| point[axis].wrapping_sub(expected[axis]) as f64);
        self.weave.learn(class, channel, row, residual);
        if !(4..7).contains(&kind) {
            let (near, n_near) = self.lengths.near(channel);
            for &k in &near[..n_near] {
                let length = self.length(channel, k, at, (left, right));
                if let Some(length) = length.filter(|_| self.tracks[k].known[at]) {
                    let distance = distance(point, self.tracks[k].points[at]);
                    self.lengths.learn(channel, k, distance, length);
                }
            }
        }
        Ok(())
    }

    /// What the references of a row did there.
    fn refer(
        &self,
        around: &mut Surroundings,
        class: usize,
        channel: usize,
        at: usize,
        row: usize,
    ) {
        let references = self.weave.references(class, channel);
        let mut sides = [0.0; 3];
        let mut add = |k: usize, times: i32| {
            let track = &self.tracks[k];
            if track.known[at] {
                for axis in 0..3 {
                    around.references[axis] += times * magnitude(i32::from(track.steps[at][axis]));
                }
            }
        };
        for i in 0..references.n {
            let k = references.channels[i];
            add(k, 1);
            for (axis, side) in sides.iter_mut().enumerate() {
                *side += self.weave.residual(row, axis, k) * references.signs[i];
            }
        }
        if references.n == 0 && channel > 0 {
            add(channel - 1, 2);
        }
        around.references_side = sides.map(|side| match side {
            30.0.. => 1,
            _ if side <= -30.0 => 2,
            _ => 0,
        });
    }

    /// The distance that two channels should have at a row, in tolerances: linear between its neighbours.
    fn length(
        &self,
        channel: usize,
        k: usize,
        at: usize,
        (left, right): (usize, usize),
    ) -> Option<f64> {
        let (own, other) = (&self.tracks[channel], &self.tracks[k]);
        let between = |row: usize| {
            (own.known[row] && other.known[row])
                .then(|| distance(own.points[row], other.points[row]))
        };
        let before = between(left)?;
        if left == right {
            return Some(before);
        }
        let after = between(right)?;
        Some(along(before, after, (left, at, right)))
    }

    fn pull(
        &mut self,
        (channel, at, before): (usize, usize, usize),
        kind: usize,
        prediction: &mut Point,
        (left, right): (usize, usize),
    ) -> ([Pull; PARTNERS], usize) {
        let (mut pulls, mut n) = ([Pull::default(); PARTNERS], 0);
        let (partners, n_partners) = self.lengths.partners(channel);
        if n_partners == 0 {
            return (pulls, n);
        }
        let mut moved = prediction.map(|units| units as f64);
        let own = &self.tracks[channel];
        for (slot, &k) in partners[..n_partners].iter().enumerate() {
            let other = &self.tracks[k];
            if !other.known[at] {
                continue;
            }
            let between = |row: usize| {
                (own.known[row] && other.known[row])
                    .then(|| distance(own.points[row], other.points[row]))
            };
            let place = |row: usize| (channel, slot, row - before);
            let Some(first) = self.lengths.remembered(place(left), || between(left)) else {
                continue;
            };
            let mut length = first;
            if left != right {
                let Some(last) = self.lengths.remembered(place(right), || between(right)) else {
                    continue;
                };
                length = along(first, last, (left, at, right));
            }
            let place = (channel, kind, slot);
            if let Some(pull) = self.lengths.pull(place, &mut moved, other.points[at], length) {
                pulls[n] = pull;
                n += 1;
            }
        }
        if n > 0 {
            *prediction = moved.map(lattice::round);
        }
        (pulls, n)
    }

    pub(super) fn settle<S: Side>(
        &mut self,
        side: &mut S,
        (channel, at, kind): (usize, usize, usize),
        (point, magnitudes): (Point, Point),
        kept: bool,
    ) -> Result<(), CodecError> {
        if !lattice::in_range(point) {
            return Err(CodecError::Corrupt("a position beyond every coordinate"));
        }
        self.tracks[channel].settle(at, kind, point, magnitudes);
        side.settle(channel, at - MEMORY, point, kept);
        Ok(())
    }
}

/// Linear between two rows.
fn along(first: f64, last: f64, (left, at, right): (usize, usize, usize)) -> f64 {
    first + (last - first) * (at - left) as f64 / (right - left) as f64
}

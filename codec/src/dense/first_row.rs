//! The first row of a run: the candidates for its origin, and its residual from the chosen one.
//!
//! The candidates are the last sample of its own channel, moved as its nearest neighbour has moved since; the last
//! samples of other channels whose runs have ended and are not continued, since unlabelled markers change channels;
//! and the current position of another marker. Continuing the runs of other channels gains 1.8 %; it makes the one
//! unlabelled take up to 1.5 times smaller.

use super::{
    contexts::{
        MAX_EXPONENT, MAX_ORIGIN_ENDS, ORIGIN_EXPONENT, ORIGIN_NONE, ORIGIN_OWN, ORIGIN_RANK,
    },
    level_prediction::PAST_ROWS,
    model::{Model, ModelCoder},
    points::{Grid, Point},
    track::Track,
};
use crate::{Position, Result, bound::squared_distance, ensure};

/// How a first row is coded: the index of its origin among the candidates, and the lattice steps from there.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct FirstRow {
    pub(super) candidate: usize,
    pub(super) steps: Point,
}

/// Chooses the origin of a first row with this position, and its steps from there; `step` is the size of a step in
/// units. If `is_exact`, origins from which the steps lead to the position itself come first.
pub(super) fn choose(
    grid: Grid,
    position: Position,
    step: i64,
    is_exact: bool,
    origins: &[Point],
) -> FirstRow {
    let units = grid.units(position);
    let steps_from = |from: &Point| -> Point {
        std::array::from_fn(|axis| ((units[axis] - from[axis] as f64) / step as f64).round() as i64)
    };
    // In half bits: the exponent, as many mantissa bits, a sign, and the rank of the candidate.
    let cost = |steps: &Point| -> u64 {
        let axis = |step: &i64| {
            let value = step.unsigned_abs() * 2 + 1;
            u64::from(value.ilog2()) * 4 + (value >> (value.ilog2().max(1) - 1) & 1) * 2
        };
        steps.iter().map(axis).sum()
    };
    let ranked = origins.iter().enumerate().map(|(rank, from)| {
        let start = FirstRow { candidate: rank, steps: steps_from(from) };
        let rank_cost = if rank == 0 { 2 + origins.len() as u64 } else { rank as u64 };
        let point = std::array::from_fn(|axis| (from[axis] + start.steps[axis] * step) as f64);
        let misses = is_exact && grid.position(point) != position;
        (misses, cost(&start.steps) + rank_cost, start)
    });
    let best = ranked.min_by_key(|&(misses, cost, start)| (misses, cost, start.candidate));
    best.map(|(_, _, start)| start).unwrap_or_default()
}

/// Ends of other channels' runs are candidates for fewer rows than this.
const MAX_END_AGE_ROWS: u64 = 200;

/// The candidates for the origin of a first row: the nearby marker, always present; then the channel's own end, if any;
/// then the ends of other channels.
#[derive(Debug)]
pub(super) struct OriginCandidates {
    points: [Point; MAX_ORIGIN_ENDS + 2],
    /// The channels of the ends.
    channels: [usize; MAX_ORIGIN_ENDS + 2],
    n: usize,
    first_end: usize,
    /// Age of the channel's own end, in rows.
    own: Option<u64>,
}

impl OriginCandidates {
    pub(super) fn find(
        tracks: &[Track],
        channel: usize,
        at: usize,
        first_row: u64,
        present: &[Option<&[bool]>],
    ) -> Self {
        let (mut points, mut channels) = ([[0; 3]; MAX_ORIGIN_ENDS + 2], [0; MAX_ORIGIN_ENDS + 2]);
        if let Some(before) = tracks[..channel].iter().rev().find(|track| track.is_known(at)) {
            points[0] = before.point(at);
        }
        let now = first_row + (at - PAST_ROWS) as u64;
        let own = tracks[channel].end.map(|end| now - end.row);
        if let (Some(end), Some(age)) = (tracks[channel].end, own) {
            points[1] = follow_nearest(tracks, channel, at, end.point, age);
        }
        let first_end = 1 + usize::from(own.is_some());
        // The latest end first; ties in the order of channels.
        let (mut n, mut rows) = (first_end, [u64::MAX; MAX_ORIGIN_ENDS + 2]);
        for (k, track) in tracks.iter().enumerate().take(present.len()) {
            let Some(end) = track.end.filter(|_| k != channel) else { continue };
            let goes_on = (end.row + 1).checked_sub(first_row).is_some_and(|next| {
                present[k].is_some_and(|present| present.get(next as usize).is_some_and(|&p| p))
            });
            if end.taken || goes_on || end.row >= now || end.row + MAX_END_AGE_ROWS <= now {
                continue;
            }
            let place = rows[..n].partition_point(|&row| row >= end.row);
            if place == first_end + MAX_ORIGIN_ENDS {
                continue;
            }
            n = (n + 1).min(first_end + MAX_ORIGIN_ENDS);
            rows[place..n].rotate_right(1);
            channels[place..n].rotate_right(1);
            points[place..n].rotate_right(1);
            (rows[place], channels[place], points[place]) = (end.row, k, end.point);
        }
        Self { points, channels, n, first_end, own }
    }

    pub(super) fn points(&self) -> &[Point] {
        &self.points[..self.n]
    }

    /// Codes the index of the chosen candidate.
    pub(super) fn code(
        &self,
        coder: &mut impl ModelCoder,
        model: &mut Model,
        choice: usize,
    ) -> usize {
        if let Some(age) = self.own {
            let class = age.max(1).ilog2().min(7) as usize;
            if model.single(coder, ORIGIN_OWN.at(class), choice == 1) {
                return 1;
            }
        }
        let Self { n, first_end, .. } = *self;
        if n == first_end || model.single(coder, ORIGIN_NONE.at(0), choice == 0) {
            return 0;
        }
        (first_end..n - 1)
            .find(|&end| model.single(coder, ORIGIN_RANK.at(end - first_end), choice == end))
            .unwrap_or(n - 1)
    }

    /// The class of a candidate, for the contexts of the residual: 0 nearby, 1 own, 2 an end.
    pub(super) fn class(&self, choice: usize) -> usize {
        match (choice, self.own) {
            (0, _) => 0,
            (1, Some(_)) => 1,
            _ => 2,
        }
    }

    /// The channel whose run a candidate continues; `None` for the nearby marker and the channel's own end.
    pub(super) fn taken(&self, choice: usize) -> Option<usize> {
        (choice >= self.first_end).then(|| self.channels[choice])
    }
}

/// A point of `rows` rows ago, moved as the channel nearest to it at that time has moved since.
fn follow_nearest(tracks: &[Track], channel: usize, at: usize, point: Point, rows: u64) -> Point {
    let Some(then) = usize::try_from(rows).ok().and_then(|rows| at.checked_sub(rows)) else {
        return point;
    };
    let mut best = (f64::INFINITY, point);
    for (k, track) in tracks.iter().enumerate() {
        if k == channel || !track.is_known(at) || !track.is_known(then) {
            continue;
        }
        let (old, new) = (track.point(then), track.point(at));
        let off = |axis: usize| old[axis].wrapping_sub(point[axis]) as f64;
        let squares = squared_distance([off(0), off(1), off(2)], [0.0; 3]);
        if squares < best.0 {
            let axes = |axis: usize| point[axis].wrapping_add(new[axis]).wrapping_sub(old[axis]);
            best = (squares, std::array::from_fn(axes));
        }
    }
    best.1
}

/// Codes the residual of a first row in Exp-Golomb code, with the class of its origin as the only context.
pub(super) fn residual(
    coder: &mut impl ModelCoder,
    model: &mut Model,
    class: usize,
    steps: Point,
) -> Result<Point> {
    let mut decoded = [0; 3];
    for (axis, decoded) in decoded.iter_mut().enumerate() {
        let value = steps[axis].unsigned_abs() + 1;
        let target = value.ilog2() as usize;
        let mut exponent = 0;
        let context = |i: usize| ORIGIN_EXPONENT.at((class * 3 + axis) * 48 + i);
        while model.single(coder, context(exponent), target > exponent) {
            exponent += 1;
            ensure(exponent <= MAX_EXPONENT, "a first row out of range")?;
        }
        let low = coder.plain(value, exponent as u32);
        let length = ((1 << exponent) + low - 1) as i64;
        *decoded = length;
        if length > 0 && coder.plain(u64::from(steps[axis] < 0), 1) == 1 {
            *decoded = -length;
        }
    }
    Ok(decoded)
}

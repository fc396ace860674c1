//! Which lattice point is coded.

use super::{
    lattice::{Grid, Lattice, Point},
    layout::KINDS,
    walk::{Question, Side},
};
use crate::{BlockReport, GROUP_CHANNELS, Rows, bound, coding::range::RangeEncoder};

/// An encoder at work on one block.
pub(super) struct Encoding<'a, 'r> {
    pub(super) channels: &'a [Rows<'a>],
    pub(super) grid: Grid,
    pub(super) coder: RangeEncoder<'a>,
    pub(super) reports: &'r mut [BlockReport],
    /// The largest square whose root is within the tolerance, and the largest so far by channel.
    pub(super) allowed: f64,
    pub(super) squares: [f64; GROUP_CHANNELS],
}

impl Encoding<'_, '_> {
    /// As [`bound::distance_mm`], without its root: that keeps the order.
    fn squares(&self, channel: usize, row: usize, point: Point) -> f64 {
        bound::squares(self.grid.position(point), self.channels[channel].positions()[row])
    }
}

/// What a miss costs against the bits of the steps, by kind of row: the more rows are predicted from it, the
/// more; and where none is. Found by trying.
const MISS: [f64; KINDS] = [20.0, 20.0, 20.0, 20.0, 0.1, 5.0, 10.0, 20.0, 20.0, 20.0];
const LAST_MISS: f64 = 0.1;

/// About the bits of a magnitude whose axis has lately been `activity` on average.
fn bits(magnitude: i64, activity: f64, free: bool) -> f64 {
    let first = if free { 0.0 } else { 0.6 / (activity + 0.3) };
    if magnitude == 0 { 0.0 } else { magnitude as f64 * 1.44 / (activity + 0.35) + first }
}

impl<'a> Side for Encoding<'a, '_> {
    type Coder = RangeEncoder<'a>;

    fn coder(&mut self) -> &mut RangeEncoder<'a> {
        &mut self.coder
    }

    /// Stays where it can. Else, of the lattice points around the sample that are inside the ball, the
    /// one with the fewest bits, and the nearer one the more is predicted from it.
    fn choose(&mut self, question: Question) -> Point {
        let Question { channel, row, prediction, .. } = question;
        let sample = self.channels[channel].positions()[row];
        if self.squares(channel, row, prediction) <= self.allowed {
            return [0; 3];
        }
        let units = self.grid.units(sample);
        let step = question.step as f64;
        let off: [f64; 3] =
            std::array::from_fn(|axis| (units[axis] - prediction[axis] as f64) / step);
        let activity = question.activity.map(|activity| f64::from(activity) / 256.0);
        let miss = if question.last_level { LAST_MISS } else { MISS[question.kind] };
        let limit = 256.0 / step * (256.0 / step) * 1.01;
        let mut best = (f64::INFINITY, [0; 3]);
        let odds = match question.lattice {
            Lattice::Cubic => 0..1,
            Lattice::Centred => 0..2,
        };
        for odd in odds {
            for corner in 0..8 {
                let steps = corner_of(question.lattice, odd, off, corner);
                let squares = (0..3).fold(0.0, |sum, axis| {
                    let miss = steps[axis] as f64 - off[axis];
                    sum + miss * miss
                });
                if squares > limit || steps == [0; 3] {
                    continue;
                }
                let mut cost = miss * squares / limit;
                for axis in 0..3 {
                    let magnitude = match question.lattice {
                        Lattice::Cubic => steps[axis].abs(),
                        Lattice::Centred => (steps[axis].abs() + 1) / 2,
                    };
                    cost += bits(magnitude, activity[axis], odd == 1);
                }
                let point =
                    std::array::from_fn(|axis| prediction[axis] + steps[axis] * question.step);
                if cost < best.0 && self.squares(channel, row, point) <= self.allowed {
                    best = (cost, steps);
                }
            }
        }
        best.1
    }

    fn start(&mut self, channel: usize, row: usize, step: i64, ways: &[Point]) -> (usize, Point) {
        let units = self.grid.units(self.channels[channel].positions()[row]);
        let steps_from = |from: &Point| -> Point {
            std::array::from_fn(|axis| {
                ((units[axis] - from[axis] as f64) / step as f64).round() as i64
            })
        };
        // Half bits: an exponent, as many bits again, and a sign; and the rank.
        let cost = |steps: &Point| -> u64 {
            let axis = |step: &i64| {
                let value = step.unsigned_abs() * 2 + 1;
                u64::from(value.ilog2()) * 4 + (value >> (value.ilog2().max(1) - 1) & 1) * 2
            };
            steps.iter().map(axis).sum()
        };
        let ranked = ways.iter().enumerate().map(|(rank, from)| {
            let steps = steps_from(from);
            let rank_cost = if rank == 0 { 2 + ways.len() as u64 } else { rank as u64 };
            (cost(&steps) + rank_cost, rank, steps)
        });
        ranked
            .min_by_key(|&(cost, rank, _)| (cost, rank))
            .map_or_else(Default::default, |found| (found.1, found.2))
    }

    fn settle(&mut self, channel: usize, row: usize, point: Point, kept: bool) {
        let squares = self.squares(channel, row, point);
        self.squares[channel] = self.squares[channel].max(squares);
        self.reports[channel].kept += u32::from(kept);
    }
}

/// Without a call where the processor has no rounding instruction.
fn floor(value: f64) -> i64 {
    let cut = value as i64;
    cut - i64::from(cut as f64 > value)
}

/// One of the eight lattice points around a place.
fn corner_of(lattice: Lattice, odd: i64, off: [f64; 3], corner: usize) -> Point {
    std::array::from_fn(|axis| {
        let up = (corner >> axis & 1) as i64;
        match lattice {
            Lattice::Cubic => floor(off[axis]) + up,
            Lattice::Centred => 2 * (floor((off[axis] - odd as f64) / 2.0) + up) + odd,
        }
    })
}

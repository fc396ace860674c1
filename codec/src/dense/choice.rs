//! Which lattice point is coded.

use super::{
    code::{Points, TOGETHER},
    lattice::{Grid, Lattice, Point},
    layout::KINDS,
    walk::{Batch, Question, Side},
};
use crate::{BlockReport, GROUP_CHANNELS, Position, Rows, bound, coding::range::RangeEncoder};

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
    #[inline(always)]
    fn squares(&self, sample: Position, units: [f64; 3]) -> f64 {
        bound::squares(self.grid.position(units), sample)
    }

    /// The same of some rows; of those beyond them it says nothing.
    #[inline(always)]
    fn all_squares(&self, channel: usize, batch: Batch, units: &Points) -> [f64; TOGETHER] {
        let rows = self.channels[channel].positions();
        let mut samples = [[0.0_f32; TOGETHER]; 3];
        for i in 0..batch.n.min(TOGETHER) {
            let sample = rows[batch.row(i)];
            for (axis, coordinate) in samples.iter_mut().zip(sample) {
                axis[i] = coordinate;
            }
        }
        let positions = self.grid.positions(units);
        std::array::from_fn(|i| {
            let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| {
                f64::from(positions[axis][i]) - f64::from(samples[axis][i])
            });
            x * x + y * y + z * z
        })
    }

    /// Of the lattice points around the sample that are inside the ball, the one with the fewest bits, and
    /// the nearer one the more is predicted from it.
    #[inline(always)]
    fn search(&self, question: &Question, sample: Position) -> Point {
        let Question { prediction, lattice, .. } = *question;
        let units = self.grid.units(sample);
        let step = question.step as f64;
        let off: [f64; 3] = std::array::from_fn(|axis| (units[axis] - prediction[axis]) / step);
        let activity = question.activity.map(|activity| f64::from(activity) / 256.0);
        let first = activity.map(|activity| 0.6 / (activity + 0.3));
        let miss = if question.last_level { LAST_MISS } else { MISS[question.kind] };
        let limit = 256.0 / step * (256.0 / step) * 1.01;
        let centred = lattice == Lattice::Centred;
        let mut axes = [[Around::default(); 3]; 2];
        let mut costs = [[f64::INFINITY; 8]; 2];
        for odd in 0..=usize::from(centred) {
            for axis in 0..3 {
                let first = if odd == 1 { 0.0 } else { first[axis] };
                axes[odd][axis] = Around::new((lattice, odd), off[axis], activity[axis], first);
            }
            let [x, y, z] = &axes[odd];
            for (corner, cost) in costs[odd].iter_mut().enumerate() {
                let [i, j, k] = [0, 1, 2].map(|axis| corner >> axis & 1);
                let squares = x.squares[i] + y.squares[j] + z.squares[k];
                let bits = miss * squares / limit + x.bits[i] + y.bits[j] + z.bits[k];
                *cost = if squares <= limit { bits } else { f64::INFINITY };
            }
        }
        // The cheapest that is truly inside, the first of equals.
        let costs = costs.as_flattened_mut();
        let n = if centred { 16 } else { 8 };
        loop {
            let mut best = (f64::INFINITY, 0);
            for (corner, &cost) in costs[..n].iter().enumerate() {
                best = if cost < best.0 { (cost, corner) } else { best };
            }
            let (cost, corner) = best;
            if cost == f64::INFINITY {
                return [0; 3];
            }
            let around = &axes[corner >> 3];
            let steps: Point = [0, 1, 2].map(|axis| around[axis].steps[corner >> axis & 1]);
            let point: [f64; 3] = std::array::from_fn(|axis| {
                (prediction[axis] as i64 + steps[axis] * question.step) as f64
            });
            if self.squares(sample, point) <= self.allowed {
                return steps;
            }
            costs[corner] = f64::INFINITY;
        }
    }
}

/// What one axis of the lattice points on both sides of the sample says.
#[derive(Debug, Clone, Copy, Default)]
struct Around {
    steps: [i64; 2],
    /// The squares of their distances from the sample, in steps.
    squares: [f64; 2],
    bits: [f64; 2],
}

impl Around {
    /// `activity` is what the magnitudes have lately been on average, `first` what the first step costs.
    #[inline(always)]
    fn new((lattice, odd): (Lattice, usize), off: f64, activity: f64, first: f64) -> Self {
        let (steps, magnitudes) = match lattice {
            Lattice::Cubic => {
                let below = floor(off);
                let steps = [below, below + 1];
                (steps, steps.map(i64::abs))
            }
            Lattice::Centred => {
                let odd = odd as i64;
                let below = 2 * floor((off - odd as f64) / 2.0) + odd;
                let steps = [below, below + 2];
                (steps, steps.map(|steps| (steps.abs() + 1) / 2))
            }
        };
        let misses = steps.map(|steps| steps as f64 - off);
        let bits = magnitudes.map(|magnitude| {
            let bits = magnitude as f64 * 1.44 / (activity + 0.35) + first;
            if magnitude == 0 { 0.0 } else { bits }
        });
        Self { steps, squares: misses.map(|miss| miss * miss), bits }
    }
}

/// What a miss costs against the bits of the steps, by kind of row: the more rows are predicted from it, the
/// more; and where none is. Found by trying.
const MISS: [f64; KINDS] = [20.0, 20.0, 20.0, 20.0, 0.1, 5.0, 10.0, 20.0, 20.0, 20.0];
const LAST_MISS: f64 = 0.1;

impl<'a> Side for Encoding<'a, '_> {
    type Coder = RangeEncoder<'a>;

    fn coder(&mut self) -> &mut RangeEncoder<'a> {
        &mut self.coder
    }

    #[inline(always)]
    fn choose(&mut self, question: Question) -> Point {
        let sample = self.channels[question.channel].positions()[question.row];
        self.search(&question, sample)
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

    #[inline(always)]
    fn outside(&mut self, channel: usize, batch: Batch, predictions: &Points) -> u32 {
        let squares = self.all_squares(channel, batch, predictions);
        let inside = squares.map(|squares| squares <= self.allowed);
        (0..batch.n).fold(0, |bits, i| bits | u32::from(!inside[i]) << i)
    }

    #[inline(always)]
    fn settle(&mut self, channel: usize, batch: Batch, points: &Points, kept: u32) {
        let squares = self.all_squares(channel, batch, points);
        let most = &mut self.squares[channel];
        for square in &squares[..batch.n] {
            *most = most.max(*square);
        }
        self.reports[channel].kept += kept.count_ones();
    }
}

/// Without a call where the processor has no rounding instruction.
#[inline(always)]
fn floor(value: f64) -> i64 {
    let cut = value as i64;
    cut - i64::from(cut as f64 > value)
}

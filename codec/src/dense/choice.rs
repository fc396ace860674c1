//! Which lattice point is coded.

use super::{
    ahead::{ROOM, Sites, lanes},
    code::{Points, TOGETHER},
    corners::{AXES, CORNERS, Cell, Reach},
    lattice::{Grid, Lattice, Point},
    layout::KINDS,
    track::MEMORY,
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
    /// The samples of the rows ahead, by axis; of some of them, the squares of where they are expected.
    pub(super) samples: [[f32; ROOM]; 3],
    pub(super) expected: [f64; TOGETHER],
    /// Of the rows ahead, how far the samples are from where they are expected, in units.
    pub(super) off: [[f64; ROOM]; 3],
}

impl Encoding<'_, '_> {
    /// As [`bound::distance_mm`], without its root: that keeps the order.
    #[inline(always)]
    fn squares(&self, sample: Position, units: [f64; 3]) -> f64 {
        bound::squared_distance(bound::widen(self.grid.position(units)), bound::widen(sample))
    }

    /// As [`squares`](Self::squares), of some of the rows ahead.
    #[inline(always)]
    fn all_squares<const N: usize>(&self, batch: Batch, units: &Points<N>) -> [f64; N] {
        let positions = self.grid.positions(units);
        let [x, y, z] = &self.samples;
        let samples: [[f32; N]; 3] =
            [lanes(x, batch.from), lanes(y, batch.from), lanes(z, batch.from)];
        let mut squares = [0.0; N];
        for i in 0..N {
            let x = f64::from(positions[0][i]) - f64::from(samples[0][i]);
            let y = f64::from(positions[1][i]) - f64::from(samples[1][i]);
            let z = f64::from(positions[2][i]) - f64::from(samples[2][i]);
            squares[i] = x * x + y * y + z * z;
        }
        squares
    }

    /// Of the lattice points around the sample that are inside the ball, the one with the fewest bits, and
    /// the nearer one the more is predicted from it.
    #[inline(always)]
    fn search(&self, question: &Question) -> Point {
        let Question { prediction, lattice, fineness, place, .. } = *question;
        let reach = Reach::of(lattice, fineness);
        let (mut off, mut activity) = ([0.0; AXES], [0.0; AXES]);
        for axis in 0..3 {
            off[axis] = self.off[axis][place] * reach.per_step;
            activity[axis] = f64::from(question.activity[axis]) / 256.0;
        }
        let miss = if question.last_level { LAST_MISS } else { MISS[question.kind] };
        let sample = self.samples.each_ref().map(|axis| axis[place]);
        let step = fineness.step(lattice) as f64;
        let is_inside = |steps: [f64; 3]| {
            let point = std::array::from_fn(|axis| prediction[axis] + steps[axis] * step);
            self.squares(sample, point) <= self.allowed
        };
        let cell = Cell { off, activity, miss, reach };
        let steps = match lattice {
            Lattice::Cubic => cell.cheapest::<1, CORNERS>(is_inside),
            Lattice::Centred => cell.cheapest::<2, { 2 * CORNERS }>(is_inside),
        };
        steps.map(|steps| steps as i64)
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
        self.search(&question)
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
    fn ahead(&mut self, channel: usize, sites: &Sites) {
        let rows = self.channels[channel].positions();
        for i in 0..sites.n.min(ROOM) {
            let sample = rows[sites.at(i) - MEMORY];
            for (axis, coordinate) in self.samples.iter_mut().zip(sample) {
                axis[i] = coordinate;
            }
        }
    }

    #[inline(always)]
    fn outside<const N: usize>(
        &mut self,
        _channel: usize,
        batch: Batch,
        predictions: &Points<N>,
    ) -> u32 {
        let squares = self.all_squares(batch, predictions);
        self.expected[..N].copy_from_slice(&squares);
        for (axis, off) in self.off.iter_mut().enumerate() {
            let samples: [f32; N] = lanes(&self.samples[axis], batch.from);
            let off = &mut off[batch.from..batch.from + N];
            for i in 0..N {
                off[i] = f64::from(samples[i]) / self.grid.unit_mm - predictions[axis][i];
            }
        }
        let mut bits = 0;
        for (i, squares) in squares.into_iter().enumerate() {
            bits |= u32::from(squares > self.allowed) << i;
        }
        bits
    }

    #[inline(always)]
    fn settle<const N: usize>(
        &mut self,
        channel: usize,
        batch: Batch,
        points: &Points<N>,
        kept: u32,
    ) {
        // What is not moved was measured when it was expected.
        let mut squares = [0.0; N];
        if kept == 0 {
            squares.copy_from_slice(&self.expected[..N]);
        } else {
            squares = self.all_squares(batch, points);
        }
        let most = &mut self.squares[channel];
        for square in &squares[..batch.n] {
            *most = most.max(*square);
        }
        self.reports[channel].kept += kept.count_ones();
    }
}

//! The encoder's choice of lattice points: rate-distortion optimisation over the candidates around the sample.

use super::{
    contexts::KINDS,
    distance_correction::BATCH_ROWS,
    level::{FirstRow, ResidualInputs, RowCodec},
    level_prediction::{Batch, LevelLayout, PADDED_ROWS, PAST_ROWS},
    points::{Fineness, Grid, Lattice, Point, Points, UNITS_PER_TOLERANCE, floor, lanes},
};
use crate::{
    BlockReport, GROUP_CHANNELS, Rows,
    bound::{squared_distance, widen},
    coding::range::RangeEncoder,
};

/// The encoder of one block.
pub(super) struct RowEncoder<'a, 'r> {
    channels: &'a [Rows<'a>],
    grid: Grid,
    pub(super) coder: RangeEncoder<'a>,
    pub(super) reports: &'r mut [BlockReport],
    pub(super) kept_rows: &'r mut [bool],
    /// The largest square in mm^2 whose root is within the tolerance, and the largest squared error so far by channel.
    max_square: f64,
    squares: [f64; GROUP_CHANNELS],
    /// The samples of the rows of the level in mm, by axis; and the squared errors of the predictions of a batch.
    samples: [[f32; PADDED_ROWS]; 3],
    predicted_squares: [f64; BATCH_ROWS],
    /// Offsets of the samples from their predictions for the rows of the level, in units.
    off: [[f64; PADDED_ROWS]; 3],
}

impl<'a, 'r> RowEncoder<'a, 'r> {
    pub(super) fn new(
        channels: &'a [Rows<'a>],
        grid: Grid,
        coder: RangeEncoder<'a>,
        reports: &'r mut [BlockReport],
        kept_rows: &'r mut [bool],
    ) -> Self {
        Self {
            channels,
            grid,
            coder,
            reports,
            kept_rows,
            max_square: largest_square(grid.tolerance_mm()),
            squares: [0.0; GROUP_CHANNELS],
            samples: [[0.0; PADDED_ROWS]; 3],
            predicted_squares: [0.0; BATCH_ROWS],
            off: [[0.0; PADDED_ROWS]; 3],
        }
    }

    /// Ends the block and reports the errors; `false` when it exceeds its limit of bytes or the tolerance.
    pub(super) fn finish(self) -> bool {
        for (report, squares) in self.reports.iter_mut().zip(self.squares) {
            report.max_error_mm = squares.sqrt();
        }
        self.coder.finish() && self.squares.iter().all(|&squares| squares <= self.max_square)
    }

    /// The squared distances in mm^2 between the samples of a batch and the points `units`.
    #[inline(always)]
    fn squares<const N: usize>(&self, batch: Batch, units: &Points<N>) -> [f64; N] {
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
}

/// The largest f64 number whose square root does not exceed the tolerance.
fn largest_square(tolerance_mm: f64) -> f64 {
    let mut squares = tolerance_mm * tolerance_mm;
    while squares.sqrt() > tolerance_mm {
        squares = squares.next_down();
    }
    while squares.next_up().sqrt() <= tolerance_mm {
        squares = squares.next_up();
    }
    squares
}

/// Price of the squared distance from the sample, in bits at the radius of the ball, by kind of row: higher where more
/// rows are predicted from the point. Chosen by measurement: a price on all levels gains 0.3 %, these prices 0.6 %;
/// choosing the cheapest point whatever its distance loses 3 %.
const DISTANCE_PRICES: [f64; KINDS] = [20.0, 20.0, 20.0, 20.0, 0.1, 5.0, 10.0, 20.0, 20.0, 20.0];
/// The price where no row is predicted from the point.
const LAST_LEVEL_PRICE: f64 = 0.1;

impl<'a> RowCodec for RowEncoder<'a, '_> {
    type Coder = RangeEncoder<'a>;

    fn coder(&mut self) -> &mut RangeEncoder<'a> {
        &mut self.coder
    }

    /// Chooses, of the lattice points around the sample inside the tolerance ball, the one with the smallest sum of
    /// estimated bits and priced distance.
    #[inline(always)]
    fn choose(&mut self, inputs: ResidualInputs) -> Point {
        let ResidualInputs { prediction, lattice, fineness, place, .. } = inputs;
        let reach = Reach::of(lattice, fineness);
        let (mut off, mut activity) = ([0.0; AXES], [0.0; AXES]);
        for axis in 0..3 {
            off[axis] = self.off[axis][place] * reach.steps_per_unit;
            activity[axis] = f64::from(inputs.activity[axis]) / 256.0;
        }
        let distance_price =
            if inputs.last_level { LAST_LEVEL_PRICE } else { DISTANCE_PRICES[inputs.kind] };
        let sample = self.samples.each_ref().map(|axis| axis[place]);
        let step = fineness.step(lattice) as f64;
        let is_inside = |steps: [f64; 3]| {
            let point = std::array::from_fn(|axis| prediction[axis] + steps[axis] * step);
            squared_distance(widen(self.grid.position(point)), widen(sample)) <= self.max_square
        };
        let cell = LatticeCell { off, activity, distance_price, reach };
        let steps = match lattice {
            Lattice::Cubic => cell.cheapest::<1, CELL_POINTS>(is_inside),
            Lattice::Centred => cell.cheapest::<2, { 2 * CELL_POINTS }>(is_inside),
        };
        steps.map(|steps| steps as i64)
    }

    fn choose_first(
        &mut self,
        channel: usize,
        row: usize,
        step: i64,
        origins: &[Point],
    ) -> FirstRow {
        let units = self.grid.units(self.channels[channel].positions()[row]);
        let steps_from = |from: &Point| -> Point {
            std::array::from_fn(|axis| {
                ((units[axis] - from[axis] as f64) / step as f64).round() as i64
            })
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
            (cost(&start.steps) + rank_cost, start)
        });
        ranked.min_by_key(|&(cost, start)| (cost, start.candidate)).unwrap_or_default().1
    }

    #[inline(always)]
    fn begin(&mut self, layout: &LevelLayout) {
        let rows = self.channels[layout.run.channel].positions();
        for i in 0..layout.n.min(PADDED_ROWS) {
            let sample = rows[layout.at(i) - PAST_ROWS];
            for (axis, coordinate) in self.samples.iter_mut().zip(sample) {
                axis[i] = coordinate;
            }
        }
    }

    #[inline(always)]
    fn outside<const N: usize>(&mut self, batch: Batch, predictions: &Points<N>) -> u32 {
        let squares = self.squares(batch, predictions);
        self.predicted_squares[..N].copy_from_slice(&squares);
        for (axis, off) in self.off.iter_mut().enumerate() {
            let samples: [f32; N] = lanes(&self.samples[axis], batch.from);
            let off = &mut off[batch.from..batch.from + N];
            for i in 0..N {
                off[i] = f64::from(samples[i]) / self.grid.unit_mm - predictions[axis][i];
            }
        }
        let mut bits = 0;
        for (i, squares) in squares.into_iter().enumerate() {
            bits |= u32::from(squares > self.max_square) << i;
        }
        bits
    }

    #[inline(always)]
    fn finish_rows<const N: usize>(&mut self, batch: Batch, points: &Points<N>, kept: u32) {
        // Rows that keep their predictions were measured in `outside`.
        let mut squares = [0.0; N];
        if kept == 0 {
            squares.copy_from_slice(&self.predicted_squares[..N]);
        } else {
            squares = self.squares(batch, points);
        }
        let most = &mut self.squares[batch.channel];
        for square in &squares[..batch.n] {
            *most = most.max(*square);
        }
        self.reports[batch.channel].kept += kept.count_ones();
        let mut kept = kept;
        while kept != 0 {
            self.kept_rows[batch.row(kept.trailing_zeros() as usize)] = true;
            kept &= kept - 1;
        }
    }
}

/// Lanes per vector of axes: three axes and one of padding.
const AXES: usize = 4;
/// Points of one lattice around a sample: the corners of its cell.
const CELL_POINTS: usize = 8;

/// The scale of a lattice: its steps per unit, and the radius in which candidates lie.
#[derive(Debug, Clone, Copy)]
struct Reach {
    steps_per_unit: f64,
    /// The squared tolerance in squared steps, plus 1 % for rounding; and its reciprocal.
    limit: f64,
    inverse_limit: f64,
}

impl Reach {
    const fn new(step: i64) -> Self {
        let radius = UNITS_PER_TOLERANCE / step as f64;
        let limit = radius * radius * 1.01;
        Self { steps_per_unit: 1.0 / step as f64, limit, inverse_limit: 1.0 / limit }
    }

    #[inline(always)]
    fn of(lattice: Lattice, fineness: Fineness) -> &'static Self {
        const fn all(fineness: Fineness) -> [Reach; 2] {
            [Reach::new(fineness.step(Lattice::Cubic)), Reach::new(fineness.step(Lattice::Centred))]
        }
        static ALL: [[Reach; 2]; 2] = [all(Fineness::Normal), all(Fineness::Fine)];
        &ALL[usize::from(fineness == Fineness::Fine)][usize::from(lattice == Lattice::Centred)]
    }
}

/// The lattice cell that contains a sample.
#[derive(Debug)]
struct LatticeCell<'a> {
    /// Offset of the sample from the prediction by axis, in steps.
    off: [f64; AXES],
    /// Average magnitudes by axis.
    activity: [f64; AXES],
    /// Price in bits of a distance of one tolerance.
    distance_price: f64,
    reach: &'a Reach,
}

impl LatticeCell<'_> {
    /// The steps to the cheapest of `N` lattice points that `is_inside`, the first of equals; zero where none is.
    /// `PARITIES` is 1 for the cubic lattice, 2 for the even and the odd points of the centred one.
    #[inline(always)]
    fn cheapest<const PARITIES: usize, const N: usize>(
        &self,
        is_inside: impl Fn([f64; 3]) -> bool,
    ) -> [f64; 3] {
        // A geometric distribution of mean a costs log2(1 + 1/a) bits per step, about 1.44 / (a + 0.35).
        let (mut slope, mut first) = ([0.0; AXES], [0.0; AXES]);
        for axis in 0..AXES {
            first[axis] = 0.6 / (self.activity[axis] + 0.3);
            slope[axis] = 1.44 / (self.activity[axis] + 0.35);
        }
        let mut costs = [f64::INFINITY; N];
        let mut axes = [CellAxes::default(); PARITIES];
        if PARITIES == 1 {
            axes[0] = CellAxes::new::<false>(0.0, &self.off, &slope, &first);
        } else {
            axes[0] = CellAxes::new::<true>(0.0, &self.off, &slope, &first);
            axes[1] = CellAxes::new::<true>(1.0, &self.off, &slope, &[0.0; AXES]);
        }
        let price = self.distance_price * self.reach.inverse_limit;
        for (axes, costs) in axes.iter().zip(costs.chunks_exact_mut(CELL_POINTS)) {
            axes.price(price, self.reach.limit, costs);
        }
        loop {
            let (cost, point) = cheapest(&costs);
            if cost == f64::INFINITY {
                return [0.0; 3];
            }
            let steps = axes[point / CELL_POINTS % PARITIES].steps_of(point % CELL_POINTS);
            if is_inside(steps) {
                return steps;
            }
            costs[point % N] = f64::INFINITY;
        }
    }
}

/// The coordinates of a cell's corners, by side of the sample and axis, with their distances and costs.
#[derive(Debug, Clone, Copy, Default)]
struct CellAxes {
    /// Steps below and above the sample; whole numbers.
    steps: [[f64; AXES]; 2],
    /// Squared distances from the sample, in squared steps.
    squares: [[f64; AXES]; 2],
    /// Estimated bits.
    bits: [[f64; AXES]; 2],
}

impl CellAxes {
    /// The corners of the cell; with `CENTRED`, of the points with odd (`odd` = 1) or even (0) coordinates. A magnitude
    /// costs `slope` bits per step, and `first` bits more for the first one.
    #[inline(always)]
    fn new<const CENTRED: bool>(
        odd: f64,
        off: &[f64; AXES],
        slope: &[f64; AXES],
        first: &[f64; AXES],
    ) -> Self {
        let mut axes = Self::default();
        for side in 0..2 {
            for axis in 0..AXES {
                let (steps, magnitude) = if CENTRED {
                    let below = 2.0 * floor((off[axis] - odd) * 0.5) + odd;
                    let steps = below + 2.0 * side as f64;
                    (steps, floor((steps.abs() + 1.0) * 0.5))
                } else {
                    let steps = floor(off[axis]) + side as f64;
                    (steps, steps.abs())
                };
                let distance = steps - off[axis];
                let bits = magnitude * slope[axis] + first[axis];
                axes.steps[side][axis] = steps;
                axes.squares[side][axis] = distance * distance;
                axes.bits[side][axis] = if magnitude == 0.0 { 0.0 } else { bits };
            }
        }
        axes
    }

    /// The costs of the eight corners, x varying fastest, then y; infinite beyond `limit`.
    #[inline(always)]
    fn price(&self, price: f64, limit: f64, costs: &mut [f64]) {
        let of = |values: &[[f64; AXES]; 2], axis: usize| [values[0][axis], values[1][axis]];
        let [x, y, z] = [0, 1, 2].map(|axis| (of(&self.squares, axis), of(&self.bits, axis)));
        for (k, costs) in costs.chunks_exact_mut(4).enumerate().take(2) {
            let mut squares = [0.0; 4];
            for (lane, squares) in squares.iter_mut().enumerate() {
                *squares = x.0[lane & 1] + y.0[lane >> 1] + z.0[k];
            }
            for (lane, cost) in costs.iter_mut().enumerate() {
                let bits = squares[lane] * price + x.1[lane & 1] + y.1[lane >> 1] + z.1[k];
                *cost = if squares[lane] <= limit { bits } else { f64::INFINITY };
            }
        }
    }

    /// The steps of a corner.
    #[inline(always)]
    fn steps_of(&self, point: usize) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.steps[point >> axis & 1][axis])
    }
}

/// The smallest cost and its index, the first of equals; the number of costs is a multiple of four.
#[inline(always)]
fn cheapest(costs: &[f64]) -> (f64, usize) {
    let (mut least, mut places) = ([f64::INFINITY; 4], [0; 4]);
    for (place, costs) in costs.chunks_exact(4).enumerate() {
        for lane in 0..4 {
            let better = costs[lane] < least[lane];
            least[lane] = if better { costs[lane] } else { least[lane] };
            places[lane] = if better { place } else { places[lane] };
        }
    }
    let mut best = (least[0], 4 * places[0]);
    for lane in 1..4 {
        let own = (least[lane], 4 * places[lane] + lane);
        let better = own.0 < best.0 || own.0 == best.0 && own.1 < best.1;
        best = if better { own } else { best };
    }
    best
}

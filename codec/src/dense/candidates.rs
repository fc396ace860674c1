//! The lattice points around a sample: those inside the tolerance ball, and the cheapest of them by estimated bits.

use super::points::{Fineness, Lattice, UNITS_PER_TOLERANCE, floor};

/// Lanes per vector of axes: three axes and one of padding.
pub(super) const AXES: usize = 4;
/// Points of one lattice around a sample: the corners of its cell.
pub(super) const CELL_POINTS: usize = 8;

/// The scale of a lattice: its steps per unit, and the radius in which candidates lie.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reach {
    pub(super) steps_per_unit: f64,
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
    pub(super) fn of(lattice: Lattice, fineness: Fineness) -> &'static Self {
        const fn all(fineness: Fineness) -> [Reach; 2] {
            [Reach::new(fineness.step(Lattice::Cubic)), Reach::new(fineness.step(Lattice::Centred))]
        }
        static ALL: [[Reach; 2]; 2] = [all(Fineness::Normal), all(Fineness::Fine)];
        &ALL[usize::from(fineness == Fineness::Fine)][usize::from(lattice == Lattice::Centred)]
    }
}

/// The lattice cell that contains a sample.
#[derive(Debug)]
pub(super) struct LatticeCell<'a> {
    /// Offset of the sample from the prediction by axis, in steps.
    pub(super) off: [f64; AXES],
    /// Average magnitudes by axis.
    pub(super) activity: [f64; AXES],
    /// Price in bits of a distance of one tolerance.
    pub(super) distance_price: f64,
    pub(super) reach: &'a Reach,
}

impl LatticeCell<'_> {
    /// The steps to the cheapest of the `N` lattice points for which `is_inside` holds, the first of equals; zero
    /// if there is none. `PARITIES` is 1 for the cubic lattice, 2 for the even and the odd points of the centred
    /// one.
    #[inline(always)]
    pub(super) fn cheapest<const PARITIES: usize, const N: usize>(
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

    /// Passes the steps to all corners of the cell to `take`: eight for each of the `PARITIES`.
    pub(super) fn corners<const PARITIES: usize>(&self, take: &mut impl FnMut([f64; 3])) {
        for parity in 0..PARITIES {
            let (odd, free) = (parity as f64, [0.0; AXES]);
            let axes = match PARITIES {
                1 => CellAxes::new::<false>(odd, &self.off, &free, &free),
                _ => CellAxes::new::<true>(odd, &self.off, &free, &free),
            };
            (0..CELL_POINTS).for_each(|point| take(axes.steps_of(point)));
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

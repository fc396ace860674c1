//! The corners of the lattice's cell around a sample, and what each costs: worked out side by side.

use super::lattice::floor;

/// Axes side by side: three, and one to fill the lanes.
pub(super) const AXES: usize = 4;
/// Of the cell that a sample is in.
pub(super) const CORNERS: usize = 8;

/// What the axes of the lattice points on both sides of the sample say.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Around {
    /// Below the sample and above it, whole numbers.
    steps: [[f64; AXES]; 2],
    /// The squares of their distances from the sample, in steps.
    squares: [[f64; AXES]; 2],
    bits: [[f64; AXES]; 2],
}

impl Around {
    /// Of the points whose coordinates are all `odd` or all even, or of any; a magnitude costs `slope` for each
    /// step, and `first` for the first one.
    #[inline(always)]
    pub(super) fn new<const CENTRED: bool>(
        odd: f64,
        off: &[f64; AXES],
        slope: &[f64; AXES],
        first: &[f64; AXES],
    ) -> Self {
        let mut around = Self::default();
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
                let miss = steps - off[axis];
                let bits = magnitude * slope[axis] + first[axis];
                around.steps[side][axis] = steps;
                around.squares[side][axis] = miss * miss;
                around.bits[side][axis] = if magnitude == 0.0 { 0.0 } else { bits };
            }
        }
        around
    }

    /// What the corners cost: x changes from one to the next, then y, then z.
    #[inline(always)]
    pub(super) fn price(&self, price: f64, limit: f64, costs: &mut [f64]) {
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

    #[inline(always)]
    pub(super) fn corner(&self, corner: usize) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.steps[corner >> axis & 1][axis])
    }
}

/// The smallest of some costs, a multiple of four, and which it is: the first of equals.
#[inline(always)]
pub(super) fn cheapest(costs: &[f64]) -> (f64, usize) {
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

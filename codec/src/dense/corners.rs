//! The corners of the lattice's cell around a sample, and what each costs: worked out side by side.

use super::lattice::{Fineness, Lattice, floor};

/// Axes side by side: three, and one to fill the lanes.
pub(super) const AXES: usize = 4;
/// Of the cell that a sample is in.
pub(super) const CORNERS: usize = 8;

/// How far the points of a lattice that come into question are from a sample.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reach {
    /// Steps per unit.
    pub(super) per_step: f64,
    /// The largest square, in steps, and a little; and one over it.
    limit: f64,
    per_limit: f64,
}

impl Reach {
    const fn new(step: i64) -> Self {
        let radius = 256.0 / step as f64;
        let limit = radius * radius * 1.01;
        Self { per_step: 1.0 / step as f64, limit, per_limit: 1.0 / limit }
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

/// The cell of a lattice that a sample is in.
#[derive(Debug)]
pub(super) struct Cell<'a> {
    /// By axis: from where the row is expected to the sample, in steps.
    pub(super) off: [f64; AXES],
    /// What the magnitudes have lately been on average.
    pub(super) activity: [f64; AXES],
    /// What a miss as far as can be costs, in bits.
    pub(super) miss: f64,
    pub(super) reach: &'a Reach,
}

impl Cell<'_> {
    /// The steps to the cheapest corner that `is_inside`, the first of equals; 0 0 0 where none is. Of a lattice of
    /// one kind of points, any, or of two, all even and all odd.
    #[inline(always)]
    pub(super) fn cheapest<const KINDS: usize, const N: usize>(
        &self,
        is_inside: impl Fn([f64; 3]) -> bool,
    ) -> [f64; 3] {
        let (mut slope, mut first) = ([0.0; AXES], [0.0; AXES]);
        for axis in 0..AXES {
            first[axis] = 0.6 / (self.activity[axis] + 0.3);
            slope[axis] = 1.44 / (self.activity[axis] + 0.35);
        }
        let mut costs = [f64::INFINITY; N];
        let mut around = [Around::default(); KINDS];
        if KINDS == 1 {
            around[0] = Around::new::<false>(0.0, &self.off, &slope, &first);
        } else {
            around[0] = Around::new::<true>(0.0, &self.off, &slope, &first);
            around[1] = Around::new::<true>(1.0, &self.off, &slope, &[0.0; AXES]);
        }
        let price = self.miss * self.reach.per_limit;
        for (around, costs) in around.iter().zip(costs.chunks_exact_mut(CORNERS)) {
            around.price(price, self.reach.limit, costs);
        }
        loop {
            let (cost, corner) = cheapest(&costs);
            if cost == f64::INFINITY {
                return [0.0; 3];
            }
            let steps = around[corner / CORNERS % KINDS].corner(corner % CORNERS);
            if is_inside(steps) {
                return steps;
            }
            costs[corner % N] = f64::INFINITY;
        }
    }
}

/// What the axes of the lattice points on both sides of the sample say.
#[derive(Debug, Clone, Copy, Default)]
struct Around {
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
    fn new<const CENTRED: bool>(
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

    #[inline(always)]
    fn corner(&self, corner: usize) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.steps[corner >> axis & 1][axis])
    }
}

/// The smallest of some costs, a multiple of four, and which it is: the first of equals.
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

//! Fixed-point positions, the lattices of the residuals, and the lattice points around a sample: those inside the
//! tolerance ball, and the cheapest of them by estimated bits.
//!
//! Residuals are vectors of a lattice whose covering radius is smaller than the tolerance, so that the ball around
//! every sample holds a lattice point. The cubic lattice has an edge of 2/sqrt(3) tolerances. The points of the
//! body-centred cubic lattice have three even or three odd coordinates in steps of 2/sqrt(5) tolerances (covering
//! radii: Conway and Sloane, Sphere packings, lattices and groups, chapter 4). The second needs 0.9 bits less for a
//! long vector, the first has more points close to zero.

use crate::{Position, Tolerance};

/// Units per tolerance. A power of two, so that the unit is exact in f64.
pub(super) const UNITS_PER_TOLERANCE: f64 = 256.0;

/// Largest coordinate that the encoder codes, in units; 429 km at a tolerance of 0.1 mm. Larger ones are stored raw.
const MAX_SAMPLE: f64 = (1_i64 << 40) as f64;

/// Largest coordinate that the decoder accepts, in units: twice the encoder's limit, which covers a lattice step.
const MAX_DECODED: f64 = (1_i64 << 41) as f64;

/// A position in units, x y z.
pub(super) type Point = [i64; 3];

/// The positions of `N` rows in units, axis by axis.
pub(super) type Points<const N: usize> = [[f64; N]; 3];

/// Rows of one vector operation.
pub(super) const LANES: usize = 4;

/// Converts a decoded point, whose coordinates are whole, to integers.
#[inline(always)]
pub(super) fn integers(units: [f64; 3]) -> Point {
    units.map(|units| units as i64)
}

/// The fixed-point grid of one tolerance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    /// The size of a unit in millimetres.
    pub(super) unit_mm: f64,
}

impl Grid {
    pub(super) fn new(tolerance: Tolerance) -> Self {
        Self { unit_mm: tolerance.mm() / UNITS_PER_TOLERANCE }
    }

    pub(super) fn tolerance_mm(&self) -> f64 {
        self.unit_mm * UNITS_PER_TOLERANCE
    }

    /// The float32 position that a decoder outputs for a point in units.
    #[inline(always)]
    pub(super) fn position(&self, units: [f64; 3]) -> Position {
        units.map(|units| (units * self.unit_mm) as f32)
    }

    /// The float32 positions of `N` rows, axis by axis.
    #[inline(always)]
    pub(super) fn positions<const N: usize>(&self, units: &Points<N>) -> [[f32; N]; 3] {
        let mut positions = [[0.0; N]; 3];
        for axis in 0..3 {
            for i in 0..N {
                positions[axis][i] = (units[axis][i] * self.unit_mm) as f32;
            }
        }
        positions
    }

    /// A sample in units, unrounded.
    pub(super) fn units(&self, sample: Position) -> [f64; 3] {
        sample.map(|mm| f64::from(mm) / self.unit_mm)
    }

    /// The coarsest fineness that keeps the tolerance for coordinates up to `max_mm`, float32 rounding of the
    /// reconstruction included; `None` where no fineness does.
    pub(super) fn fineness(&self, max_mm: f32) -> Option<Fineness> {
        let max_units = f64::from(max_mm) / self.unit_mm;
        if max_units > MAX_SAMPLE {
            return None;
        }
        let reach = f64::from(max_mm) + 2.0 * self.unit_mm * UNITS_PER_TOLERANCE;
        let ulp_units = f64::from((reach as f32).next_up() - reach as f32) / self.unit_mm;
        // Rounding is off by half a unit in the last place on each axis: sqrt(3) / 2 = 0.866 of one in 3D, rounded up.
        let rounding = 0.88 * ulp_units + 0.01;
        [Fineness::Normal, Fineness::Fine]
            .into_iter()
            .find(|fineness| fineness.covering_radius() + rounding <= UNITS_PER_TOLERANCE)
    }
}

/// Whether the first `n` points lie within [`MAX_DECODED`], as those of every encoder do.
#[inline(always)]
pub(super) fn in_range<const N: usize>([x, y, z]: &Points<N>, n: usize) -> bool {
    let mut in_range = [true; N];
    for i in 0..N {
        in_range[i] =
            (x[i].abs() <= MAX_DECODED) & (y[i].abs() <= MAX_DECODED) & (z[i].abs() <= MAX_DECODED);
    }
    in_range.iter().enumerate().fold(true, |all, (i, in_range)| all & (*in_range | (i >= n)))
}

/// The size of the lattice steps: how much of the tolerance they leave for the rounding to float32.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Fineness {
    /// Leaves 0.9 %: enough for rooms at a tolerance of a tenth of a millimetre.
    #[default]
    Normal,
    /// Leaves 13 %: for coordinates that are huge compared with the tolerance.
    Fine,
}

/// The two lattices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Lattice {
    /// Cubic: the coordinates are any integers.
    Cubic,
    /// Body-centred cubic: the coordinates are all even or all odd.
    Centred,
}

impl Lattice {
    /// The lattice for the activities of a row's kind (x, y, z and sum, in 1/256): centred from an average sum of one
    /// step on. Used where residuals are long it gains 0.9 %, 4 % at 0.1 mm; used everywhere it loses 0.7 %.
    #[inline(always)]
    pub(super) fn of(activity: &[i32; 4]) -> Self {
        if activity[3] >= 256 { Self::Centred } else { Self::Cubic }
    }

    /// Whether the lattice has the point at these steps.
    pub(super) fn contains(self, [x, y, z]: Point) -> bool {
        self == Self::Cubic || ((x ^ y) | (x ^ z)) & 1 == 0
    }
}

impl Fineness {
    /// Units of one lattice step: 256 * 2 / sqrt(3) = 295.6 and 256 * 2 / sqrt(5) = 229.0 less the room for rounding.
    pub(super) const fn step(self, lattice: Lattice) -> i64 {
        match (self, lattice) {
            (Self::Normal, Lattice::Cubic) => 293,
            (Self::Normal, Lattice::Centred) => 227,
            (Self::Fine, Lattice::Cubic) => 256,
            (Self::Fine, Lattice::Centred) => 198,
        }
    }

    /// The larger covering radius of the two lattices, in units: sqrt(3)/2 cubic steps, sqrt(5)/2 centred steps.
    fn covering_radius(self) -> f64 {
        let cubic = self.step(Lattice::Cubic) as f64 * 0.866_026;
        let centred = self.step(Lattice::Centred) as f64 * 1.118_034;
        cubic.max(centred)
    }
}

/// Rounds down, for magnitudes below 2^51. Compiles to additions, also where the processor has no rounding
/// instruction.
#[inline(always)]
pub(super) fn floor(value: f64) -> f64 {
    /// 1.5 * 2^52: a sum with it has no bits for a fraction.
    const WHOLE: f64 = (3_u64 << 51) as f64;
    let near = (value + WHOLE) - WHOLE;
    near - if near > value { 1.0 } else { 0.0 }
}

/// Rounds to the nearest integer, halves up.
#[inline(always)]
pub(super) fn round(value: f64) -> f64 {
    floor(value + 0.5)
}

/// Stores [`LANES`] values from index `first` on, where there is room.
#[inline(always)]
pub(super) fn put(values: &mut [f64], first: usize, lanes: [f64; LANES]) {
    if let Some(values) = values[first..].first_chunk_mut() {
        *values = lanes;
    }
}

/// Loads `N` values from index `first` on.
#[inline(always)]
pub(super) fn lanes<T: Copy + Default, const N: usize>(values: &[T], first: usize) -> [T; N] {
    let mut lanes = [T::default(); N];
    lanes.copy_from_slice(&values[first..first + N]);
    lanes
}

/// Copies the first `n` of `N` values to the start of `out`, which has room for `N`.
#[inline(always)]
pub(super) fn copy<T: Copy, const N: usize>(values: &[T; N], out: &mut [T], n: usize) {
    match out.first_chunk_mut() {
        // The usual case is one vector store.
        Some(out) if n == N => *out = *values,
        Some(out) => {
            for i in 0..N {
                if i < n {
                    out[i] = values[i];
                }
            }
        }
        None => {}
    }
}

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

//! Fixed-point positions, and the lattices of the residuals.
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
pub(super) const MAX_SAMPLE: f64 = (1_i64 << 40) as f64;

/// Largest coordinate that the decoder accepts, in units: twice the encoder's limit, which covers a lattice step.
pub(super) const MAX_DECODED: f64 = (1_i64 << 41) as f64;

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

//! Fixed point: positions as integers of a fine unit, and the lattices that residuals lie on.
//!
//! Residuals are vectors of a lattice whose every hole is smaller than the tolerance ball: the cubic
//! one, edge 2/sqrt(3) of the tolerance, or the body-centred cubic one, whose points have all three
//! coordinates even or all three odd in steps of 2/sqrt(5) (covering radii: Conway and Sloane, Sphere
//! packings, lattices and groups, chapter 4). The second needs 0.9 bits less for a long vector, the first
//! has more points close to zero.

use crate::{Position, Tolerance};

/// Units per tolerance. A power of two: the unit is then exact in f64.
pub(super) const UNITS_PER_TOLERANCE: f64 = 256.0;

/// Coordinates that the encoder takes, in units; 110 km at 0.1 mm.
pub(super) const MAX_SAMPLE: f64 = (1_i64 << 40) as f64;

/// Coordinates that a decoder takes: the largest sample and a step of slack, and then some.
pub(super) const MAX_DECODED: f64 = (1_i64 << 41) as f64;

/// A point on the grid, in units.
pub(super) type Point = [i64; 3];

/// Points of some rows by axis, in units.
pub(super) type Points<const N: usize> = [[f64; N]; 3];

/// Rows side by side.
pub(super) const LANES: usize = 4;

/// A known point, whole as it is.
#[inline(always)]
pub(super) fn integers(units: [f64; 3]) -> Point {
    units.map(|units| units as i64)
}

/// The grid of one tolerance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    /// The size of a unit.
    pub(super) unit_mm: f64,
}

impl Grid {
    pub(super) fn new(tolerance: Tolerance) -> Self {
        Self { unit_mm: tolerance.mm() / UNITS_PER_TOLERANCE }
    }

    pub(super) fn tolerance_mm(&self) -> f64 {
        self.unit_mm * UNITS_PER_TOLERANCE
    }

    /// What the decoder gives for a point.
    #[inline(always)]
    pub(super) fn position(&self, units: [f64; 3]) -> Position {
        units.map(|units| (units * self.unit_mm) as f32)
    }

    /// The same for some rows, by axis.
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

    /// A sample in units, not rounded.
    pub(super) fn units(&self, sample: Position) -> [f64; 3] {
        sample.map(|mm| f64::from(mm) / self.unit_mm)
    }

    /// The coarsest fineness whose lattices reach every sample of a channel whose coordinates are at most
    /// `max_mm`, float32 rounding of the reconstruction included; none where even the finest does not.
    pub(super) fn fineness(&self, max_mm: f32) -> Option<Fineness> {
        let max_units = f64::from(max_mm) / self.unit_mm;
        if max_units > MAX_SAMPLE {
            return None;
        }
        let reach = f64::from(max_mm) + 2.0 * self.unit_mm * UNITS_PER_TOLERANCE;
        let ulp_units = f64::from((reach as f32).next_up() - reach as f32) / self.unit_mm;
        // Half a unit in the last place on each axis, sqrt(3) / 2 of it in 3D, and a little.
        let rounding = 0.88 * ulp_units + 0.01;
        [Fineness::Normal, Fineness::Fine]
            .into_iter()
            .find(|fineness| fineness.covering_radius() + rounding <= UNITS_PER_TOLERANCE)
    }
}

/// Whether the first `n` of some decoded points can have come from an encoder.
#[inline(always)]
pub(super) fn in_range<const N: usize>([x, y, z]: &Points<N>, n: usize) -> bool {
    let mut in_range = [true; N];
    for i in 0..N {
        in_range[i] =
            (x[i].abs() <= MAX_DECODED) & (y[i].abs() <= MAX_DECODED) & (z[i].abs() <= MAX_DECODED);
    }
    in_range.iter().enumerate().fold(true, |all, (i, in_range)| all & (*in_range | (i >= n)))
}

/// How much of the tolerance is left for the rounding to float32.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Fineness {
    /// 0.9 %: rooms at a tenth of a millimetre.
    #[default]
    Normal,
    /// 13 %: for coordinates that are huge beside the tolerance.
    Fine,
}

/// The two lattices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Lattice {
    /// Any integers.
    Cubic,
    /// All even or all odd.
    Centred,
}

impl Lattice {
    /// That of a row with these activities, the last one of the sum.
    #[inline(always)]
    pub(super) fn of(activity: &[i32; 4]) -> Self {
        if activity[3] >= 256 { Self::Centred } else { Self::Cubic }
    }
}

impl Fineness {
    /// Units of one lattice step.
    pub(super) const fn step(self, lattice: Lattice) -> i64 {
        match (self, lattice) {
            (Self::Normal, Lattice::Cubic) => 293,
            (Self::Normal, Lattice::Centred) => 227,
            (Self::Fine, Lattice::Cubic) => 256,
            (Self::Fine, Lattice::Centred) => 198,
        }
    }

    /// Of the lattice that leaves less room, in units: sqrt(3)/2 of the cubic, sqrt(5)/2 of the centred step.
    fn covering_radius(self) -> f64 {
        let cubic = self.step(Lattice::Cubic) as f64 * 0.866_026;
        let centred = self.step(Lattice::Centred) as f64 * 1.118_034;
        cubic.max(centred)
    }
}

/// The largest integer that is not above `value`, which is below 2^51 in size; without a call where the
/// processor has no rounding instruction.
#[inline(always)]
pub(super) fn floor(value: f64) -> f64 {
    /// A sum with it has no room for a fraction.
    const WHOLE: f64 = (3_u64 << 51) as f64;
    let near = (value + WHOLE) - WHOLE;
    near - if near > value { 1.0 } else { 0.0 }
}

/// Nearest integer, halves up.
#[inline(always)]
pub(super) fn round(value: f64) -> f64 {
    floor(value + 0.5)
}

/// Stores some rows side by side; there is room.
#[inline(always)]
pub(super) fn put(values: &mut [f64], first: usize, lanes: [f64; LANES]) {
    if let Some(values) = values[first..].first_chunk_mut() {
        *values = lanes;
    }
}

/// Some rows side by side; the lanes are long enough.
#[inline(always)]
pub(super) fn lanes<T: Copy + Default, const N: usize>(values: &[T], first: usize) -> [T; N] {
    let mut lanes = [T::default(); N];
    lanes.copy_from_slice(&values[first..first + N]);
    lanes
}

/// Copies the first `n` of some values to where there is room for all.
#[inline(always)]
pub(super) fn copy<T: Copy, const N: usize>(values: &[T; N], out: &mut [T], n: usize) {
    match out.first_chunk_mut() {
        // Most often: one store.
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

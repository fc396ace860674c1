//! Fixed point: positions as integers of a fine unit, so that every prediction is the same on every CPU.

use crate::{Position, Tolerance};

/// Units per tolerance. A power of two: the unit is then exact in f64.
pub(super) const UNITS_PER_TOLERANCE: i64 = 256;

/// The lattice step in units: the edge of the cube inside the tolerance ball, 2/sqrt(3) * 256,
/// rounded down.
pub(super) const STEP: i64 = 295;

/// Coordinates that the encoder takes, in units; 110 km at 0.1 mm.
pub(super) const MAX_SAMPLE: f64 = (1_i64 << 40) as f64;

/// Coordinates that a decoder takes: the largest sample and a step of slack, and then some.
pub(super) const MAX_DECODED: u64 = 1 << 41;

/// A point on the grid.
pub(super) type Point = [i64; 3];

/// The grid of one tolerance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    unit_mm: f64,
}

impl Grid {
    pub(super) fn new(tolerance: Tolerance) -> Self {
        Self { unit_mm: tolerance.mm() / UNITS_PER_TOLERANCE as f64 }
    }

    /// What the decoder gives for a point.
    pub(super) fn position(&self, point: Point) -> Position {
        point.map(|units| (units as f64 * self.unit_mm) as f32)
    }

    /// A sample in units, not rounded; none when it lies beyond [`MAX_SAMPLE`].
    pub(super) fn units(&self, sample: Position) -> Option<[f64; 3]> {
        let units = sample.map(|mm| f64::from(mm) / self.unit_mm);
        units.iter().all(|u| u.abs() <= MAX_SAMPLE).then_some(units)
    }
}

/// Whether a decoded point can have come from an encoder.
pub(super) fn in_range(point: Point) -> bool {
    point.iter().all(|units| units.unsigned_abs() <= MAX_DECODED)
}

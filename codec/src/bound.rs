//! The error bound: the tolerance, the distances that are measured, and the six bits in which a block states them.

use crate::{CodecError, Position};

/// Largest Euclidean distance in 3D, in millimetres, between a sample and its reconstruction.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Tolerance(f64);

impl Tolerance {
    /// The smallest tolerance: below it, a float32 position at room scale has no redundant digits.
    pub const MIN_MM: f64 = 1e-4;
    /// The largest tolerance: anything beyond a kilometre is a typing error.
    pub const MAX_MM: f64 = 1e6;
    /// The step of a block that states the whole tolerance as its error.
    pub const STEPS: u8 = STATED_STEPS;

    /// The tolerance of `mm` millimetres.
    ///
    /// # Errors
    /// `InvalidArgument` when `mm` is not finite or outside `MIN_MM..=MAX_MM`.
    pub fn from_mm(mm: f64) -> Result<Self, CodecError> {
        if mm.is_finite() && (Self::MIN_MM..=Self::MAX_MM).contains(&mm) {
            return Ok(Self(mm));
        }
        Err(CodecError::InvalidArgument(format!(
            "a tolerance of {mm} mm is outside {} mm to {} m; for exact samples use --lossless",
            Self::MIN_MM,
            Self::MAX_MM / 1000.0
        )))
    }

    /// The tolerance in millimetres.
    #[must_use]
    pub fn mm(self) -> f64 {
        self.0
    }

    /// The error bound in millimetres that a block states with [`stated_error_step`](crate::stated_error_step): up to
    /// [`STEPS`](Self::STEPS), a step is a fraction of the tolerance.
    #[must_use]
    pub fn stated_mm(self, step: u8) -> f64 {
        stated_mm(step, self.0)
    }
}

/// The stated bound is a multiple of 1/63 of the tolerance: the largest number of six bits.
pub(crate) const STATED_STEPS: u8 = 63;

/// One f64 per axis.
pub(crate) type Vector = [f64; 3];

/// Converts to f64, which is exact.
#[inline(always)]
pub(crate) fn widen(position: Position) -> Vector {
    position.map(f64::from)
}

/// The squared Euclidean distance. The order of operations is fixed, so that every machine gets the same bits.
#[inline(always)]
pub(crate) fn squared_distance(a: Vector, b: Vector) -> f64 {
    let (x, y, z) = (a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    x * x + y * y + z * z
}

/// Euclidean distance in f64, in millimetres.
pub(crate) fn distance_mm(a: Position, b: Position) -> f64 {
    squared_distance(widen(a), widen(b)).sqrt()
}

/// The bound that `step` (0 to 63) states, in millimetres.
pub(crate) fn stated_mm(step: u8, tolerance_mm: f64) -> f64 {
    match step {
        0 => 0.0,
        // The division below could round to more than the tolerance.
        STATED_STEPS.. => tolerance_mm,
        _ => tolerance_mm * f64::from(step) / f64::from(STATED_STEPS),
    }
}

/// The smallest step that states at least `error_mm`; `None` when the error exceeds the tolerance.
pub(crate) fn stated_step(error_mm: f64, tolerance_mm: f64) -> Option<u8> {
    if error_mm.is_nan() || error_mm > tolerance_mm {
        return None;
    }
    let guess = (error_mm / tolerance_mm * f64::from(STATED_STEPS)).ceil() as u8;
    (guess..=STATED_STEPS).find(|&step| stated_mm(step, tolerance_mm) >= error_mm)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stated_bound_covers_the_error_and_keeps_the_tolerance() {
        for tolerance in [1e-4, 0.1, 0.3, 1.0, 7.7, 1e6] {
            for i in 0..=10_000 {
                let error = tolerance * f64::from(i) / 10_000.0;
                let step = stated_step(error, tolerance).unwrap();
                let stated = stated_mm(step, tolerance);
                assert!(stated >= error && stated <= tolerance, "{error} {stated} {tolerance}");
                let finer = stated_mm(step.saturating_sub(1), tolerance);
                assert!(step == 0 || finer < error, "{step} is not the smallest for {error}");
            }
            assert_eq!(stated_step(tolerance.next_up(), tolerance), None);
        }
        assert_eq!(stated_step(f64::NAN, 1.0), None);
    }
}

//! The promise of a block: how far it lies from its samples, measured and then stated in six bits.

use crate::Position;

/// Steps of the stated bound.
pub(crate) const STATED_STEPS: u8 = 63;

/// Euclidean distance in f64, in millimetres.
pub(crate) fn distance_mm(a: Position, b: Position) -> f64 {
    squares(a, b).sqrt()
}

/// The square of the distance.
pub(crate) fn squares(a: Position, b: Position) -> f64 {
    let square = |axis: usize| {
        let d = f64::from(a[axis]) - f64::from(b[axis]);
        d * d
    };
    square(0) + square(1) + square(2)
}

/// The bound that a step states, in millimetres.
pub(crate) fn stated_mm(step: u8, tolerance_mm: f64) -> f64 {
    match step {
        0 => 0.0,
        // Not by the division below: rounding must not carry it over the tolerance.
        STATED_STEPS.. => tolerance_mm,
        _ => tolerance_mm * f64::from(step) / f64::from(STATED_STEPS),
    }
}

/// The smallest step that states at least `error_mm`; none when that is over the tolerance.
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

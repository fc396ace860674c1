//! A low-pass filter that can be evaluated between samples: smoothing and resampling in one step.
//!
//! A sinc with a Kaiser window (Kaiser, "Nonrecursive digital filter design using the I0-sinh window function", 1974).
//! It is symmetric, so its phase is zero.

use std::f64::consts::PI;

use crate::RATES_HZ;

/// Stop band edge: just below half the lowest rate, so that every rate represents the filtered motion in full.
pub(crate) const STOP_HZ: f64 = RATES_HZ[0] / 2.0 - 1.0;

/// Width of the transition from pass band to stop band. A narrower one needs a longer filter, which loses more of
/// both ends of a take; a wider one attenuates the motion, which in running extends to about 20 Hz.
const TRANSITION_HZ: f64 = 10.0;

/// Attenuation of the stop band: 100 dB reduce an amplitude of one metre to 10 um.
const STOP_DB: f64 = 100.0;

/// The frequency at which the amplitude is halved.
const CUTOFF_HZ: f64 = STOP_HZ - TRANSITION_HZ / 2.0;

/// Half the length of the filter in seconds. Kaiser's formula for the length is (dB - 7.95) / 14.36 / transition.
pub(crate) const HALF_WIDTH_S: f64 = (STOP_DB - 7.95) / 14.36 / TRANSITION_HZ / 2.0;

/// The weight of a sample at a distance of `away_s` seconds. The caller divides by the sum of the weights, so that a
/// marker at rest keeps its position exactly.
pub(crate) fn weight(away_s: f64) -> f64 {
    let part = away_s / HALF_WIDTH_S;
    if part.abs() >= 1.0 {
        return 0.0;
    }
    let beta = 0.1102 * (STOP_DB - 8.7);
    let phase = 2.0 * PI * CUTOFF_HZ * away_s;
    let sinc = if phase == 0.0 { 1.0 } else { phase.sin() / phase };
    sinc * bessel_i0(beta * (1.0 - part * part).sqrt())
}

/// The modified Bessel function of the first kind and order 0, by its power series.
fn bessel_i0(x: f64) -> f64 {
    let (mut sum, mut term, mut k) = (1.0, 1.0, 1.0);
    while term > 1e-15 * sum {
        term *= (x / (2.0 * k)).powi(2);
        sum += term;
        k += 1.0;
    }
    sum
}

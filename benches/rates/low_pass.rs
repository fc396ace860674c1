//! A low-pass filter that can be evaluated between samples: smoothing and resampling in one step.
//!
//! A sinc under a Kaiser window (Kaiser, "Nonrecursive digital filter design using the I0-sinh window
//! function", 1974), symmetric and so without a phase.

use std::f64::consts::PI;

use crate::RATES_HZ;

/// From here up nothing is left: just below half the lowest rate, so that every rate holds all of it.
pub(crate) const STOP_HZ: f64 = RATES_HZ[0] / 2.0 - 1.0;

/// From what is kept whole to what is gone. Narrower, the filter would need more of both ends of a
/// take; wider, it would flatten the motion, which in running reaches to about 20 Hz.
const TRANSITION_HZ: f64 = 10.0;

/// How far down what should be gone is: 100 dB make 10 um of a metre.
const STOP_DB: f64 = 100.0;

/// Where half of the amplitude passes.
const CUTOFF_HZ: f64 = STOP_HZ - TRANSITION_HZ / 2.0;

/// How far the filter looks to both sides, in seconds: Kaiser's length, (dB - 7.95) / 14.36 over the
/// transition, halved.
pub(crate) const HALF_WIDTH_S: f64 = (STOP_DB - 7.95) / 14.36 / TRANSITION_HZ / 2.0;

/// The weight of a sample so many seconds away. Weights are to be divided by their sum, which leaves
/// a marker at rest exactly where it is.
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

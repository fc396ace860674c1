//! The low-pass filter of biomechanics: a second-order Butterworth forwards and backwards, so that nothing is
//! shifted in time and the order is four, with the cutoff corrected for the two passes.
//!
//! D. A. Winter, "Biomechanics and Motor Control of Human Movement", 4th ed. 2009, section 3.4.4.2. Padding and
//! the state at the beginning are those of `scipy.signal.filtfilt` (Gustafsson's odd extension), which
//! `tests/oracle/check_butterworth.py` compares with.

use crate::ReportError;

/// What a cutoff is divided by, as `tan(pi f / rate)`, so that two passes together have half the power there:
/// `(2^(1/2) - 1)^(1/4)`.
pub const TWO_PASSES: f64 = 0.802_243_262_923_150_2;

/// The filter for one rate and cutoff.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Butterworth {
    /// Weights of the input, now and before.
    b: [f64; 3],
    /// Weights of the output before, of which the first is 1.
    a: [f64; 3],
    /// Rows by which a run is extended at each end.
    n_pad: usize,
    period_rows: f64,
}

impl Butterworth {
    /// `cutoff_hz` is where both passes together let half of the power through (-3.01 dB).
    ///
    /// # Errors
    /// `InvalidArgument` when the cutoff is not between 0 and half the rate.
    pub fn new(cutoff_hz: f64, rate_hz: f64) -> Result<Self, ReportError> {
        let possible = cutoff_hz.is_finite() && rate_hz.is_finite() && cutoff_hz > 0.0;
        if !possible || cutoff_hz >= 0.5 * rate_hz {
            return Err(ReportError::InvalidArgument(format!(
                "a cutoff of {cutoff_hz} Hz cannot be at {rate_hz} Hz: choose one above 0 and below half the rate"
            )));
        }
        let w = (std::f64::consts::PI * cutoff_hz / rate_hz).tan() / TWO_PASSES;
        let scale = 1.0 / (1.0 + std::f64::consts::SQRT_2 * w + w * w);
        let b0 = w * w * scale;
        let a1 = 2.0 * (w * w - 1.0) * scale;
        let a2 = (1.0 - std::f64::consts::SQRT_2 * w + w * w) * scale;
        let period_rows = rate_hz / cutoff_hz;
        // Three times the order at least, as SciPy has it, and long enough for the slowest filter to settle.
        let n_pad = 9.max(period_rows.ceil().min(1e6) as usize);
        Ok(Self { b: [b0, 2.0 * b0, b0], a: [1.0, a1, a2], n_pad, period_rows })
    }

    /// The shortest run that can be filtered: one period of the cutoff. What is shorter is all ends.
    #[must_use]
    pub fn rows_min(&self) -> usize {
        (self.period_rows.ceil().min(1e9) as usize).max(4)
    }

    /// Filters one run of values, in their own unit; as long as it was. A run shorter than
    /// [`rows_min`](Self::rows_min) comes back as it is.
    #[must_use]
    pub fn filter(&self, values: &[f64]) -> Vec<f64> {
        let n = values.len();
        if n < self.rows_min() {
            return values.to_vec();
        }
        let n_pad = self.n_pad.min(n - 1);
        let (first, last) = (values[0], values[n - 1]);
        let mut padded = Vec::with_capacity(n + 2 * n_pad);
        padded.extend((1..=n_pad).rev().map(|i| 2.0 * first - values[i]));
        padded.extend_from_slice(values);
        padded.extend((1..=n_pad).map(|i| 2.0 * last - values[n - 1 - i]));
        for _ in 0..2 {
            self.pass(&mut padded);
            padded.reverse();
        }
        padded[n_pad..n_pad + n].to_vec()
    }

    /// Once through, beginning as if the first value had been there for ever.
    fn pass(&self, values: &mut [f64]) {
        let Some(&first) = values.first() else { return };
        let ([b0, b1, b2], [_, a1, a2]) = (self.b, self.a);
        let mut z2 = (b2 - a2) * first;
        let mut z1 = (b1 - a1) * first + z2;
        for value in values {
            let x = *value;
            let y = b0 * x + z1;
            z1 = b1 * x - a1 * y + z2;
            z2 = b2 * x - a2 * y;
            *value = y;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    /// Amplitude and phase of what is left of a sine, by its products with a sine and a cosine over whole periods.
    fn response(filter: &Butterworth, frequency_hz: f64, rate_hz: f64) -> (f64, f64) {
        let n = 4000;
        let angle = |i: usize| 2.0 * PI * frequency_hz * i as f64 / rate_hz;
        let sine: Vec<f64> = (0..n).map(|i| angle(i).sin()).collect();
        let filtered = filter.filter(&sine);
        let middle = 1000..3000;
        let product = |f: fn(f64) -> f64| -> f64 {
            middle.clone().map(|i| filtered[i] * f(angle(i))).sum::<f64>() / 1000.0
        };
        let (s, c) = (product(f64::sin), product(f64::cos));
        (s.hypot(c), c.atan2(s))
    }

    #[test]
    fn half_the_power_at_the_cutoff_and_no_phase() {
        for rate_hz in [60.0, 120.0, 240.0, 1000.0] {
            let filter = Butterworth::new(6.0, rate_hz).unwrap();
            let (gain, phase) = response(&filter, 6.0, rate_hz);
            assert!((gain - 0.5_f64.sqrt()).abs() < 1e-6, "{rate_hz}: {gain}");
            assert!(phase.abs() < 1e-6, "{rate_hz}: {phase}");
        }
    }

    #[test]
    fn the_gain_is_that_of_the_formula() {
        // |H|^2 of both passes together is 1 / (1 + (w / wc)^4)^2, with w = tan(pi f / rate).
        let (rate_hz, cutoff_hz) = (200.0, 6.0);
        let filter = Butterworth::new(cutoff_hz, rate_hz).unwrap();
        for frequency_hz in [1.0, 3.0, 5.0, 10.0, 20.0] {
            let w = |f: f64| (PI * f / rate_hz).tan();
            let expected = 1.0 / (1.0 + (w(frequency_hz) * TWO_PASSES / w(cutoff_hz)).powi(4));
            let (gain, phase) = response(&filter, frequency_hz, rate_hz);
            assert!((gain - expected).abs() < 1e-5, "{frequency_hz} Hz: {gain} {expected}");
            assert!(phase.abs() < 1e-3, "{frequency_hz} Hz: {phase}");
        }
    }

    #[test]
    fn lines_pass_unchanged_and_short_runs_as_they_are() {
        let filter = Butterworth::new(6.0, 120.0).unwrap();
        let line: Vec<f64> = (0..200).map(|i| 3.0 + 0.5 * f64::from(i)).collect();
        let worst = filter.filter(&line).into_iter().zip(&line).map(|(a, b)| (a - b).abs());
        assert!(worst.fold(0.0, f64::max) < 1e-2);
        let constant = filter.filter(&[7.0; 50]);
        assert!(constant.iter().all(|v| (v - 7.0).abs() < 1e-9));
        let short = [1.0, 9.0, -4.0];
        assert_eq!(filter.filter(&short), short);
        assert_eq!(filter.filter(&[]), Vec::<f64>::new());
    }

    #[test]
    fn impossible_cutoffs_are_refused() {
        for (cutoff_hz, rate_hz) in [(0.0, 60.0), (-1.0, 60.0), (30.0, 60.0), (f64::NAN, 60.0)] {
            let refused = Butterworth::new(cutoff_hz, rate_hz).unwrap_err().to_string();
            assert!(refused.contains("below half the rate"), "{refused}");
        }
    }

    #[test]
    fn the_correction_is_what_it_says() {
        let exact = (std::f64::consts::SQRT_2 - 1.0).sqrt().sqrt();
        assert!((exact - TWO_PASSES).abs() < 1e-15, "{exact}");
    }
}

//! Errors of velocities and accelerations of a take against its original.
//!
//! Positions are low-pass filtered before they are differentiated ([`Butterworth`]), as is usual in biomechanics.
//! Filter and differences are linear, so the difference of take and original is filtered and differentiated: the
//! derivative of the difference is the error of the derivative.

use mocapd_take::{compare::Skipped, motion::Motion};

use crate::{
    ReportError,
    column::{Column, Vector, norm},
};

/// The usual cutoff for human motion, Hz.
pub const CUTOFF_HZ: f64 = 6.0;

/// Statistics of the lengths of a vector quantity over many rows.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct MagnitudeStats {
    n: u64,
    sum_of_squares: f64,
    max: f64,
}

impl MagnitudeStats {
    fn add(&mut self, length: f64) {
        self.n += 1;
        self.sum_of_squares += length * length;
        self.max = self.max.max(length);
    }

    /// Merges the statistics of `other` into these.
    pub fn add_all(&mut self, other: &Self) {
        self.n += other.n;
        self.sum_of_squares += other.sum_of_squares;
        self.max = self.max.max(other.max);
    }

    /// The number of rows.
    #[must_use]
    pub fn n(&self) -> u64 {
        self.n
    }

    /// The root mean square of the lengths; 0 without rows.
    #[must_use]
    pub fn rms(&self) -> f64 {
        (self.sum_of_squares / self.n.max(1) as f64).sqrt()
    }

    /// The largest length; 0 without rows.
    #[must_use]
    pub fn max(&self) -> f64 {
        self.max
    }
}

/// Errors of position, velocity and acceleration of one marker, or of several together.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct DerivativeError {
    /// Error of the filtered position, mm.
    pub position_mm: MagnitudeStats,
    /// Error of the velocity, mm/s.
    pub velocity_mm_s: MagnitudeStats,
    /// Error of the acceleration, mm/s^2.
    pub acceleration_mm_s2: MagnitudeStats,
    /// The original's own velocity, mm/s.
    pub original_velocity_mm_s: MagnitudeStats,
    /// The original's own acceleration, mm/s^2.
    pub original_acceleration_mm_s2: MagnitudeStats,
    /// Samples left out: those of runs between gaps that are shorter than a period of the cutoff.
    pub samples_left_out: u64,
}

impl DerivativeError {
    /// Merges the errors of `other` into these.
    pub fn add_all(&mut self, other: &Self) {
        self.position_mm.add_all(&other.position_mm);
        self.velocity_mm_s.add_all(&other.velocity_mm_s);
        self.acceleration_mm_s2.add_all(&other.acceleration_mm_s2);
        self.original_velocity_mm_s.add_all(&other.original_velocity_mm_s);
        self.original_acceleration_mm_s2.add_all(&other.original_acceleration_mm_s2);
        self.samples_left_out += other.samples_left_out;
    }
}

/// The errors of each marker, in the order of the original, over the frames and markers that both have; filtered at
/// `cutoff_hz`.
///
/// # Errors
/// `InvalidArgument` if the cutoff is not below half the frame rate of the original.
pub fn by_marker(
    take: &Motion,
    original: &Motion,
    cutoff_hz: f64,
) -> Result<Vec<DerivativeError>, ReportError> {
    let rate_hz = original.info.rate_hz;
    let filter = Butterworth::new(cutoff_hz, rate_hz)?;
    let skipped = Skipped::of(&take.info, &original.info);
    let n_markers = original.info.markers.len().min(take.info.markers.len());
    let of_marker = |marker| {
        let (ours, theirs) = (Column::of(take, marker), Column::of(original, marker));
        // Frames are matched by number, as in the comparison of positions.
        let from = |mut column: Column, skipped: u64| {
            let n_skipped = usize::try_from(skipped).unwrap_or(usize::MAX).min(column.0.len());
            column.0.drain(..n_skipped);
            column
        };
        errors(&from(ours, skipped.take), &from(theirs, skipped.original), &filter, rate_hz)
    };
    Ok((0..n_markers).map(of_marker).collect())
}

fn errors(ours: &Column, theirs: &Column, filter: &Butterworth, rate_hz: f64) -> DerivativeError {
    let mut found = DerivativeError::default();
    let both: Vec<Option<(Vector, Vector)>> =
        ours.0.iter().zip(&theirs.0).map(|(a, b)| (*a).zip(*b)).collect();
    for run in crate::column::runs(both.iter().map(Option::is_some)) {
        if run.len() < filter.rows_min() {
            found.samples_left_out += run.len() as u64;
            continue;
        }
        let pairs: Vec<(Vector, Vector)> = both[run].iter().flatten().copied().collect();
        let error = |(a, b): &(Vector, Vector)| std::array::from_fn(|axis| a[axis] - b[axis]);
        let differences: Vec<Vector> = pairs.iter().map(error).collect();
        let originals: Vec<Vector> = pairs.iter().map(|(_, b)| *b).collect();
        let filtered = |run: &[Vector]| by_axis(run, |values| filter.filter(values));
        let (difference, original) = (filtered(&differences), filtered(&originals));
        difference.iter().for_each(|&error| found.position_mm.add(norm(error)));
        derivatives(&difference, rate_hz, |velocity, acceleration| {
            found.velocity_mm_s.add(velocity);
            found.acceleration_mm_s2.add(acceleration);
        });
        derivatives(&original, rate_hz, |velocity, acceleration| {
            found.original_velocity_mm_s.add(velocity);
            found.original_acceleration_mm_s2.add(acceleration);
        });
    }
    found
}

/// A run with `change` applied to the values on each of its three axes.
pub(crate) fn by_axis(run: &[Vector], change: impl Fn(&[f64]) -> Vec<f64>) -> Vec<Vector> {
    let axes: [Vec<f64>; 3] = std::array::from_fn(|axis| {
        let values: Vec<f64> = run.iter().map(|at| at[axis]).collect();
        change(&values)
    });
    (0..run.len()).map(|row| std::array::from_fn(|axis| axes[axis][row])).collect()
}

/// Calls `found` with the lengths of velocity and acceleration by central differences, for all rows but the first and
/// the last.
fn derivatives(run: &[Vector], rate_hz: f64, mut found: impl FnMut(f64, f64)) {
    for three in run.windows(3) {
        let velocity =
            std::array::from_fn(|axis| (three[2][axis] - three[0][axis]) * 0.5 * rate_hz);
        let acceleration = std::array::from_fn(|axis| {
            (three[2][axis] - 2.0 * three[1][axis] + three[0][axis]) * rate_hz * rate_hz
        });
        found(norm(velocity), norm(acceleration));
    }
}

/// Correction of the cutoff for two passes: `tan(pi f / rate)` is divided by it, so that both passes together have half
/// the power at the cutoff. `(2^(1/2) - 1)^(1/4)`.
pub const TWO_PASS_FACTOR: f64 = 0.802_243_262_923_150_2;

/// A second-order Butterworth low-pass for one rate and cutoff, applied forwards and backwards: zero lag, fourth order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Butterworth {
    /// Numerator coefficients: weights of the input.
    b: [f64; 3],
    /// Denominator coefficients: weights of the output; the first is 1.
    a: [f64; 3],
    /// Rows added to a run at each end.
    n_pad: usize,
    /// A period of the cutoff, rows.
    period_rows: f64,
}

impl Butterworth {
    /// Designs the filter; at `cutoff_hz` both passes together have half the power (-3.01 dB).
    ///
    /// # Errors
    /// `InvalidArgument` if the cutoff is not between 0 and half the rate.
    pub fn new(cutoff_hz: f64, rate_hz: f64) -> Result<Self, ReportError> {
        let possible = cutoff_hz.is_finite() && rate_hz.is_finite() && cutoff_hz > 0.0;
        if !possible || cutoff_hz >= 0.5 * rate_hz {
            return Err(ReportError::InvalidArgument(format!(
                "a cutoff of {cutoff_hz} Hz is impossible at {rate_hz} Hz: choose one above 0 and below half the rate"
            )));
        }
        let w = (std::f64::consts::PI * cutoff_hz / rate_hz).tan() / TWO_PASS_FACTOR;
        let scale = 1.0 / (1.0 + std::f64::consts::SQRT_2 * w + w * w);
        let b0 = w * w * scale;
        let a1 = 2.0 * (w * w - 1.0) * scale;
        let a2 = (1.0 - std::f64::consts::SQRT_2 * w + w * w) * scale;
        let period_rows = rate_hz / cutoff_hz;
        // At least three times the number of coefficients, as in SciPy, and one period, so that the filter settles.
        let n_pad = 9.max(period_rows.ceil().min(1e6) as usize);
        Ok(Self { b: [b0, 2.0 * b0, b0], a: [1.0, a1, a2], n_pad, period_rows })
    }

    /// The shortest run that is filtered, rows: one period of the cutoff. In shorter ones the ends dominate.
    #[must_use]
    pub fn rows_min(&self) -> usize {
        (self.period_rows.ceil().min(1e9) as usize).max(4)
    }

    /// Filters a run of values of any unit; the result has the same length. A run shorter than
    /// [`rows_min`](Self::rows_min) is returned unchanged.
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

    /// One forward pass; the initial state is that of a constant input equal to the first value.
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

    use mocapd_take::motion::{GAP, Marker, MotionInfo};

    use super::*;

    fn motion(rate_hz: f64, path: impl Fn(f64) -> [f32; 3]) -> Motion {
        let marker = Marker { label: "m".to_owned(), labelled: true };
        let info =
            MotionInfo { rate_hz, n_frames: 600, markers: vec![marker], ..Default::default() };
        Motion { info, positions_mm: (0..600).map(|i| path(f64::from(i) / rate_hz)).collect() }
    }

    /// A take with a sine error of 2 Hz and 1 mm: the error of its velocity is 4 pi mm/s, times the filter's gain.
    #[test]
    fn a_known_error_has_the_known_derivatives() {
        let rate_hz = 240.0;
        let original = motion(rate_hz, |t| [(100.0 * t) as f32, 0.0, 0.0]);
        let take =
            motion(rate_hz, |t| [(100.0 * t) as f32, (2.0 * PI * 2.0 * t).sin() as f32, 0.0]);
        let found = by_marker(&take, &original, CUTOFF_HZ).unwrap()[0];
        let w = |f: f64| (PI * f / rate_hz).tan();
        let gain = 1.0 / (1.0 + (w(2.0) * TWO_PASS_FACTOR / w(6.0)).powi(4));
        let speed = gain * 4.0 * PI;
        let close = |value: f64, expected: f64, part: f64| {
            assert!((value - expected).abs() < part * expected, "{value} is not {expected}");
        };
        close(found.velocity_mm_s.rms(), speed / 2.0_f64.sqrt(), 0.01);
        close(found.acceleration_mm_s2.rms(), speed * 4.0 * PI / 2.0_f64.sqrt(), 0.02);
        close(found.position_mm.rms(), gain / 2.0_f64.sqrt(), 0.01);
        close(found.original_velocity_mm_s.max(), 100.0, 0.01);
        assert_eq!(found.velocity_mm_s.n(), 598);
    }

    /// A part of a motion keeps the frame numbers of the whole.
    #[test]
    fn frames_are_matched_by_number() {
        let original = motion(60.0, |t| [(50.0 * t * t) as f32, 0.0, 0.0]);
        let mut part = original.clone();
        part.positions_mm.drain(..100);
        part.info.n_frames = 500;
        part.info.source.first_frame = original.info.source.first_frame + 100;
        let found = by_marker(&part, &original, CUTOFF_HZ).unwrap()[0];
        assert_eq!((found.position_mm.n(), found.position_mm.max()), (500, 0.0));
    }

    #[test]
    fn gaps_are_not_crossed_and_short_runs_are_counted() {
        let original = motion(60.0, |t| [(50.0 * t) as f32, 0.0, 0.0]);
        let mut take = original.clone();
        // Rows 0 to 4 are too short a run for 6 Hz at 60 Hz.
        take.positions_mm[5] = GAP;
        take.positions_mm[300] = GAP;
        let found = by_marker(&take, &original, CUTOFF_HZ).unwrap()[0];
        assert_eq!(found.samples_left_out, 5);
        assert_eq!(found.position_mm.n(), 600 - 5 - 2);
        assert_eq!(found.velocity_mm_s.max(), 0.0);
        assert!(by_marker(&take, &original, 30.0).is_err());
    }
}

#[cfg(test)]
mod tests_of_butterworth {
    use std::f64::consts::PI;

    use super::*;

    /// Amplitude and phase of a filtered sine, by its products with a sine and a cosine over whole periods.
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
    fn the_gain_follows_the_formula() {
        // |H|^2 of both passes together is 1 / (1 + (w / wc)^4)^2, with w = tan(pi f / rate).
        let (rate_hz, cutoff_hz) = (200.0, 6.0);
        let filter = Butterworth::new(cutoff_hz, rate_hz).unwrap();
        for frequency_hz in [1.0, 3.0, 5.0, 10.0, 20.0] {
            let w = |f: f64| (PI * f / rate_hz).tan();
            let expected = 1.0 / (1.0 + (w(frequency_hz) * TWO_PASS_FACTOR / w(cutoff_hz)).powi(4));
            let (gain, phase) = response(&filter, frequency_hz, rate_hz);
            assert!((gain - expected).abs() < 1e-5, "{frequency_hz} Hz: {gain} {expected}");
            assert!(phase.abs() < 1e-3, "{frequency_hz} Hz: {phase}");
        }
    }

    #[test]
    fn lines_and_short_runs_pass_unchanged() {
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
            let refused = Butterworth::new(cutoff_hz, rate_hz).unwrap_err();
            let values = [format!("{cutoff_hz} Hz"), format!("{rate_hz} Hz")];
            assert!(
                matches!(&refused, ReportError::InvalidArgument(text) if values.iter().all(|value| text.contains(value))),
                "{refused:?}"
            );
        }
    }

    #[test]
    fn the_two_pass_correction_is_exact() {
        let exact = (std::f64::consts::SQRT_2 - 1.0).sqrt().sqrt();
        assert!((exact - TWO_PASS_FACTOR).abs() < 1e-15, "{exact}");
    }
}

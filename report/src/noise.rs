//! The noise of a marker: the standard deviation of white noise on one axis, estimated from differences of consecutive
//! samples.
//!
//! Smooth motion vanishes from fourth differences, where white noise with a standard deviation of 1 has a standard
//! deviation of the root of 70. The estimate uses the median of their magnitudes, which is robust against a few
//! jumps.
//!
//! There is no estimate if its assumptions do not hold:
//! * too few samples;
//! * fast motion at a low frame rate, or noise smoothed by a filter: the estimate from sixth differences, in which less
//!   of the motion remains, then differs from that of fourth ones. Slow noise that is not white cannot be distinguished
//!   from motion, and counts as motion;
//! * quantisation steps wider than the noise: many differences are then exactly 0.

use std::collections::VecDeque;

use crate::column::{Column, Vector};

/// Minimum number of fourth differences: estimates from this many scatter by 8 % (measured on white noise, 140 samples
/// of 3 axes).
pub const DIFFERENCES_MIN: usize = 400;

/// Largest ratio of the estimates from fourth and sixth differences. With [`DIFFERENCES_MIN`] those of white noise
/// differ by a factor of 1.15 at most in 99 of 100 cases; motion that increases the estimate from fourth
/// differences by a fifth is detected.
const ORDERS_RATIO_MAX: f64 = 1.2;

/// Largest fraction of fourth differences that may be 0. If samples are rounded to a step, differences are integers:
/// normal, with a standard deviation of the root of 70 (s^2 + 1/12) steps for noise of s steps, so that 4 % of them are
/// 0 at s = 1.15. There rounding adds 3 % to the estimate, and the median is known to within 10 %; both errors grow
/// fast with smaller s.
const ZEROS_MAX: f64 = 0.04;

/// Differences up to this size count as 0, in units of the last place of their largest sample. Rounding to f32 leaves
/// half a unit in each sample, and the absolute weights of a fourth difference add up to 16.
const ZERO_ULPS: f64 = 8.0;

/// The median magnitude of a normal variable, in standard deviations.
const NORMAL_MEDIAN: f64 = 0.674_489_750_196_081_7;

/// Weights of differences, and the sum of their squares: the factor by which they multiply the variance of white noise.
const FOURTH: ([f64; 5], f64) = ([1.0, -4.0, 6.0, -4.0, 1.0], 70.0);
const SIXTH: ([f64; 7], f64) = ([1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0], 924.0);

/// A running estimate of one marker's noise.
#[derive(Debug, Clone)]
pub struct NoiseEstimator {
    /// Maximum number of differences of each order that are kept.
    kept_max: usize,
    /// The newest samples, the latest last; the last `n_recent` of them are consecutive.
    recent: [Vector; SIXTH.0.len()],
    n_recent: usize,
    /// Magnitudes of the newest differences on all axes, mm.
    fourth: VecDeque<f32>,
    sixth: VecDeque<f32>,
}

impl NoiseEstimator {
    /// An estimator over the newest `kept_max` differences of each order; every sample adds three, one per axis.
    #[must_use]
    pub fn new(kept_max: usize) -> Self {
        Self {
            kept_max,
            recent: [[0.0; 3]; SIXTH.0.len()],
            n_recent: 0,
            fourth: VecDeque::with_capacity(kept_max),
            sixth: VecDeque::with_capacity(kept_max),
        }
    }

    /// Adds the next sample; `None` in a gap.
    pub fn push(&mut self, sample: Option<Vector>) {
        let Some(sample) = sample else { return self.end_run() };
        self.recent.rotate_left(1);
        self.recent[SIXTH.0.len() - 1] = sample;
        self.n_recent = (self.n_recent + 1).min(SIXTH.0.len());
        if self.n_recent >= FOURTH.0.len() {
            keep(&mut self.fourth, self.kept_max, differences(&self.recent, &FOURTH.0));
        }
        if self.n_recent == SIXTH.0.len() {
            keep(&mut self.sixth, self.kept_max, differences(&self.recent, &SIXTH.0));
        }
    }

    /// Ends a run of consecutive samples: frames are missing.
    pub fn end_run(&mut self) {
        self.n_recent = 0;
    }

    /// The standard deviation of the noise on one axis, mm; `None` if it cannot be estimated (see the [module](self)).
    #[must_use]
    pub fn noise_mm(&self) -> Option<f64> {
        if self.fourth.len() < DIFFERENCES_MIN {
            return None;
        }
        let zeros = self.fourth.iter().filter(|&&size| size == 0.0).count();
        if zeros as f64 > ZEROS_MAX * self.fourth.len() as f64 {
            return None;
        }
        let (fourth, sixth) =
            (deviation(&self.fourth, FOURTH.1)?, deviation(&self.sixth, SIXTH.1)?);
        let is_white = fourth <= ORDERS_RATIO_MAX * sixth && sixth <= ORDERS_RATIO_MAX * fourth;
        is_white.then_some(fourth)
    }
}

/// The noise of a marker over a whole take: its standard deviation on one axis, mm; `None` if it cannot be estimated.
#[must_use]
pub fn noise_mm(column: &Column) -> Option<f64> {
    let mut estimator = NoiseEstimator::new(3 * column.0.len());
    column.0.iter().for_each(|&sample| estimator.push(sample));
    estimator.noise_mm()
}

/// The magnitude of a difference of the last samples, by axis; 0 if rounding to f32 explains it.
fn differences(recent: &[Vector], weights: &[f64]) -> [f32; 3] {
    let last = &recent[recent.len() - weights.len()..];
    std::array::from_fn(|axis| {
        let (mut sum, mut largest) = (0.0_f64, 0.0_f64);
        for (sample, weight) in last.iter().zip(weights) {
            sum += weight * sample[axis];
            largest = largest.max(sample[axis].abs());
        }
        let is_zero = sum.abs() <= ZERO_ULPS * f64::from(f32::EPSILON) * largest;
        if is_zero { 0.0 } else { sum.abs() as f32 }
    })
}

fn keep(kept: &mut VecDeque<f32>, kept_max: usize, sizes: [f32; 3]) {
    for size in sizes {
        if kept.len() >= kept_max {
            kept.pop_front();
        }
        kept.push_back(size);
    }
}

/// The standard deviation of white noise whose differences have these magnitudes.
fn deviation(sizes: &VecDeque<f32>, gain: f64) -> Option<f64> {
    let mut sizes: Vec<f32> = sizes.iter().copied().collect();
    let middle = sizes.len() / 2;
    if middle == 0 {
        return None;
    }
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f32::total_cmp);
    Some(f64::from(*median) / NORMAL_MEDIAN / gain.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Standard normal numbers from a seed.
    fn normal(mut state: u64) -> impl FnMut() -> f64 {
        move || {
            let mut sum = -6.0;
            for _ in 0..12 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_041);
                sum += (state >> 11) as f64 / (1_u64 << 53) as f64;
            }
            sum
        }
    }

    fn column(n: usize, mut at: impl FnMut(usize) -> Vector) -> Column {
        Column((0..n).map(|row| Some(at(row))).collect())
    }

    #[test]
    fn noise_is_estimated_over_short_runs_together() {
        let mut normal = normal(3);
        let mut at = |_: usize| [500.0 + 0.2 * normal(), 0.2 * normal(), 0.2 * normal()];
        let found = noise_mm(&column(2000, &mut at)).unwrap();
        assert!((found / 0.2 - 1.0).abs() < 0.1, "{found}");
        let mut gaps = column(4000, &mut at);
        gaps.0.iter_mut().skip(7).step_by(8).for_each(|sample| *sample = None);
        let found = noise_mm(&gaps).unwrap();
        assert!((found / 0.2 - 1.0).abs() < 0.1, "{found}");
        // Runs of four have no fourth difference.
        gaps.0.iter_mut().skip(4).step_by(8).for_each(|sample| *sample = None);
        gaps.0.iter_mut().skip(3).step_by(8).for_each(|sample| *sample = None);
        assert_eq!(noise_mm(&gaps), None);
        assert_eq!(noise_mm(&column(100, &mut at)), None, "too few");
        assert_eq!(noise_mm(&Column(vec![None; 400])), None);
    }

    #[test]
    fn noise_hidden_by_motion_filter_or_rounding_is_not_estimated() {
        // Motion alone, as fast as 4 Hz at 60 frames a second, and with little noise.
        let path = |row: usize| 80.0 * (row as f64 * 0.42).sin();
        assert_eq!(noise_mm(&column(2000, |row| [path(row), path(row + 7), 0.0])), None);
        let mut random = normal(5);
        let little =
            column(2000, |row| std::array::from_fn(|axis| path(row + 5 * axis) + 0.05 * random()));
        assert_eq!(noise_mm(&little), None);
        // Noise that a filter has smoothed: means of three, weighted 1, 2, 1.
        let mut random = normal(9);
        let (mut a, mut b) = ([0.0; 3], [0.0; 3]);
        let smooth = column(2000, |_| {
            let c = [random(), random(), random()];
            let mean = std::array::from_fn(|axis| 0.25 * (a[axis] + 2.0 * b[axis] + c[axis]));
            (a, b) = (b, c);
            mean
        });
        assert_eq!(noise_mm(&smooth), None);
        // Steps of 1 mm: noise of 2 mm can be estimated, noise of 0.5 mm cannot.
        for (noise, is_known) in [(2.0, true), (0.5, false), (0.1, false), (0.0, false)] {
            let mut random = normal(7);
            let rounded = column(4000, |_| std::array::from_fn(|_| (noise * random()).round()));
            assert_eq!(noise_mm(&rounded).is_some(), is_known, "{noise}");
        }
    }
}

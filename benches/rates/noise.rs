//! The noise of the sensor, measured in the residual of the low-pass filter where there is no motion.
//!
//! The impact of a foot on the ground has power above the stop band edge of the filter, and two swapped markers have
//! power at every frequency. The noise is therefore measured in the uppermost band, in the median window of time.

use std::f64::consts::PI;

use mocapd_codec::Position;
use mocapd_simulator::generator::Rng;

use crate::{low_pass::STOP_HZ, report::median, smooth::Smooth};

/// Number of equal bands between the stop band edge of the filter and half the rate of the take.
pub(crate) const BANDS: usize = 3;

/// Length of a window: long enough for several frequency bins in each band, short enough to fit between two strides.
const WINDOW_S: f64 = 0.5;

/// One band: amplitude spectral densities in mm/sqrt(Hz), for every marker and axis.
#[derive(Debug)]
pub(crate) struct Band {
    pub(crate) from_hz: f64,
    pub(crate) to_hz: f64,
    /// The density in the median window.
    pub(crate) typical: Vec<[f64; 3]>,
    /// The root mean power over all windows, impacts and swapped markers included.
    pub(crate) mean: Vec<[f64; 3]>,
}

#[derive(Debug)]
pub(crate) struct Noise {
    /// In ascending order, from the stop band edge of the filter.
    pub(crate) bands: [Band; BANDS],
    /// Standard deviation of every marker on each axis, in millimetres: that of white noise with the density of the
    /// uppermost band up to half the rate of the take.
    pub(crate) sigma_mm: Vec<[f64; 3]>,
}

impl Noise {
    pub(crate) fn measure(smooth: &Smooth) -> Self {
        let residuals = residuals(smooth);
        let nyquist_hz = smooth.rate_hz / 2.0;
        let width_hz = (nyquist_hz - STOP_HZ) / BANDS as f64;
        let bands = std::array::from_fn(|band| {
            let from_hz = STOP_HZ + band as f64 * width_hz;
            Band::of(&residuals, smooth.rate_hz, from_hz, from_hz + width_hz)
        });
        let sigma_mm = bands[BANDS - 1].typical.iter();
        let sigma_mm = sigma_mm.map(|axes| axes.map(|density| density * nyquist_hz.sqrt()));
        Self { sigma_mm: sigma_mm.collect(), bands }
    }

    /// Adds white noise with the standard deviation of each marker and axis. It is independent from sample to sample at
    /// every rate, which is the hardest case for a codec.
    pub(crate) fn add_to(&self, columns: &mut [Vec<Position>], seed: u64) {
        for (index, (column, sigma_mm)) in columns.iter_mut().zip(&self.sigma_mm).enumerate() {
            let mut rng = Rng::stream(seed, index as u64);
            for position in column {
                for (value, sigma_mm) in position.iter_mut().zip(sigma_mm) {
                    *value = (f64::from(*value) + sigma_mm * rng.normal()) as f32;
                }
            }
        }
    }
}

impl Band {
    fn of(residuals: &[[Vec<f64>; 3]], rate_hz: f64, from_hz: f64, to_hz: f64) -> Self {
        let (mut typical, mut mean) = (Vec::new(), Vec::new());
        for axes in residuals {
            let by_axis = axes.each_ref().map(|all| powers(all, rate_hz, from_hz, to_hz));
            mean.push(by_axis.each_ref().map(|p| (p.iter().sum::<f64>() / p.len() as f64).sqrt()));
            typical.push(by_axis.map(|mut powers| median(&mut powers).sqrt()));
        }
        Self { from_hz, to_hz, typical, mean }
    }
}

/// Recorded minus smoothed positions: for each marker and axis, one value per inner frame.
fn residuals(smooth: &Smooth) -> Vec<[Vec<f64>; 3]> {
    let mut residuals: Vec<[Vec<f64>; 3]> = vec![Default::default(); smooth.n_markers];
    let mut row = Vec::new();
    for frame in smooth.inner_frames() {
        smooth.at(frame as f64, &mut row);
        for ((axes, smoothed), recorded) in residuals.iter_mut().zip(&row).zip(smooth.frame(frame))
        {
            for axis in 0..3 {
                axes[axis].push(recorded[axis] - smoothed[axis]);
            }
        }
    }
    residuals
}

/// One-sided power spectral density of a band in each of the half-overlapping segments (Welch 1967), with a Hann
/// window.
fn powers(values: &[f64], rate_hz: f64, from_hz: f64, to_hz: f64) -> Vec<f64> {
    let n = (WINDOW_S * rate_hz) as usize;
    let hann: Vec<f64> =
        (0..n).map(|i| 0.5 - 0.5 * (2.0 * PI * i as f64 / n as f64).cos()).collect();
    let energy: f64 = hann.iter().map(|v| v * v).sum();
    let per_hz = n as f64 / rate_hz;
    let bins = (from_hz * per_hz).ceil() as usize..(to_hz * per_hz).ceil() as usize;
    let mut windowed = vec![0.0; n];
    let of_window = |window: &[f64]| {
        for ((out, value), weight) in windowed.iter_mut().zip(window).zip(&hann) {
            *out = value * weight;
        }
        let angles = bins.clone().map(|bin| 2.0 * PI * bin as f64 / n as f64);
        let power: f64 = angles.map(|angle| goertzel(&windowed, angle)).sum();
        2.0 * power / (bins.len().max(1) as f64 * energy * rate_hz)
    };
    values.windows(n).step_by(n / 2).map(of_window).collect()
}

/// The squared magnitude of the Fourier sum at one angular frequency, in radians per sample (Goertzel 1958).
fn goertzel(values: &[f64], angle: f64) -> f64 {
    let twice = 2.0 * angle.cos();
    let (mut last, mut before) = (0.0, 0.0);
    for value in values {
        (last, before) = (value + twice * last - before, last);
    }
    last * last + before * before - twice * last * before
}

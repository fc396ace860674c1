//! What a camera system adds to the truth: noise, soft tissue that shakes on impact, and gaps.

use mocapd_take::motion::{GAP, Position};

use super::geometry::{V3, sin_cos};
use super::rng::Rng;
use super::{JumpSpec, Occlusion};

/// How soft tissue shakes after the feet touch down.
///
/// A damped oscillation. Its frequency and decay are plausible choices, not measurements: 7 to 12 Hz, gone within
/// half a second.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wobble {
    frequency_hz: f64,
    decay_s: f64,
    amplitude_mm: V3,
}

impl Wobble {
    /// `softness` scales it: 1 at the thigh, less where bone is close.
    pub(super) fn new(wobble_mm: f64, softness: f64, rng: &mut Rng) -> Self {
        let aside = rng.between(-0.35, 0.35);
        let ahead = rng.between(-0.5, 0.5);
        let size = wobble_mm * softness * rng.between(0.8, 1.2);
        Self {
            frequency_hz: rng.between(7.0, 12.0),
            decay_s: rng.between(0.06, 0.10),
            amplitude_mm: [size * ahead, size * aside, -size],
        }
    }

    /// The displacement so long after the impact, millimetres.
    pub(super) fn at(&self, since_s: f64) -> V3 {
        // x^2 e^(2 - 2x) rises from nothing with no kick and is 1 at x = 1; e^-y as 1 / (its series), so that
        // no C library has a say in the last bit.
        let x = since_s / self.decay_s;
        if !(0.0..14.0).contains(&x) {
            return [0.0; 3];
        }
        let (mut series, mut term) = (1.0, 1.0);
        for k in 1..=90 {
            term *= 2.0 * x / f64::from(k);
            series += term;
        }
        let envelope = x * x * 7.389_056_098_930_65 / series;
        let (sin, _) = sin_cos(2.0 * std::f64::consts::PI * self.frequency_hz * since_s);
        self.amplitude_mm.map(|a| a * envelope * sin)
    }
}

/// How soft the tissue under a marker is, by its label.
pub(super) fn softness(label: &str) -> f64 {
    const SOFT: [(&str, f64); 8] = [
        ("thigh", 1.0),
        ("shank", 0.7),
        ("pelvis", 0.6),
        ("trunk", 0.6),
        ("hip", 0.6),
        ("shoulder", 0.5),
        ("knee", 0.4),
        ("upper_arm", 0.4),
    ];
    SOFT.iter().find(|(part, _)| label.contains(part)).map_or(0.25, |(_, softness)| *softness)
}

/// White noise of one marker: the same standard deviation on every axis.
pub(super) fn noise(noise_mm: f64, rng: &mut Rng) -> V3 {
    [0; 3].map(|_| noise_mm * rng.normal())
}

/// Takes samples out of one marker's column: exactly the asked part of them, in gaps of random length.
///
/// Gap lengths are skewed: many short, few up to three times the mean.
pub(super) fn occlude(
    positions: &mut [Position],
    n_markers: usize,
    marker: usize,
    spec: &JumpSpec,
    occlusion: &Occlusion,
) {
    let n_frames = positions.len() / n_markers.max(1);
    let mut rng = Rng::stream(spec.seed, 0x3_0000 + marker as u64);
    let wanted = (occlusion.fraction * n_frames as f64).round() as usize;
    let mut gaps = Vec::new();
    let mut left = wanted.min(n_frames);
    while left > 0 {
        let u = rng.unit();
        let length = (3.0 * occlusion.mean_gap_s * u * u * spec.rate_hz).ceil().max(1.0) as usize;
        gaps.push(length.min(left));
        left -= length.min(left);
    }
    // The samples that stay are cut at as many random places, and a gap goes into every cut.
    let kept = n_frames - wanted.min(n_frames);
    let mut cuts: Vec<usize> =
        gaps.iter().map(|_| (rng.unit() * (kept + 1) as f64) as usize).collect();
    cuts.sort_unstable();
    let mut taken = 0;
    for (cut, gap) in cuts.iter().zip(&gaps) {
        for frame in cut + taken..cut + taken + gap {
            if let Some(position) = positions.get_mut(frame * n_markers + marker) {
                *position = GAP;
            }
        }
        taken += gap;
    }
}

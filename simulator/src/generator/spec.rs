//! What to generate, the loop that generates it, the errors of a camera system, and sets of jumps by several subjects.

use mocapd_take::motion::{GAP, Marker, Motion, MotionInfo, Position, Source, UpAxis};

use super::Jump;
use super::arithmetic::{Rng, V3, add, scale, sin_cos};
use super::body::{self, SITES};
use super::plan::Subject;

/// Frame rates that can be generated, Hz.
pub const RATE_HZ: std::ops::RangeInclusive<f64> = 1.0..=10_000.0;

/// Maximum number of samples in a generated motion: 100 million, 1.2 GB in memory.
pub const SAMPLES_MAX: u64 = 100_000_000;

/// Maximum number of markers: the capacity of the link's marker table.
pub const MARKERS_MAX: usize = mocapd_drivers::link::MARKERS_MAX;

/// Maximum number of trials of one subject. Drawing one requires drawing all before it.
pub const TRIALS_MAX: u32 = 100_000;

/// Occlusion: gaps in every marker's samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Occlusion {
    /// Fraction of each marker's samples that is missing, 0 to 0.9.
    pub fraction: f64,
    /// Mean length of a gap, seconds; the longest are three times as long.
    pub mean_gap_s: f64,
}

/// What to generate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JumpSpec {
    /// Seed of the subject, its movements and the noise.
    pub seed: u64,
    /// Number of the subject's first trial, from 0: the same body and habits, another jump.
    pub first_trial: u32,
    /// Frames per second, in [`RATE_HZ`].
    pub rate_hz: f64,
    /// Duration, seconds; `None` for one whole trial (11 to 16 s). A longer motion continues with varied trials.
    pub seconds: Option<f64>,
    /// Number of markers, 1 to [`MARKERS_MAX`]: first the 15 sites, then rigid clusters on the segments.
    pub n_markers: usize,
    /// Standard deviation of the white noise on each axis, millimetres.
    pub noise_mm: f64,
    /// Amplitude of the soft-tissue vibration after touch-down, millimetres at the softest site.
    pub soft_tissue_mm: f64,
    /// Gaps, if any.
    pub occlusion: Option<Occlusion>,
}

impl JumpSpec {
    /// One trial of the 15 sites as a good camera system measures it: 0.05 mm noise, 3 mm soft-tissue vibration, no
    /// gaps.
    #[must_use]
    pub fn new(seed: u64, rate_hz: f64) -> Self {
        Self {
            seed,
            first_trial: 0,
            rate_hz,
            seconds: None,
            n_markers: SITES.len(),
            noise_mm: 0.05,
            soft_tissue_mm: 3.0,
            occlusion: None,
        }
    }

    /// Removes noise, soft-tissue vibration and gaps: the curves are then mathematically smooth.
    #[must_use]
    pub fn clean(self) -> Self {
        Self { noise_mm: 0.0, soft_tissue_mm: 0.0, occlusion: None, ..self }
    }

    /// Generates the motion.
    ///
    /// # Errors
    /// When a value is out of range, or the motion has more than [`SAMPLES_MAX`] samples.
    pub fn generate(&self) -> Result<Jump, GenerateError> {
        self.check()?;
        let mut subject = Subject::new(self.seed, self.first_trial);
        let seconds = self.seconds.unwrap_or_else(|| subject.first_trial_s());
        let n_frames = (seconds * self.rate_hz).round().max(1.0);
        let samples = n_frames * self.n_markers as f64;
        if samples > SAMPLES_MAX as f64 {
            return Err(GenerateError::TooLong { samples, max: SAMPLES_MAX });
        }
        let n_frames = n_frames as usize;
        subject.extend_to(seconds);
        // Each trial has its own measurement noise; the markers stay where they are attached.
        let noise_seed =
            self.seed ^ u64::from(self.first_trial).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let cluster = body::segment_markers(self.n_markers.saturating_sub(SITES.len()), self.seed);
        let labels =
            SITES.iter().map(|s| (*s).to_owned()).chain(cluster.iter().map(|s| s.label.clone()));
        let labels: Vec<String> = labels.take(self.n_markers).collect();
        let mut sensors: Vec<(Rng, SoftTissue)> = (0..)
            .zip(&labels)
            .map(|(i, label)| {
                let mut rng = Rng::stream(noise_seed, 0x2_0000 + i);
                let vibration = SoftTissue::new(self.soft_tissue_mm, softness(label), &mut rng);
                (rng, vibration)
            })
            .collect();
        let mut positions_mm = Vec::with_capacity(n_frames * self.n_markers);
        for frame in 0..n_frames {
            let time_s = frame as f64 / self.rate_hz;
            let state = subject.at(time_s);
            let truth = |i: usize| match i.checked_sub(SITES.len()) {
                None => state.sites[i],
                Some(extra) => body::marker_position(&cluster[extra], &state.sites, &state.lateral),
            };
            for (i, (rng, vibration)) in sensors.iter_mut().enumerate() {
                let mut at_mm = scale(truth(i), 1000.0);
                if self.soft_tissue_mm > 0.0 {
                    at_mm = add(at_mm, vibration.at(state.since_impact_s));
                }
                if self.noise_mm > 0.0 {
                    at_mm = add(at_mm, noise(self.noise_mm, rng));
                }
                positions_mm.push(to_position(at_mm));
            }
        }
        if let Some(occlusion) = &self.occlusion {
            for marker in 0..self.n_markers {
                occlude(&mut positions_mm, marker, self, occlusion);
            }
        }
        let phases = subject.phases(self.rate_hz, n_frames);
        Ok(Jump { motion: Motion { info: self.info(labels, n_frames), positions_mm }, phases })
    }

    fn info(&self, labels: Vec<String>, n_frames: usize) -> MotionInfo {
        MotionInfo {
            rate_hz: self.rate_hz,
            n_frames: n_frames as u64,
            markers: labels.into_iter().map(|label| Marker { label, labelled: true }).collect(),
            up: UpAxis::Z,
            source: Source {
                format: "generated".to_owned(),
                unit: "mm".to_owned(),
                factor: 1.0,
                first_frame: 1,
                ..Source::default()
            },
            ..MotionInfo::default()
        }
    }

    pub(super) fn check(&self) -> Result<(), GenerateError> {
        range("rate_hz", self.rate_hz, *RATE_HZ.start(), *RATE_HZ.end())?;
        range("markers", self.n_markers as f64, 1.0, MARKERS_MAX as f64)?;
        range("first trial", f64::from(self.first_trial), 0.0, f64::from(TRIALS_MAX))?;
        range("noise_mm", self.noise_mm, 0.0, 1000.0)?;
        range("soft_tissue_mm", self.soft_tissue_mm, 0.0, 1000.0)?;
        if let Some(seconds) = self.seconds {
            range("seconds", seconds, 1e-4, 1e6)?;
        }
        if let Some(occlusion) = &self.occlusion {
            range("occlusion fraction", occlusion.fraction, 0.0, 0.9)?;
            range("mean gap in seconds", occlusion.mean_gap_s, 1e-4, 1e4)?;
        }
        Ok(())
    }
}

fn range(what: &'static str, value: f64, low: f64, high: f64) -> Result<(), GenerateError> {
    let inside = (low..=high).contains(&value);
    if inside { Ok(()) } else { Err(GenerateError::OutOfRange { what, value, low, high }) }
}

fn to_position(mm: V3) -> Position {
    mm.map(|v| v as f32)
}

/// Why a specification was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GenerateError {
    /// A value is out of range.
    #[error("{what} is {value}, expected {low} to {high}")]
    OutOfRange {
        /// The name of the value.
        what: &'static str,
        /// The value.
        value: f64,
        /// The smallest allowed.
        low: f64,
        /// The largest allowed.
        high: f64,
    },
    /// Frames times markers exceeds the limit.
    #[error(
        "{samples} samples (frames x markers) are more than {max}: reduce duration, rate or markers"
    )]
    TooLong {
        /// Samples requested.
        samples: f64,
        /// The limit.
        max: u64,
    },
}

/// Vibration of soft tissue after touch-down: a damped oscillation.
///
/// Frequency and decay are plausible choices, not measurements: 7 to 12 Hz, gone within half a second.
#[derive(Debug, Clone, Copy)]
pub(super) struct SoftTissue {
    frequency_hz: f64,
    decay_s: f64,
    amplitude_mm: V3,
}

impl SoftTissue {
    /// `softness` scales the amplitude: 1 at the thigh, less where bone is close to the skin.
    pub(super) fn new(soft_tissue_mm: f64, softness: f64, rng: &mut Rng) -> Self {
        let aside = rng.between(-0.35, 0.35);
        let ahead = rng.between(-0.5, 0.5);
        let size = soft_tissue_mm * softness * rng.between(0.8, 1.2);
        Self {
            frequency_hz: rng.between(7.0, 12.0),
            decay_s: rng.between(0.06, 0.10),
            amplitude_mm: [size * ahead, size * aside, -size],
        }
    }

    /// The displacement at `since_s` after the impact, millimetres.
    pub(super) fn at(&self, since_s: f64) -> V3 {
        // x^2 e^(2 - 2x) rises smoothly from 0 and is 1 at x = 1. e^-y is computed as 1 / (the series of e^y), because
        // C libraries differ in the last bit.
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

/// Softness of the tissue under a marker, 0.25 to 1, by its label.
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

/// White noise of one sample, with the same standard deviation on every axis.
pub(super) fn noise(noise_mm: f64, rng: &mut Rng) -> V3 {
    [0; 3].map(|_| noise_mm * rng.normal())
}

/// Removes exactly the requested fraction of one marker's samples, in gaps of random length.
///
/// Gap lengths are skewed: many are short, few reach three times the mean.
fn occlude(positions: &mut [Position], marker: usize, spec: &JumpSpec, occlusion: &Occlusion) {
    let n_frames = positions.len() / spec.n_markers.max(1);
    let mut rng = Rng::stream(spec.seed, 0x3_0000 + marker as u64);
    let occluded = (occlusion.fraction * n_frames as f64).round() as usize;
    let mut gaps = Vec::new();
    let mut remaining = occluded.min(n_frames);
    while remaining > 0 {
        let u = rng.unit();
        let length = (3.0 * occlusion.mean_gap_s * u * u * spec.rate_hz).ceil().max(1.0) as usize;
        gaps.push(length.min(remaining));
        remaining -= length.min(remaining);
    }
    // The remaining samples are cut at random places, and one gap goes into each cut.
    let visible = n_frames - occluded.min(n_frames);
    let mut cuts: Vec<usize> =
        gaps.iter().map(|_| (rng.unit() * (visible + 1) as f64) as usize).collect();
    cuts.sort_unstable();
    let mut taken = 0;
    for (cut, gap) in cuts.iter().zip(&gaps) {
        for frame in cut + taken..cut + taken + gap {
            if let Some(position) = positions.get_mut(frame * spec.n_markers + marker) {
                *position = GAP;
            }
        }
        taken += gap;
    }
}

/// Maximum number of subjects in a set.
pub const SUBJECTS_MAX: u32 = 1000;

/// A data set of jumps, divided among subjects as evenly as possible: of 326 jumps by 10 subjects, the first six do 33
/// each and the others 32.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JumpSet {
    /// Rate, markers, noise and gaps of every jump; its seed selects the subjects.
    pub spec: JumpSpec,
    n_subjects: u32,
    n_jumps: u32,
}

/// A jump of a set.
#[derive(Debug, Clone, PartialEq)]
pub struct SetJump {
    /// Number of the subject, from 1.
    pub subject: u32,
    /// Number of the subject's trial, from 1.
    pub trial: u32,
    /// The jump.
    pub jump: Jump,
}

impl JumpSet {
    /// Creates a set. Subjects differ in stature (1.60 to 1.92 m) and style; the jumps of one subject differ by a few
    /// per cent.
    ///
    /// # Errors
    /// When a number is out of range.
    pub fn new(spec: JumpSpec, n_subjects: u32, n_jumps: u32) -> Result<Self, GenerateError> {
        range("subjects", f64::from(n_subjects), 1.0, f64::from(SUBJECTS_MAX))?;
        range("jumps", f64::from(n_jumps), 1.0, f64::from(TRIALS_MAX))?;
        Ok(Self { spec, n_subjects, n_jumps })
    }

    /// Generates the jumps one after another, each of them a whole trial.
    ///
    /// # Errors
    /// When [`JumpSpec::generate`] refuses the specification.
    pub fn jumps(&self) -> impl Iterator<Item = Result<SetJump, GenerateError>> {
        let Self { spec, n_subjects, n_jumps } = *self;
        (0..n_subjects).flat_map(move |subject| {
            let n_trials = n_jumps / n_subjects + u32::from(subject < n_jumps % n_subjects);
            let seed = Rng::stream(spec.seed, 0x4_0000 + u64::from(subject)).next_u64();
            (0..n_trials).map(move |first_trial| {
                let spec = JumpSpec { seed, first_trial, ..spec };
                let jump = spec.generate()?;
                Ok(SetJump { subject: subject + 1, trial: first_trial + 1, jump })
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(n_subjects: u32, n_jumps: u32) -> Vec<SetJump> {
        let set = JumpSet::new(JumpSpec::new(1, 30.0), n_subjects, n_jumps).unwrap();
        set.jumps().map(Result::unwrap).collect()
    }

    #[test]
    fn jumps_are_divided_evenly_and_all_differ() {
        let jumps = set(3, 8);
        let ids: Vec<(u32, u32)> = jumps.iter().map(|jump| (jump.subject, jump.trial)).collect();
        assert_eq!(ids, [(1, 1), (1, 2), (1, 3), (2, 1), (2, 2), (2, 3), (3, 1), (3, 2)]);
        for (i, SetJump { jump: a, .. }) in jumps.iter().enumerate() {
            assert_eq!(a.phases.len(), 7, "each is one whole trial");
            assert!(jumps[..i].iter().all(|b| b.jump.motion.positions_mm != a.motion.positions_mm));
        }
    }

    #[test]
    fn a_subject_keeps_its_bones_and_subjects_differ() {
        let jumps = set(2, 4);
        let thigh_mm = |jump: &Jump| {
            let [hip, knee] = [9, 10].map(|site| jump.motion.frame(0)[site].map(f64::from));
            (0..3).map(|axis| (hip[axis] - knee[axis]).powi(2)).sum::<f64>().sqrt()
        };
        let lengths: Vec<f64> = jumps.iter().map(|jump| thigh_mm(&jump.jump)).collect();
        assert!((lengths[0] - lengths[1]).abs() < 1.0 && (lengths[2] - lengths[3]).abs() < 1.0);
        assert!((lengths[0] - lengths[2]).abs() > 1.0, "{lengths:?}");
    }

    #[test]
    fn the_first_trial_is_number_0() {
        let spec = JumpSpec::new(7, 60.0);
        assert_eq!(spec.first_trial, 0);
        let again = JumpSpec { first_trial: 3, ..spec };
        assert_ne!(spec.generate().unwrap().phases, again.generate().unwrap().phases);
        assert!(JumpSpec { first_trial: TRIALS_MAX + 1, ..spec }.generate().is_err());
        assert!(JumpSet::new(spec, 0, 1).is_err() && JumpSet::new(spec, 1, 0).is_err());
    }
}

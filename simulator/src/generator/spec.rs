//! What to generate, and the loop that does it.

use mocapd_take::motion::{Marker, Motion, MotionInfo, Position, Source, UpAxis};

use super::body::SITES;
use super::geometry::{V3, add, scale};
use super::rng::Rng;
use super::sensor::{self, Wobble};
use super::subject::Subject;
use super::{Jump, cluster};

/// The rates that can be generated, Hz.
pub const RATE_HZ: std::ops::RangeInclusive<f64> = 1.0..=10_000.0;

/// The most samples one generated take may have: 100 million, 1.2 GB in memory.
pub const SAMPLES_MAX: u64 = 100_000_000;

/// The most markers: what the link's table holds.
pub const MARKERS_MAX: usize = mocapd_drivers::link::MARKERS_MAX;

/// The most trials of one subject: each is drawn after all before it.
pub const TRIALS_MAX: u32 = 100_000;

/// How much is hidden from the cameras.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Occlusion {
    /// Part of each marker's samples that is missing, 0 to 0.9.
    pub fraction: f64,
    /// Mean length of a gap, seconds; gaps reach three times that.
    pub mean_gap_s: f64,
}

/// What to generate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JumpSpec {
    /// Says which subject jumps, how, and every bit of the noise.
    pub seed: u64,
    /// Which of the subject's trials comes first, from 0: the same body and habits, another jump.
    pub first_trial: u32,
    /// Frames a second, in [`RATE_HZ`].
    pub rate_hz: f64,
    /// How long; `None` for one whole trial (11 to 16 s). More than a trial repeats it with small changes.
    pub seconds: Option<f64>,
    /// 1 to [`MARKERS_MAX`]: the first are the sites, the others sit on the segments in rigid clusters.
    pub n_markers: usize,
    /// Standard deviation of the white noise on each axis, millimetres.
    pub noise_mm: f64,
    /// Size of the soft-tissue wobble after touch-down, millimetres at its softest.
    pub wobble_mm: f64,
    /// Gaps, if any.
    pub occlusion: Option<Occlusion>,
}

impl JumpSpec {
    /// One trial of the 15 sites as a good camera system sees it: 0.05 mm noise, 3 mm wobble, no gaps.
    #[must_use]
    pub fn new(seed: u64, rate_hz: f64) -> Self {
        Self {
            seed,
            first_trial: 0,
            rate_hz,
            seconds: None,
            n_markers: SITES.len(),
            noise_mm: 0.05,
            wobble_mm: 3.0,
            occlusion: None,
        }
    }

    /// The same without noise, wobble or gaps: mathematically smooth curves.
    #[must_use]
    pub fn clean(self) -> Self {
        Self { noise_mm: 0.0, wobble_mm: 0.0, occlusion: None, ..self }
    }

    /// Generates it.
    ///
    /// # Errors
    /// When a value is out of its range; the message names it and the range.
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
        // What the cameras add is another one's in every trial; markers sit where they sat.
        let noise_seed =
            self.seed ^ u64::from(self.first_trial).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let stuck = cluster::stick(self.n_markers.saturating_sub(SITES.len()), self.seed);
        let labels =
            SITES.iter().map(|s| (*s).to_owned()).chain(stuck.iter().map(|s| s.label.clone()));
        let labels: Vec<String> = labels.take(self.n_markers).collect();
        let mut sensors: Vec<(Rng, Wobble)> = (0..)
            .zip(&labels)
            .map(|(i, label)| {
                let mut rng = Rng::stream(noise_seed, 0x2_0000 + i);
                let wobble = Wobble::new(self.wobble_mm, sensor::softness(label), &mut rng);
                (rng, wobble)
            })
            .collect();
        let mut positions_mm = Vec::with_capacity(n_frames * self.n_markers);
        for frame in 0..n_frames {
            let time_s = frame as f64 / self.rate_hz;
            let moment = subject.at(time_s);
            let truth = |i: usize| match i.checked_sub(SITES.len()) {
                None => moment.sites[i],
                Some(extra) => cluster::place(&stuck[extra], &moment.sites, &moment.lateral),
            };
            for (i, (rng, wobble)) in sensors.iter_mut().enumerate() {
                let mut at_mm = scale(truth(i), 1000.0);
                if self.wobble_mm > 0.0 {
                    at_mm = add(at_mm, wobble.at(moment.since_impact_s));
                }
                if self.noise_mm > 0.0 {
                    at_mm = add(at_mm, sensor::noise(self.noise_mm, rng));
                }
                positions_mm.push(to_position(at_mm));
            }
        }
        if let Some(occlusion) = &self.occlusion {
            for marker in 0..self.n_markers {
                sensor::occlude(&mut positions_mm, self.n_markers, marker, self, occlusion);
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

    fn check(&self) -> Result<(), GenerateError> {
        let range = |what, value: f64, low: f64, high: f64| {
            let inside = (low..=high).contains(&value);
            if inside { Ok(()) } else { Err(GenerateError::OutOfRange { what, value, low, high }) }
        };
        range("rate_hz", self.rate_hz, *RATE_HZ.start(), *RATE_HZ.end())?;
        range("markers", self.n_markers as f64, 1.0, MARKERS_MAX as f64)?;
        range("first trial", f64::from(self.first_trial), 0.0, f64::from(TRIALS_MAX))?;
        range("noise_mm", self.noise_mm, 0.0, 1000.0)?;
        range("wobble_mm", self.wobble_mm, 0.0, 1000.0)?;
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

fn to_position(mm: V3) -> Position {
    mm.map(|v| v as f32)
}

/// Why nothing was generated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GenerateError {
    /// A value outside its range.
    #[error("{what} is {value}, expected {low} to {high}")]
    OutOfRange {
        /// Which value.
        what: &'static str,
        /// What it was.
        value: f64,
        /// The least it may be.
        low: f64,
        /// The most it may be.
        high: f64,
    },
    /// Frames times markers is too much for memory.
    #[error(
        "{samples} samples (frames x markers) are more than {max}: ask for less time, rate or markers"
    )]
    TooLong {
        /// What was asked for.
        samples: f64,
        /// The most there may be.
        max: u64,
    },
}

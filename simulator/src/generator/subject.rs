//! One subject over time: trials of jumping and walking back, with slow postural drift.

use std::f64::consts::TAU;

use super::arithmetic::{Rng, V3, sin_cos};
use super::body::{Body, SITES};
use super::plan::Style;
use super::{Phase, Trial};

/// Shift of the drifts from one first trial to the next, seconds: not a multiple of their periods.
const DRIFT_STEP_S: f64 = 17.3;

/// A trial, with its start time, and its origin and direction in the capture volume.
#[derive(Debug)]
struct PlacedTrial {
    trial: Trial,
    start_s: f64,
    origin: [f64; 2],
    /// +1 when it faces +x, -1 when it faces -x.
    sense: f64,
}

impl PlacedTrial {
    /// Converts from the trial's axes to those of the capture volume.
    fn to_volume(&self, [x, y, z]: V3) -> V3 {
        [self.origin[0] + self.sense * x, self.origin[1] + self.sense * y, z]
    }
}

/// A slow drift that does not repeat: the sum of three sines.
#[derive(Debug, Clone, Copy)]
struct Drift {
    /// Amplitude, frequency (Hz) and phase (radians) of each.
    waves: [[f64; 3]; 3],
}

impl Drift {
    fn new(size: f64, rng: &mut Rng) -> Self {
        let waves = [(0.6, 0.12), (0.3, 0.31), (0.15, 0.57)].map(|(part, frequency_hz)| {
            [size * part, frequency_hz * rng.between(0.8, 1.2), rng.between(0.0, TAU)]
        });
        Self { waves }
    }

    fn at(&self, time_s: f64) -> f64 {
        // Whole turns are subtracted first: the sine is accurate for moderate angles only.
        let wave = |[size, hz, phase]: [f64; 3]| {
            let turns = hz * time_s;
            size * sin_cos(TAU * (turns - turns.floor()) + phase).0
        };
        self.waves.into_iter().map(wave).sum()
    }
}

/// The subject at one time.
#[derive(Debug)]
pub(super) struct SubjectState {
    pub(super) sites: [V3; SITES.len()],
    /// Lateral axes of hips and chest, to the left.
    pub(super) lateral: [V3; 2],
    /// Seconds since the last touch-down; negative before it.
    pub(super) since_impact_s: f64,
}

/// What the floor has to bear at one time, in the axes of the capture volume.
#[derive(Debug, Clone, Copy)]
pub(super) struct Support {
    /// The pelvis without postural drift, whose place is that of the body.
    pub(super) pelvis: V3,
    /// Left and right ankle.
    pub(super) feet: [V3; 2],
    pub(super) is_airborne: bool,
}

/// A subject, drawn from a seed.
#[derive(Debug)]
pub(super) struct Subject {
    body: Body,
    style: Style,
    rng: Rng,
    /// Pelvis x y z, lean, both arms.
    drifts: [Drift; 6],
    /// Time of the drifts at the start, seconds.
    drift_from_s: f64,
    trials: Vec<PlacedTrial>,
}

impl Subject {
    /// Creates a subject whose trial `first_trial` (from 0) starts at time 0 and the origin.
    pub(super) fn new(seed: u64, first_trial: u32) -> Self {
        let mut rng = Rng::new(seed);
        let stature_m = rng.between(1.60, 1.92);
        let style = Style::of_subject(stature_m, &mut rng);
        let drifts =
            [0.004, 0.004, 0.0008, 0.010, 0.020, 0.020].map(|size| Drift::new(size, &mut rng));
        let mut subject = Self {
            body: Body::of_stature(stature_m),
            style,
            rng,
            drifts,
            drift_from_s: 0.0,
            trials: Vec::new(),
        };
        for _ in 0..first_trial {
            subject.style.vary(&mut subject.rng);
        }
        // The sway must differ between trials.
        subject.drift_from_s = f64::from(first_trial) * DRIFT_STEP_S;
        subject.next_trial();
        subject
    }

    fn next_trial(&mut self) {
        let style = self.style.vary(&mut self.rng);
        let trial = Trial::new(&self.body, &style);
        let (start_s, origin, sense) = self.trials.last().map_or((0.0, [0.0; 2], 1.0), |last| {
            let [x, y] = last.trial.end();
            let origin = [last.origin[0] + last.sense * x, last.origin[1] + last.sense * y];
            (last.start_s + last.trial.duration_s(), origin, -last.sense)
        });
        self.trials.push(PlacedTrial { trial, start_s, origin, sense });
    }

    fn end_s(&self) -> f64 {
        self.trials.last().map_or(0.0, |last| last.start_s + last.trial.duration_s())
    }

    pub(super) fn first_trial_s(&self) -> f64 {
        self.trials.first().map_or(0.0, |first| first.trial.duration_s())
    }

    /// Plans trials up to this time.
    pub(super) fn extend_to(&mut self, seconds: f64) {
        while self.end_s() < seconds {
            self.next_trial();
        }
    }

    pub(super) fn at(&self, time_s: f64) -> SubjectState {
        let index = self.trials.partition_point(|p| p.start_s <= time_s).saturating_sub(1);
        let placed = &self.trials[index];
        let local_s = time_s - placed.start_s;
        let mut pose = placed.trial.pose(local_s);
        pose.pelvis = placed.to_volume(pose.pelvis);
        pose.ankles = pose.ankles.map(|ankle| placed.to_volume(ankle));
        pose.facing = pose.facing.map(|v| placed.sense * v);
        let [x, y, z, lean, left, right] =
            self.drifts.map(|drift| drift.at(self.drift_from_s + time_s));
        pose.pelvis = [pose.pelvis[0] + x, pose.pelvis[1] + y, pose.pelvis[2] + z];
        pose.lean += lean;
        pose.arms[0].swing += left;
        pose.arms[1].swing += right;
        let (sites, lateral) = self.body.place(&pose);
        SubjectState { sites, lateral, since_impact_s: local_s - placed.trial.touch_down_s() }
    }

    /// Stature in metres.
    pub(super) fn stature_m(&self) -> f64 {
        self.body.stature
    }

    /// The body and its feet, as far as the floor feels them.
    pub(super) fn support(&self, time_s: f64) -> Support {
        let index = self.trials.partition_point(|p| p.start_s <= time_s).saturating_sub(1);
        let placed = &self.trials[index];
        let local_s = time_s - placed.start_s;
        let pose = placed.trial.pose(local_s);
        Support {
            pelvis: placed.to_volume(pose.pelvis),
            feet: pose.ankles.map(|ankle| placed.to_volume(ankle)),
            is_airborne: placed.trial.is_airborne(local_s),
        }
    }

    /// The phases within `n_frames` frames, each with its first frame.
    pub(super) fn phases(&self, rate_hz: f64, n_frames: usize) -> Vec<(Phase, usize)> {
        let mut phases: Vec<(Phase, usize)> = Vec::new();
        for placed in &self.trials {
            for (phase, begins_s) in placed.trial.phases() {
                let frame = ((placed.start_s + begins_s) * rate_hz).ceil() as usize;
                if phases.last().is_some_and(|(_, first)| *first == frame) {
                    phases.pop();
                }
                if frame < n_frames {
                    phases.push((phase, frame));
                }
            }
        }
        phases
    }
}

//! One subject over time: trials of jumping and walking back, with slow postural drift; and the keyframed curves of one
//! jump, from standing to touch-down and up again, in the style of its subject.
//!
//! Keyframes carry value, velocity and acceleration, so that the ground phases meet the flight parabola with two
//! continuous derivatives.

use std::f64::consts::TAU;

use super::arithmetic::{Curve, Keyframe, Rng, V3, sin_cos};
use super::body::{Body, SITES};
use super::{Phase, Trial};

/// Start of each phase, seconds from the start of the trial.
#[derive(Debug, Clone, Copy)]
pub(super) struct PhaseTimes {
    pub(super) swings: f64,
    pub(super) last_swing: f64,
    pub(super) take_off: f64,
    pub(super) flight: f64,
    pub(super) touch_down: f64,
    pub(super) walk: f64,
}

/// Distances, durations and amplitudes of one trial, drawn from the seed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Style {
    pub(super) jump_m: f64,
    pub(super) stand_s: f64,
    pub(super) half_swing_s: f64,
    pub(super) n_half_swings: u32,
    pub(super) crouch_s: f64,
    pub(super) pause_s: f64,
    pub(super) push_s: f64,
    pub(super) flight_s: f64,
    pub(super) settle_s: f64,
    /// Factor on the arm swings.
    pub(super) arm_amplitude: f64,
    /// Left-right asymmetry: how much later (s) and further (radians) the right side moves than the left.
    pub(super) right_late_s: f64,
    pub(super) right_more: f64,
}

impl Style {
    /// The habitual style of a subject.
    pub(super) fn of_subject(stature_m: f64, rng: &mut Rng) -> Self {
        Self {
            jump_m: (stature_m * rng.between(1.22, 1.38)).clamp(2.05, 2.55),
            stand_s: rng.between(0.9, 1.4),
            half_swing_s: rng.between(0.50, 0.62),
            n_half_swings: if rng.unit() < 0.5 { 3 } else { 5 },
            crouch_s: rng.between(0.50, 0.65),
            pause_s: rng.between(0.25, 0.40),
            push_s: rng.between(0.28, 0.32),
            flight_s: rng.between(0.45, 0.48),
            settle_s: rng.between(0.9, 1.1),
            arm_amplitude: rng.between(0.85, 1.1),
            right_late_s: rng.between(-0.012, 0.012),
            right_more: rng.between(-0.05, 0.05),
        }
    }

    /// Varies the style from trial to trial by a few per cent.
    pub(super) fn vary(mut self, rng: &mut Rng) -> Self {
        self.jump_m *= rng.between(0.98, 1.02);
        let Self { stand_s, half_swing_s, pause_s, settle_s, .. } = &mut self;
        for time in [stand_s, half_swing_s, pause_s, settle_s] {
            *time *= rng.between(0.94, 1.06);
        }
        self.arm_amplitude *= rng.between(0.96, 1.04);
        self
    }

    pub(super) fn times(&self) -> PhaseTimes {
        let swings = self.stand_s;
        let last_swing = swings + f64::from(self.n_half_swings) * self.half_swing_s;
        let take_off = last_swing + self.crouch_s + self.pause_s;
        let flight = take_off + self.push_s;
        let touch_down = flight + self.flight_s;
        let walk = touch_down + self.settle_s;
        PhaseTimes { swings, last_swing, take_off, flight, touch_down, walk }
    }

    /// Turning points of the preparatory arm swings: time, and whether the arms are in front.
    pub(super) fn extremes(&self) -> impl Iterator<Item = (f64, bool)> + '_ {
        (1..=self.n_half_swings)
            .map(|i| (self.stand_s + f64::from(i) * self.half_swing_s, i % 2 == 1))
    }
}

/// Standard gravity, rounded as is usual in biomechanics, m/s^2.
pub(super) const GRAVITY_M_S2: f64 = 9.81;

/// Shoulder and elbow angle of a hanging arm, radians. A trial starts and ends with them, so that trials join smoothly.
const HANGING: (f64, f64) = (0.08, 0.22);

/// The keyframed curves of a trial: x forward and z up in metres, angles in radians.
#[derive(Debug, Clone, Default)]
pub(super) struct JointCurves {
    pub(super) pelvis_x: Curve,
    pub(super) pelvis_z: Curve,
    pub(super) lean: Curve,
    pub(super) abduction: Curve,
    /// Left, right.
    pub(super) arm_swing: [Curve; 2],
    pub(super) elbow: [Curve; 2],
    pub(super) ankle_x: [Curve; 2],
    pub(super) ankle_z: [Curve; 2],
    /// In flight, from the hip line to the ankle: length in metres, and angle from straight down, forward positive.
    pub(super) leg_length: Curve,
    pub(super) leg_angle: [Curve; 2],
}

/// Position, velocity and acceleration of a point in the plane of the jump.
#[derive(Debug, Clone, Copy)]
struct PointState {
    at: [f64; 2],
    velocity: [f64; 2],
    acceleration: [f64; 2],
}

impl PointState {
    fn keyframe(&self, axis: usize, time_s: f64) -> Keyframe {
        let [value, velocity, acceleration] =
            [self.at, self.velocity, self.acceleration].map(|v| v[axis]);
        Keyframe { time_s, value, velocity, acceleration }
    }
}

/// A leg at take-off or touch-down: (length, rate of change), (angle, rate of change).
type Leg = [(f64, f64); 2];

/// The ankle of a leg below a moving pelvis: planar polar kinematics without angular or radial acceleration.
fn ankle_below(pelvis: &PointState, [(r, dr), (angle, da)]: Leg) -> PointState {
    let (s, c) = sin_cos(angle);
    let (radial, around) = ([s, -c], [c, s]);
    let sum = |base: [f64; 2], kr: f64, ka: f64| {
        [base[0] + kr * radial[0] + ka * around[0], base[1] + kr * radial[1] + ka * around[1]]
    };
    PointState {
        at: sum(pelvis.at, r, 0.0),
        velocity: sum(pelvis.velocity, dr, r * da),
        acceleration: sum(pelvis.acceleration, -r * da * da, 2.0 * dr * da),
    }
}

impl JointCurves {
    /// Builds the curves. `stand_m` and `walk_m` are the pelvis heights of standing and walking, `end_s` is the end
    /// of the walk.
    pub(super) fn new(body: &Body, style: &Style, stand_m: f64, walk_m: f64, end_s: f64) -> Self {
        let mut curves = Self::default();
        let times = style.times();
        curves.upper_body(style, &times);
        curves.legs(body, style, &times, stand_m);
        curves.pelvis_z.rest(times.walk, stand_m);
        curves.pelvis_z.rest(times.walk + 0.45, walk_m);
        curves.pelvis_z.rest(end_s - 0.45, walk_m);
        curves.pelvis_z.rest(end_s, stand_m);
        curves
    }

    fn upper_body(&mut self, style: &Style, t: &PhaseTimes) {
        self.lean = Curve::resting(t.swings, 0.04);
        self.abduction = Curve::resting(t.take_off, 0.12);
        for (time_s, in_front) in style.extremes() {
            self.lean.rest(time_s, if in_front { -0.02 } else { 0.36 });
        }
        for (time_s, lean) in [
            (t.last_swing + style.crouch_s, 0.74),
            (t.take_off, 0.78),
            (t.flight + 0.02, 0.40),
            (t.flight + 0.45 * style.flight_s, 0.34),
            (t.touch_down, 0.72),
            (t.touch_down + 0.24, 0.95),
            (t.walk - 0.05, 0.04),
        ] {
            self.lean.rest(time_s, lean);
        }
        self.abduction.rest(t.flight + 0.1, 0.30);
        self.abduction.rest(t.walk - 0.1, 0.12);
        for (side, late_s, more) in [(0, 0.0, 0.0), (1, style.right_late_s, style.right_more)] {
            let (swing, elbow) = (&mut self.arm_swing[side], &mut self.elbow[side]);
            *swing = Curve::resting(t.swings, HANGING.0);
            *elbow = Curve::resting(t.swings, HANGING.1);
            for (i, (time_s, in_front)) in style.extremes().enumerate() {
                let grow = 0.8 + 0.08 * i as f64;
                let angle = style.arm_amplitude * grow * if in_front { 1.35 } else { -0.62 };
                swing.rest(time_s + late_s, angle + more);
                elbow.rest(time_s + 1.5 * late_s, if in_front { 0.55 } else { 0.25 });
            }
            for (time_s, angle, bend) in [
                (t.last_swing + style.crouch_s, -0.80, 0.20),
                (t.take_off - 0.06, -0.86, 0.24),
                (t.flight + 0.07, 2.15, 0.50),
                (t.touch_down, 1.25, 0.35),
                (t.touch_down + 0.22, 0.72, 0.30),
            ] {
                swing.rest(time_s + late_s, style.arm_amplitude * angle + more);
                elbow.rest(time_s + 1.5 * late_s, bend);
            }
            swing.rest(t.walk - 0.02, HANGING.0);
            elbow.rest(t.walk - 0.02, HANGING.1);
        }
    }

    fn legs(&mut self, body: &Body, style: &Style, t: &PhaseTimes, stand_m: f64) {
        let (leg, ankle_m, size) = (body.leg(), body.ankle_height, body.stature / 1.75);
        let (at_take_off, at_touch_down): (Leg, Leg) =
            ([(0.972 * leg, 0.25), (-0.58, -0.6)], [(0.84 * leg, -1.5), (0.62, 0.0)]);
        let below = |pelvis: [f64; 2], legs: Leg| {
            let still = PointState { at: pelvis, velocity: [0.0; 2], acceleration: [0.0; 2] };
            ankle_below(&still, legs).at
        };
        // The ankles at both ends of the flight give the pelvis, and the pelvis gives the parabola.
        let hang = (below([0.0; 2], at_take_off), below([0.0; 2], at_touch_down));
        let from = [0.15 * size - hang.0[0], ankle_m + 0.15 * size - hang.0[1]];
        let to = [style.jump_m - 0.07 - hang.1[0], ankle_m + 0.055 - hang.1[1]];
        let (f, push_s) = (style.flight_s, style.push_s);
        let velocity = [(to[0] - from[0]) / f, (to[1] - from[1]) / f + 0.5 * GRAVITY_M_S2 * f];
        let acceleration = [0.0, -GRAVITY_M_S2];
        let leaving = PointState { at: from, velocity, acceleration };
        let falling = [velocity[0], velocity[1] - GRAVITY_M_S2 * f];
        let landing = PointState { at: to, velocity: falling, acceleration };

        // Half the final speed times the push time: from there the body accelerates throughout.
        let low = [from[0] - 0.50 * velocity[0] * push_s, from[1] - 0.56 * velocity[1] * push_s];
        let absorb_s = 0.2;
        let bottom =
            [style.jump_m - 0.12, (to[1] + 0.5 * falling[1] * absorb_s).max(ankle_m + 0.36 * leg)];
        self.pelvis_x = Curve::resting(t.swings, 0.0);
        self.pelvis_z = Curve::resting(t.swings, stand_m);
        for (time_s, in_front) in style.extremes() {
            self.pelvis_x.rest(time_s, if in_front { 0.02 } else { -0.03 });
            self.pelvis_z.rest(time_s, stand_m - if in_front { 0.01 } else { 0.07 } * size);
        }
        let push = t.take_off;
        self.pelvis_x.rest(push - style.pause_s, low[0] - 0.02);
        self.pelvis_z.rest(push - style.pause_s, low[1] + 0.02);
        for (curve, axis) in [(&mut self.pelvis_x, 0), (&mut self.pelvis_z, 1)] {
            curve.rest(push, low[axis]);
            curve.pass(leaving.keyframe(axis, t.flight));
            curve.pass(landing.keyframe(axis, t.touch_down));
        }
        let moving =
            |time_s, (value, velocity)| Keyframe { time_s, value, velocity, acceleration: 0.0 };
        let bottom_s = t.touch_down + absorb_s;
        self.pelvis_x.pass(moving(bottom_s, (bottom[0], 0.3)));
        self.pelvis_z.rest(bottom_s, bottom[1]);
        self.pelvis_x.rest(t.walk - 0.1, style.jump_m);
        self.pelvis_z.rest(t.walk - 0.02, stand_m);

        let tuck_s = t.flight + 0.5 * f;
        self.leg_length.pass(moving(t.flight, at_take_off[0]));
        self.leg_length.rest(tuck_s, 0.64 * leg);
        self.leg_length.pass(moving(t.touch_down, at_touch_down[0]));
        for side in 0..2 {
            let more = if side == 1 { 0.5 * style.right_more } else { 0.0 };
            self.leg_angle[side].pass(moving(t.flight, at_take_off[1]));
            self.leg_angle[side].pass(moving(tuck_s, (0.05 + more, 4.0)));
            let (angle, rate) = at_touch_down[1];
            let landing_leg = [at_touch_down[0], (angle + more, rate)];
            self.leg_angle[side].pass(moving(t.touch_down, landing_leg[1]));
            let lift = ankle_below(&leaving, at_take_off);
            let touch = ankle_below(&landing, landing_leg);
            let plant = [touch.at[0] + 0.5 * touch.velocity[0] * 0.08, ankle_m];
            let ankle = [(&mut self.ankle_x[side], 0, 0.0), (&mut self.ankle_z[side], 1, ankle_m)];
            for (curve, axis, ground) in ankle {
                *curve = Curve::resting(t.flight - 0.2, ground);
                curve.pass(lift.keyframe(axis, t.flight));
                curve.pass(touch.keyframe(axis, t.touch_down));
                curve.rest(t.touch_down + 0.08, plant[axis]);
            }
        }
    }
}

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

//! The keyframed curves of one jump, from standing to touch-down and up again, in the style of its subject.
//!
//! Keyframes carry value, velocity and acceleration, so that the ground phases meet the flight parabola with two
//! continuous derivatives.

use super::arithmetic::{Curve, Keyframe, Rng, sin_cos};
use super::body::Body;

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

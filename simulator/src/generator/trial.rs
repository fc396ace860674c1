//! A trial: the keyed jump, the walk after it, and the pose at any time of both.

use super::Phase;
use super::body::{Arm, Body, Pose};
use super::geometry::sin_cos;
use super::plan::Keyed;
use super::style::{Style, Times};
use super::walk::{self, Swing, Walk};

/// How far from its start a trial ends, metres: the next one comes back the same way.
const RETURN_M: f64 = 2.3;

/// One trial in its own axes: it begins at the origin, facing +x.
#[derive(Debug, Clone)]
pub(super) struct Trial {
    times: Times,
    keyed: Keyed,
    walk: Walk,
    swings: [Vec<Swing>; 2],
    half_stance_m: f64,
    bob_m: f64,
}

impl Trial {
    pub(super) fn new(body: &Body, style: &Style) -> Self {
        let times = style.times();
        let half_stance_m = 0.05 * body.stature;
        let aside = body.half_hips() - half_stance_m;
        let below = |reach: f64, ahead: f64| {
            (reach * reach - ahead * ahead - aside * aside).max(0.0).sqrt()
        };
        let stand_m = body.ankle_height + below(0.985 * body.leg(), 0.0);
        let (out_m, turn_m) = (1.2, 3.2);
        let back_m = style.jump_m + out_m - RETURN_M;
        let step_m = 0.22 * body.stature;
        let n_steps = ((out_m + turn_m + back_m) / step_m).round().max(4.0) as u32;
        let bob_m = 0.008 * body.stature;
        // Both feet stand at most 0.6 of a step from the body, 0.75 on the outside of the turn: the legs must reach.
        let walk_m = body.ankle_height + below(0.98 * body.leg(), 0.75 * step_m) + 0.8 * bob_m;
        let mut walk = Walk {
            from: [style.jump_m, 0.0],
            out_m,
            turn_m,
            back_m,
            n_steps,
            speed_m_s: 0.5 * body.stature,
            ramp_s: 0.8,
            half_stance_m,
            ankle_height_m: body.ankle_height,
            lift_m: 0.05 * body.stature,
            ankles_from: [[0.0; 3]; 2],
        };
        let walk_end_s = times.walk + walk.duration_s();
        let keyed = Keyed::new(body, style, stand_m, walk_m, walk_end_s);
        walk.ankles_from = [0, 1].map(|side| jump_ankle(&keyed, half_stance_m, side, times.walk));
        let swings = [walk.swings(0), walk.swings(1)];
        Self { times, keyed, walk, swings, half_stance_m, bob_m }
    }

    pub(super) fn duration_s(&self) -> f64 {
        self.times.walk + self.walk.duration_s()
    }

    /// The phases and when each begins, in order.
    pub(super) fn phases(&self) -> [(Phase, f64); 7] {
        let t = &self.times;
        [
            (Phase::Standing, 0.0),
            (Phase::Swings, t.swings),
            (Phase::LastSwing, t.last_swing),
            (Phase::TakeOff, t.take_off),
            (Phase::Flight, t.flight),
            (Phase::Settling, t.touch_down),
            (Phase::Walking, t.walk),
        ]
    }

    pub(super) fn touch_down_s(&self) -> f64 {
        self.times.touch_down
    }

    /// Where the trial ends, x and y; the body then faces -x.
    pub(super) fn end(&self) -> [f64; 2] {
        self.walk.body(self.walk.duration_s()).0
    }

    /// The pose at a time of the trial.
    pub(super) fn pose(&self, time_s: f64) -> Pose {
        let keyed = &self.keyed;
        let mut pose = Pose {
            pelvis: [keyed.pelvis_x.at(time_s), 0.0, keyed.pelvis_z.at(time_s)],
            facing: [1.0, 0.0],
            lean: keyed.lean.at(time_s),
            ..Pose::default()
        };
        pose.nod = -0.45 * pose.lean;
        pose.arms = [0, 1].map(|side| Arm {
            swing: keyed.arm_swing[side].at(time_s),
            elbow: keyed.elbow[side].at(time_s),
            abduction: keyed.abduction.at(time_s),
        });
        if time_s < self.times.walk {
            pose.ankles = [0, 1].map(|side| self.ankle(side, time_s));
        } else {
            self.stride(time_s - self.times.walk, &mut pose);
        }
        pose
    }

    fn ankle(&self, side: usize, time_s: f64) -> [f64; 3] {
        let t = &self.times;
        if time_s <= t.flight || time_s >= t.touch_down {
            return jump_ankle(&self.keyed, self.half_stance_m, side, time_s);
        }
        let keyed = &self.keyed;
        let (s, c) = sin_cos(keyed.leg_angle[side].at(time_s));
        let reach = keyed.leg_length.at(time_s);
        let aside = if side == 0 { self.half_stance_m } else { -self.half_stance_m };
        [keyed.pelvis_x.at(time_s) + reach * s, aside, keyed.pelvis_z.at(time_s) - reach * c]
    }

    fn stride(&self, walk_s: f64, pose: &mut Pose) {
        let (at, facing) = self.walk.body(walk_s);
        let (steps, whole) = self.walk.stride(walk_s);
        let (swing, _) = sin_cos(std::f64::consts::PI * steps);
        let (_, bob) = sin_cos(2.0 * std::f64::consts::PI * steps);
        // The weight is on the right foot while the left one swings, at the even counts of steps.
        let (_, weight) = sin_cos(std::f64::consts::PI * steps);
        let sway = -0.02 * whole * weight;
        pose.pelvis = [
            at[0] - sway * facing[1],
            at[1] + sway * facing[0],
            pose.pelvis[2] + whole * self.bob_m * bob,
        ];
        pose.facing = facing;
        pose.twist = -0.10 * whole * swing;
        pose.lean += 0.03 * whole;
        // Each arm goes with the other leg.
        pose.arms[0].swing -= 0.32 * whole * swing;
        pose.arms[1].swing += 0.32 * whole * swing;
        for (arm, sign) in pose.arms.iter_mut().zip([-1.0, 1.0]) {
            arm.elbow += whole * (0.10 + 0.12 * sign * swing);
        }
        pose.ankles = [0, 1].map(|side| walk::ankle(&self.swings[side], walk_s));
    }
}

/// An ankle on the ground before and after the flight.
fn jump_ankle(keyed: &Keyed, half_stance_m: f64, side: usize, time_s: f64) -> [f64; 3] {
    let aside = if side == 0 { half_stance_m } else { -half_stance_m };
    [keyed.ankle_x[side].at(time_s), aside, keyed.ankle_z[side].at(time_s)]
}

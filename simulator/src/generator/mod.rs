//! Generates standing long jumps: the motion of Shi et al. 2012 without their data.
//!
//! Axes: x forward at the start, y left, z up; the floor is z = 0. Joint angles follow keyframed curves (`plan`),
//! inverse kinematics place the legs on planted feet (`body`), and flight is a parabola. The subject walks back after
//! each jump, so a take of any length stays in a volume of about 6 m. A seed gives the same bits on every machine.

mod arithmetic;
mod body;
mod measured;
mod plan;
mod spec;

#[cfg(test)]
mod tests;

use arithmetic::{V3, sin_cos, smooth_step};
use body::{Arm, Body, Pose};
use mocapd_take::motion::Motion;
use plan::{JointCurves, PhaseTimes, Style};

pub use mocapd_take::phase::Phase;

pub use arithmetic::Rng;
pub use body::{BONES, SITES};
pub use measured::{
    ForcePlates, GeneratedBodies, PLATE_COMPONENTS, RecordedPoses, RigidBodies, plate_corners_mm,
};
pub use spec::{
    GenerateError, JumpSet, JumpSpec, MARKERS_MAX, Occlusion, RATE_HZ, SAMPLES_MAX, SUBJECTS_MAX,
    SetJump, TRIALS_MAX,
};

/// A generated motion and its phases.
#[derive(Debug, Clone, PartialEq)]
pub struct Jump {
    /// The motion, millimetres, z up.
    pub motion: Motion,
    /// Each phase and its first frame, in order; a phase shorter than a frame is omitted.
    pub phases: Vec<(Phase, usize)>,
}

/// Distance from a trial's start to its end, metres; the next trial comes back the same way.
const RETURN_M: f64 = 2.3;

/// One trial in its own axes: it begins at the origin, facing +x.
#[derive(Debug, Clone)]
struct Trial {
    times: PhaseTimes,
    curves: JointCurves,
    walk: Walk,
    swings: [Vec<Swing>; 2],
    half_stance_m: f64,
    bob_m: f64,
}

impl Trial {
    fn new(body: &Body, style: &Style) -> Self {
        let times = style.times();
        let half_stance_m = 0.05 * body.stature;
        let aside = body.half_hips - half_stance_m;
        let below = |reach: f64, ahead: f64| {
            (reach * reach - ahead * ahead - aside * aside).max(0.0).sqrt()
        };
        let stand_m = body.ankle_height + below(0.985 * body.leg(), 0.0);
        let (out_m, turn_m) = (1.2, 3.2);
        let back_m = style.jump_m + out_m - RETURN_M;
        let step_m = 0.22 * body.stature;
        let n_steps = ((out_m + turn_m + back_m) / step_m).round().max(4.0) as u32;
        let bob_m = 0.008 * body.stature;
        // Both feet stand at most 0.6 of a step from the body, 0.75 on the outside of the turn, and the legs must reach
        // them.
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
        let curves = JointCurves::new(body, style, stand_m, walk_m, walk_end_s);
        walk.ankles_from = [0, 1].map(|side| jump_ankle(&curves, half_stance_m, side, times.walk));
        let swings = [walk.swings(0), walk.swings(1)];
        Self { times, curves, walk, swings, half_stance_m, bob_m }
    }

    fn duration_s(&self) -> f64 {
        self.times.walk + self.walk.duration_s()
    }

    /// The phases and their start times, seconds, in order.
    fn phases(&self) -> [(Phase, f64); 7] {
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

    fn is_airborne(&self, time_s: f64) -> bool {
        (self.times.flight..self.times.touch_down).contains(&time_s)
    }

    fn touch_down_s(&self) -> f64 {
        self.times.touch_down
    }

    /// Position at the end of the trial, x and y in metres; the body then faces -x.
    fn end(&self) -> [f64; 2] {
        self.walk.body(self.walk.duration_s()).0
    }

    /// The pose at a time of the trial.
    fn pose(&self, time_s: f64) -> Pose {
        let curves = &self.curves;
        let mut pose = Pose {
            pelvis: [curves.pelvis_x.at(time_s), 0.0, curves.pelvis_z.at(time_s)],
            facing: [1.0, 0.0],
            lean: curves.lean.at(time_s),
            ..Pose::default()
        };
        pose.head_pitch = -0.45 * pose.lean;
        pose.arms = [0, 1].map(|side| Arm {
            swing: curves.arm_swing[side].at(time_s),
            elbow: curves.elbow[side].at(time_s),
            abduction: curves.abduction.at(time_s),
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
            return jump_ankle(&self.curves, self.half_stance_m, side, time_s);
        }
        let curves = &self.curves;
        let (s, c) = sin_cos(curves.leg_angle[side].at(time_s));
        let reach = curves.leg_length.at(time_s);
        let aside = if side == 0 { self.half_stance_m } else { -self.half_stance_m };
        [curves.pelvis_x.at(time_s) + reach * s, aside, curves.pelvis_z.at(time_s) - reach * c]
    }

    fn stride(&self, walk_s: f64, pose: &mut Pose) {
        let (at, facing) = self.walk.body(walk_s);
        let (steps, whole) = self.walk.stride(walk_s);
        let (_, bob) = sin_cos(2.0 * std::f64::consts::PI * steps);
        // The weight is on the right foot while the left one swings, at even step counts.
        let (swing, weight) = sin_cos(std::f64::consts::PI * steps);
        let sway = -0.02 * whole * weight;
        let z = pose.pelvis[2] + whole * self.bob_m * bob;
        pose.pelvis = [at[0] - sway * facing[1], at[1] + sway * facing[0], z];
        pose.facing = facing;
        pose.twist = -0.10 * whole * swing;
        pose.lean += 0.03 * whole;
        // Each arm swings with the opposite leg.
        pose.arms[0].swing -= 0.32 * whole * swing;
        pose.arms[1].swing += 0.32 * whole * swing;
        for (arm, sign) in pose.arms.iter_mut().zip([-1.0, 1.0]) {
            arm.elbow += whole * (0.10 + 0.12 * sign * swing);
        }
        pose.ankles = [0, 1].map(|side| foot(&self.swings[side], walk_s));
    }
}

/// An ankle on the ground before and after the flight.
fn jump_ankle(curves: &JointCurves, half_stance_m: f64, side: usize, time_s: f64) -> [f64; 3] {
    let aside = if side == 0 { half_stance_m } else { -half_stance_m };
    [curves.ankle_x[side].at(time_s), aside, curves.ankle_z[side].at(time_s)]
}

/// A walk in the jump's own axes, from a stand facing +x to a stand facing -x.
#[derive(Debug, Clone)]
struct Walk {
    /// Start of the pelvis, x and y in metres.
    from: [f64; 2],
    /// Path lengths in metres: straight, turning, and straight again.
    out_m: f64,
    turn_m: f64,
    back_m: f64,
    /// Steps along the path; then the other foot closes up.
    n_steps: u32,
    speed_m_s: f64,
    /// Duration of acceleration, and of deceleration.
    ramp_s: f64,
    half_stance_m: f64,
    ankle_height_m: f64,
    lift_m: f64,
    /// Left and right ankle before the first step.
    ankles_from: [V3; 2],
}

/// Half the duration of a foot's swing, in steps of body progress: the foot for place `k` swings around `k - 1`.
const SWING_HALF: f64 = 0.4;

impl Walk {
    fn length_m(&self) -> f64 {
        self.out_m + self.turn_m + self.back_m
    }

    fn duration_s(&self) -> f64 {
        self.length_m() / self.speed_m_s + self.ramp_s
    }

    fn step_m(&self) -> f64 {
        self.length_m() / f64::from(self.n_steps)
    }

    /// Path covered by the body, metres.
    fn progress_m(&self, time_s: f64) -> f64 {
        // The integral of the smooth step from 0 to x, and x - 1/2 beyond 1.
        let ramp = |x: f64| {
            let y = x.clamp(0.0, 1.0);
            y * y * y * y * (2.5 + y * (y - 3.0)) + (x - 1.0).max(0.0)
        };
        let stop_s = self.duration_s() - self.ramp_s;
        let scale = self.speed_m_s * self.ramp_s;
        scale * (ramp(time_s / self.ramp_s) - ramp((time_s - stop_s) / self.ramp_s))
    }

    /// Steps covered, 0 to `n_steps`, and the amplitude of the gait (0 at both ends, 1 in between).
    fn stride(&self, time_s: f64) -> (f64, f64) {
        let steps = self.progress_m(time_s) / self.step_m();
        (steps, smooth_step(steps) * smooth_step(f64::from(self.n_steps) - steps))
    }

    /// Position (x, y) and direction (cosine, sine) on the path.
    fn path(&self, progress_m: f64) -> ([f64; 2], [f64; 2]) {
        let [x0, y0] = self.from;
        if progress_m <= self.out_m {
            return ([x0 + progress_m, y0], [1.0, 0.0]);
        }
        let turned = (progress_m - self.out_m).min(self.turn_m);
        let [dx, dy] = self.turn(turned);
        let (sin, cos) = sin_cos(self.heading(turned));
        let back = (progress_m - self.out_m - self.turn_m).max(0.0);
        let facing = if back > 0.0 { [-1.0, 0.0] } else { [cos, sin] };
        ([x0 + self.out_m + dx - back, y0 + dy], facing)
    }

    fn body(&self, time_s: f64) -> ([f64; 2], [f64; 2]) {
        self.path(self.progress_m(time_s))
    }

    fn heading(&self, turned_m: f64) -> f64 {
        std::f64::consts::PI * smooth_step(turned_m / self.turn_m)
    }

    /// Displacement by the turn so far: the integral of the direction, by 8-point Gauss-Legendre quadrature on two
    /// panels.
    fn turn(&self, turned_m: f64) -> [f64; 2] {
        const NODES: [(f64, f64); 4] = [
            (0.183_434_642_495_649_8, 0.362_683_783_378_362),
            (0.525_532_409_916_329, 0.313_706_645_877_887_3),
            (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
            (0.960_289_856_497_536_3, 0.101_228_536_290_376_3),
        ];
        let half = 0.25 * turned_m;
        let mut sum = [0.0; 2];
        for middle in [half, 3.0 * half] {
            for (node, weight) in NODES {
                for side in [-node, node] {
                    let (sin, cos) = sin_cos(self.heading(middle + side * half));
                    sum = [sum[0] + weight * half * cos, sum[1] + weight * half * sin];
                }
            }
        }
        sum
    }

    /// The time at which the body has covered this many steps, by bisection.
    fn time_of(&self, steps: f64) -> f64 {
        let (mut low, mut high) = (0.0, self.duration_s());
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            let behind = self.progress_m(middle) < steps * self.step_m();
            (low, high) = if behind { (middle, high) } else { (low, middle) };
        }
        low
    }

    /// All swings of one foot. The left foot takes the odd places, the right foot the even ones.
    fn swings(&self, side: usize) -> Vec<Swing> {
        let sign = if side == 0 { 1.0 } else { -1.0 };
        let n = self.n_steps;
        let mut from = self.ankles_from[side];
        let mut swings = Vec::new();
        for place in (1..=n + 1).filter(|k| (k % 2 == 1) == (side == 0)) {
            let middle = f64::from(place) - 1.0;
            let leaves_s = self.time_of((middle - SWING_HALF).max(0.02));
            let lands_s = self.time_of((middle + SWING_HALF).min(f64::from(n) - 0.02));
            let (at, facing) = self.path(f64::from(place.min(n)) * self.step_m());
            let aside = sign * self.half_stance_m;
            let to = [at[0] - aside * facing[1], at[1] + aside * facing[0], self.ankle_height_m];
            swings.push(Swing { leaves_s, lands_s, from, to, lift_m: self.lift_m });
            from = to;
        }
        swings
    }
}

/// The swing of a foot from one place to the next.
#[derive(Debug, Clone, Copy)]
struct Swing {
    leaves_s: f64,
    lands_s: f64,
    from: V3,
    to: V3,
    lift_m: f64,
}

/// Position of a foot, which rests between its swings.
fn foot(swings: &[Swing], time_s: f64) -> V3 {
    let begun = swings.partition_point(|s| s.leaves_s <= time_s);
    let Some(swing) = swings.get(begun.saturating_sub(1)) else { return [0.0; 3] };
    let x = ((time_s - swing.leaves_s) / (swing.lands_s - swing.leaves_s)).clamp(0.0, 1.0);
    let y = x * (1.0 - x);
    let s = smooth_step(x);
    let mix = |i: usize| swing.from[i] + (swing.to[i] - swing.from[i]) * s;
    [mix(0), mix(1), mix(2) + 64.0 * swing.lift_m * y * y * y]
}

//! Slow walking: straight on, once around, and back, on planted feet.

use super::geometry::{V3, sin_cos, smooth_step};

/// A walk in the jump's own axes: from a point, facing +x, to a stand facing -x.
#[derive(Debug, Clone)]
pub(super) struct Walk {
    /// Where the pelvis starts, x and y in metres.
    pub(super) from: [f64; 2],
    /// Straight, turning and straight again, metres of path.
    pub(super) out_m: f64,
    pub(super) turn_m: f64,
    pub(super) back_m: f64,
    /// Steps on the way; the last foot then closes up.
    pub(super) n_steps: u32,
    pub(super) speed_m_s: f64,
    /// Time to get up to speed, and to stop.
    pub(super) ramp_s: f64,
    pub(super) half_stance_m: f64,
    pub(super) ankle_height_m: f64,
    pub(super) lift_m: f64,
    /// Where left and right ankle stand before.
    pub(super) ankles_from: [V3; 2],
}

/// Body progress in steps at which the foot for place `k` leaves the ground and lands, about `k - 1`.
const SWING_HALF: f64 = 0.4;

impl Walk {
    pub(super) fn length_m(&self) -> f64 {
        self.out_m + self.turn_m + self.back_m
    }

    pub(super) fn duration_s(&self) -> f64 {
        self.length_m() / self.speed_m_s + self.ramp_s
    }

    fn step_m(&self) -> f64 {
        self.length_m() / f64::from(self.n_steps)
    }

    /// Metres of path behind the body.
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

    /// Steps behind the body, 0 to `n_steps`, and how much of a walk it is (0 at both ends, 1 between).
    pub(super) fn stride(&self, time_s: f64) -> (f64, f64) {
        let steps = self.progress_m(time_s) / self.step_m();
        (steps, smooth_step(steps) * smooth_step(f64::from(self.n_steps) - steps))
    }

    /// Place (x, y) and direction (cosine, sine) of the path.
    pub(super) fn path(&self, progress_m: f64) -> ([f64; 2], [f64; 2]) {
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

    pub(super) fn body(&self, time_s: f64) -> ([f64; 2], [f64; 2]) {
        self.path(self.progress_m(time_s))
    }

    fn heading(&self, turned_m: f64) -> f64 {
        std::f64::consts::PI * smooth_step(turned_m / self.turn_m)
    }

    /// What the turn has moved the body by: the integral of its direction, two panels of 8-point Gauss-Legendre.
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

    /// The time at which the body has made so many steps.
    fn time_of(&self, steps: f64) -> f64 {
        let (mut low, mut high) = (0.0, self.duration_s());
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            let behind = self.progress_m(middle) < steps * self.step_m();
            (low, high) = if behind { (middle, high) } else { (low, middle) };
        }
        low
    }

    /// Every swing of one foot: (leaves, lands, from, to). Left takes the odd places, right the even ones.
    pub(super) fn swings(&self, side: usize) -> Vec<Swing> {
        let sign = if side == 0 { 1.0 } else { -1.0 };
        let n = self.n_steps;
        let mut from = self.ankles_from[side];
        let mut swings = Vec::new();
        for place in (1..=n + 1).filter(|k| (k % 2 == 1) == (side == 0)) {
            let middle = f64::from(place) - 1.0;
            let leaves = (middle - SWING_HALF).max(0.02);
            let lands = (middle + SWING_HALF).min(f64::from(n) - 0.02);
            let (at, facing) = self.path(f64::from(place.min(n)) * self.step_m());
            let aside = sign * self.half_stance_m;
            let to = [at[0] - aside * facing[1], at[1] + aside * facing[0], self.ankle_height_m];
            swings.push(Swing {
                leaves_s: self.time_of(leaves),
                lands_s: self.time_of(lands),
                from,
                to,
                lift_m: self.lift_m,
            });
            from = to;
        }
        swings
    }
}

/// One foot from one place to the next.
#[derive(Debug, Clone, Copy)]
pub(super) struct Swing {
    leaves_s: f64,
    lands_s: f64,
    from: V3,
    to: V3,
    lift_m: f64,
}

/// Where a foot is: at rest between its swings.
pub(super) fn ankle(swings: &[Swing], time_s: f64) -> V3 {
    let begun = swings.partition_point(|s| s.leaves_s <= time_s);
    let Some(swing) = swings.get(begun.saturating_sub(1)) else { return [0.0; 3] };
    let x = ((time_s - swing.leaves_s) / (swing.lands_s - swing.leaves_s)).clamp(0.0, 1.0);
    let y = x * (1.0 - x);
    let s = smooth_step(x);
    let mix = |i: usize| swing.from[i] + (swing.to[i] - swing.from[i]) * s;
    [mix(0), mix(1), mix(2) + 64.0 * swing.lift_m * y * y * y]
}

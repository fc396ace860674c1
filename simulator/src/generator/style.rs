//! How a subject jumps, and how one trial differs from the next.

use super::rng::Rng;

/// When each phase begins, seconds from the start of the trial.
#[derive(Debug, Clone, Copy)]
pub(super) struct Times {
    pub(super) swings: f64,
    pub(super) last_swing: f64,
    pub(super) take_off: f64,
    pub(super) flight: f64,
    pub(super) touch_down: f64,
    pub(super) walk: f64,
}

/// How one trial goes, drawn from its seed.
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
    pub(super) arms: f64,
    /// What the right side does later (s) and further (radians) than the left.
    pub(super) right_late_s: f64,
    pub(super) right_more: f64,
}

impl Style {
    /// A subject's habit.
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
            arms: rng.between(0.85, 1.1),
            right_late_s: rng.between(-0.012, 0.012),
            right_more: rng.between(-0.05, 0.05),
        }
    }

    /// The same subject once more: nothing is repeated to the millisecond.
    pub(super) fn vary(mut self, rng: &mut Rng) -> Self {
        self.jump_m *= rng.between(0.98, 1.02);
        for time in
            [&mut self.stand_s, &mut self.half_swing_s, &mut self.pause_s, &mut self.settle_s]
        {
            *time *= rng.between(0.94, 1.06);
        }
        self.arms *= rng.between(0.96, 1.04);
        self
    }

    pub(super) fn times(&self) -> Times {
        let swings = self.stand_s;
        let last_swing = swings + f64::from(self.n_half_swings) * self.half_swing_s;
        let take_off = last_swing + self.crouch_s + self.pause_s;
        let flight = take_off + self.push_s;
        let touch_down = flight + self.flight_s;
        Times { swings, last_swing, take_off, flight, touch_down, walk: touch_down + self.settle_s }
    }

    /// Ends of the preparatory swings: time, and whether the arms are in front.
    pub(super) fn extremes(&self) -> impl Iterator<Item = (f64, bool)> + '_ {
        (1..=self.n_half_swings)
            .map(|i| (self.stand_s + f64::from(i) * self.half_swing_s, i % 2 == 1))
    }
}

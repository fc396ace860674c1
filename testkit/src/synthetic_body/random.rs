//! Numbers out of a seed: splitmix64 (Steele et al. 2014), the same on every machine.

use super::{Point, unit};

pub(super) struct Random(u64);

impl Random {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// From the first up to the second, all alike.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        // 53 bits are what a float64 holds.
        let share = (self.next() >> 11) as f64 / (1_u64 << 53) as f64;
        low + (high - low) * share
    }

    /// A direction, all alike: a point of the cube that lies in the ball.
    pub(super) fn direction(&mut self) -> Point {
        loop {
            let p = Point::from([0; 3].map(|_| self.between(-1.0, 1.0)));
            if (0.01..1.0).contains(&p.norm()) {
                return unit(p);
            }
        }
    }
}

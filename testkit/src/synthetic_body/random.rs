//! Random numbers of bodies.

use super::{Point, unit};

/// A stream of random numbers, the same on every machine: splitmix64 (Steele et al. 2014).
pub(super) struct BodyRng(u64);

impl BodyRng {
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

    /// Uniform from `low` to `high`.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        // A float64 holds 53 bits.
        let share = (self.next() >> 11) as f64 / (1_u64 << 53) as f64;
        low + (high - low) * share
    }

    /// A uniformly distributed direction, by rejection: a point of the cube that lies in the unit sphere.
    pub(super) fn direction(&mut self) -> Point {
        loop {
            let p = Point::from([0; 3].map(|_| self.between(-1.0, 1.0)));
            if (0.01..1.0).contains(&p.norm()) {
                return unit(p);
            }
        }
    }
}

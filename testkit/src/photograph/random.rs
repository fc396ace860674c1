//! Random numbers for synthetic pictures.

/// A stream of random numbers, the same on every machine: splitmix64 (Steele, Lea and Flood 2014).
#[derive(Debug, Clone)]
pub struct PictureRng(u64);

impl PictureRng {
    /// The stream for a seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform from `low` to `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Nearly standard normal: the sum of twelve uniform numbers minus 6, so always between -6 and 6.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }

    /// One of the choices; the default if there are none.
    pub fn one_of<T: Copy + Default>(&mut self, choices: &[T]) -> T {
        let index = (self.uniform() * choices.len() as f64) as usize;
        choices.get(index).copied().unwrap_or_default()
    }
}

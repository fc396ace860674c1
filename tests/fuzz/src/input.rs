//! Converts a fuzzer's bytes to numbers.

use mocapd_codec::{Settings, Tolerance};

/// The resamplers, selected by one byte.
const KINDS: [&str; 8] = [
    "dense",
    "fast",
    "lossless",
    "spline",
    "sync",
    "spline:exhaustive",
    "sync:exhaustive",
    "lossless:predictive",
];

/// Reads numbers from the front, and zeros at the end, so that any bytes are valid input.
#[derive(Debug, Clone, Copy)]
pub struct Input<'a>(&'a [u8]);

impl<'a> Input<'a> {
    /// Starts at the first byte.
    #[must_use]
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    /// Whether no bytes are left.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// One byte.
    pub fn byte(&mut self) -> u8 {
        self.take(1).first().copied().unwrap_or_default()
    }

    /// Two bytes, little endian.
    pub fn pair(&mut self) -> usize {
        usize::from(self.byte()) | usize::from(self.byte()) << 8
    }

    /// A float32 of any bits.
    pub fn float(&mut self) -> f32 {
        f32::from_le_bytes(std::array::from_fn(|_| self.byte()))
    }

    /// `n` bytes, or all that are left.
    pub fn take(&mut self, n: usize) -> &'a [u8] {
        let (front, rest) = self.0.split_at(n.min(self.0.len()));
        self.0 = rest;
        front
    }

    /// A resampler, from one byte, and a tolerance from 0.1 um to 1 km, from another.
    pub fn settings(&mut self) -> Settings {
        let kind = KINDS[usize::from(self.byte()) % KINDS.len()];
        let exponent = f64::from(self.byte()) / 25.5 - 4.0;
        let mm = 10_f64.powf(exponent).clamp(Tolerance::MIN_MM, Tolerance::MAX_MM);
        Settings {
            kind: kind.parse().expect("a resampler's own name"),
            tolerance: Tolerance::from_mm(mm).expect("within the limits"),
        }
    }
}

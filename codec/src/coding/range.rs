//! Adaptive binary range coding (Martin, Range encoding, 1979) with the carry handling of LZMA.
//!
//! The range has 32 bits, probabilities have 16. The encoder drops trailing zero bytes and the decoder reads zeros past
//! the end, so that a block of highly probable bits may take no byte at all. All arithmetic is exact, in integers;
//! `docs/codec.md` (Range coder) specifies every step.
//!
//! A syntax is written once, over a [`BinaryCoder`], and both encodes and decodes:
//!
//! ```
//! use mocapd_codec::range::{BinaryCoder, Bit, RangeDecoder, RangeEncoder};
//!
//! fn late<C: BinaryCoder>(coder: &mut C, model: &mut Bit, late: bool) -> bool {
//!     coder.bit(model, late)
//! }
//!
//! let mut bytes = Vec::new();
//! let mut encoder = RangeEncoder::new(&mut bytes, usize::MAX);
//! let mut model = Bit::expecting(4);
//! (0..60).for_each(|row| drop(late(&mut encoder, &mut model, row == 40)));
//! assert!(encoder.finish());
//! assert!(bytes.len() <= 2);
//!
//! let mut decoder = RangeDecoder::new(&bytes);
//! let mut model = Bit::expecting(4);
//! (0..60).for_each(|row| assert_eq!(late(&mut decoder, &mut model, false), row == 40));
//! decoder.finish()?;
//! # Ok::<(), mocapd_codec::CodecError>(())
//! ```

use std::hint::select_unpredictable;

use crate::CodecError;

/// The range is refilled below this.
const TOP: u32 = 1 << 24;

/// The adaptive model of a bit: two exponential averages of the probability of `false`, a fast one and a slow one.
#[derive(Debug, Clone, Copy)]
pub struct Bit {
    fast: u16,
    slow: u16,
    /// Number of bits coded with it, saturating; averages of few bits move faster.
    n_bits: u8,
}

impl Bit {
    /// Shifts of the exponential averages after enough bits: time constants of 32 and 128 bits.
    const FAST_SHIFT: u32 = 5;
    const SLOW_SHIFT: u32 = 7;
    /// At this count `ilog2(n_bits + 2)` has reached the larger shift.
    const N_BITS_MAX: u8 = 126;

    /// The number of bits that an initial probability counts for.
    const PRIOR_BITS: u8 = 14;

    /// Probability 1/2, before any bit.
    pub const NEW: Self = Self { fast: 1 << 15, slow: 1 << 15, n_bits: 0 };

    /// Starts from the probability `odds` of `true` in 1/256, as after 14 bits.
    #[must_use]
    pub const fn expecting(odds: u8) -> Self {
        let estimate = u16::MAX - ((odds as u16) << 8 | 0x80);
        Self { fast: estimate, slow: estimate, n_bits: Self::PRIOR_BITS }
    }

    /// The probability of `false` in 2^-16: the mean of both averages, never 0 or 1.
    fn probability(self) -> u32 {
        ((u32::from(self.fast) + u32::from(self.slow)) >> 1).clamp(32, (1 << 16) - 32)
    }

    fn update(&mut self, bit: bool) {
        let age = (u32::from(self.n_bits) + 2).ilog2();
        for (estimate, shift) in [
            (&mut self.fast, age.min(Self::FAST_SHIFT)),
            (&mut self.slow, age.min(Self::SLOW_SHIFT)),
        ] {
            if bit {
                *estimate -= *estimate >> shift;
            } else {
                *estimate += (u16::MAX - *estimate) >> shift;
            }
        }
        self.n_bits = (self.n_bits + 1).min(Self::N_BITS_MAX);
    }
}

/// An encoder or decoder of bits, so that a syntax is written once for both.
pub trait BinaryCoder {
    /// Encodes `bit` and returns it, or ignores it and returns the decoded bit. `probability` is that of `false`, in
    /// 2^-16, and must be neither 0 nor 2^16 or more.
    fn split(&mut self, probability: u32, bit: bool) -> bool;

    /// Codes a bit with one model, and updates the model.
    fn bit(&mut self, model: &mut Bit, bit: bool) -> bool {
        let bit = self.split(model.probability(), bit);
        model.update(bit);
        bit
    }

    /// Codes a bit with the mean probability of two models, and updates both.
    fn mixed(&mut self, a: &mut Bit, b: &mut Bit, bit: bool) -> bool {
        let bit = self.split((a.probability() + b.probability()) >> 1, bit);
        a.update(bit);
        b.update(bit);
        bit
    }

    /// Codes the lowest `n` bits of `value` with probability 1/2, highest first.
    fn plain(&mut self, value: u64, n: u32) -> u64 {
        (0..n)
            .rev()
            .fold(0, |read, i| read << 1 | u64::from(self.split(1 << 15, value >> i & 1 == 1)))
    }
}

/// The part of the range for `false`: at least 1, and less than the whole range.
fn split_range(range: u32, probability: u32) -> u32 {
    ((u64::from(range) * u64::from(probability)) >> 16) as u32
}

/// A range encoder that appends to a vector.
#[derive(Debug)]
pub struct RangeEncoder<'a> {
    out: &'a mut Vec<u8>,
    start: usize,
    limit: usize,
    overflow: bool,
    low: u64,
    range: u32,
    /// The last byte, not written yet because a carry may still reach it; the very first is always 0 and dropped.
    cached: Option<u8>,
    /// Number of 0xff bytes between `cached` and `low`.
    pending: usize,
}

impl<'a> RangeEncoder<'a> {
    /// Appends to `out`, at most `limit` bytes.
    pub fn new(out: &'a mut Vec<u8>, limit: usize) -> Self {
        let start = out.len();
        let (low, range) = (0, u32::MAX);
        Self { out, start, limit, overflow: false, low, range, cached: None, pending: 0 }
    }

    fn emit(&mut self, byte: u8) {
        if self.out.len() - self.start < self.limit {
            self.out.push(byte);
        } else {
            self.overflow = true;
        }
    }

    fn shift_low(&mut self) {
        if self.low < 0xff00_0000 || self.low > u64::from(u32::MAX) {
            let carry = (self.low >> 32) as u8;
            if let Some(cached) = self.cached {
                self.emit(cached.wrapping_add(carry));
            }
            // No carry reaches the very first byte: low + range starts below 2^32.
            for _ in 0..std::mem::take(&mut self.pending) {
                self.emit(0xff_u8.wrapping_add(carry));
            }
            self.cached = Some((self.low >> 24) as u8);
        } else {
            self.pending += 1;
        }
        self.low = (self.low & 0x00ff_ffff) << 8;
    }

    /// Called about once per eight bits of information.
    #[cold]
    fn refill(&mut self) {
        while self.range < TOP {
            self.range <<= 8;
            self.shift_low();
        }
    }

    /// Flushes the encoder. `false` when the bytes exceed the limit and are unusable.
    #[must_use]
    pub fn finish(mut self) -> bool {
        // The value in the range with the most trailing zeros, which are dropped below.
        let last = self.low + u64::from(self.range) - 1;
        for zeros in (0..=32).rev() {
            let value = last >> zeros << zeros;
            if value >= self.low {
                self.low = value;
                break;
            }
        }
        for _ in 0..5 {
            self.shift_low();
        }
        let kept = self.out[self.start..].iter().rposition(|&b| b != 0).map_or(0, |i| i + 1);
        self.out.truncate(self.start + kept);
        !self.overflow
    }
}

impl BinaryCoder for RangeEncoder<'_> {
    #[inline(always)]
    fn split(&mut self, probability: u32, bit: bool) -> bool {
        let bound = split_range(self.range, probability);
        self.low += u64::from(if bit { bound } else { 0 });
        self.range = if bit { self.range - bound } else { bound };
        if self.range < TOP {
            self.refill();
        }
        bit
    }
}

/// A range decoder of a slice, followed by zeros; arbitrary bytes decode to bits.
#[derive(Debug)]
pub struct RangeDecoder<'a> {
    rest: &'a [u8],
    code: u32,
    range: u32,
}

impl<'a> RangeDecoder<'a> {
    /// Starts at the first bit.
    #[must_use]
    pub fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = Self { rest: bytes, code: 0, range: u32::MAX };
        for _ in 0..4 {
            decoder.shift();
        }
        decoder
    }

    fn shift(&mut self) {
        let byte = match self.rest.split_first() {
            Some((&first, rest)) => {
                self.rest = rest;
                first
            }
            None => 0,
        };
        self.code = self.code << 8 | u32::from(byte);
    }

    /// Called about once per eight bits of information.
    #[cold]
    fn refill(&mut self) {
        while self.range < TOP {
            self.range <<= 8;
            self.shift();
        }
    }

    /// Checks that all bytes were read.
    ///
    /// # Errors
    /// `Corrupt` when bytes are left over, which an encoder does not write.
    pub fn finish(self) -> Result<(), CodecError> {
        if self.rest.is_empty() {
            return Ok(());
        }
        Err(CodecError::Corrupt("bytes after the payload"))
    }
}

impl BinaryCoder for RangeDecoder<'_> {
    #[inline(always)]
    fn split(&mut self, probability: u32, _bit: bool) -> bool {
        let bound = split_range(self.range, probability);
        let bit = self.code >= bound;
        // Without a branch, which would be unpredictable.
        self.code = select_unpredictable(bit, self.code.wrapping_sub(bound), self.code);
        self.range = select_unpredictable(bit, self.range - bound, bound);
        if self.range < TOP {
            self.refill();
        }
        bit
    }
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::random::Random;

    use super::*;

    /// Random bits, from probability 1/2 to near certainty, so that carries and runs of 0xff occur.
    fn bits(seed: u64, n: usize) -> Vec<bool> {
        let mut random = Random::new(seed);
        (0..n).map(|i| random.below(1000) < (i * 7 / n) * 166).collect()
    }

    #[test]
    fn bits_round_trip_and_every_byte_is_needed() {
        for seed in 0..200 {
            let bits = bits(seed, 3000);
            let mut out = vec![9];
            let mut encoder = RangeEncoder::new(&mut out, usize::MAX);
            let mut models = [Bit::NEW; 5];
            for (i, &bit) in bits.iter().enumerate() {
                encoder.bit(&mut models[i % 5], bit);
                if i % 100 == 0 {
                    encoder.plain(i as u64, 12);
                }
            }
            assert!(encoder.finish());
            assert_ne!(out.last(), Some(&0));
            let mut decoder = RangeDecoder::new(&out[1..]);
            let mut models = [Bit::NEW; 5];
            for (i, &bit) in bits.iter().enumerate() {
                assert_eq!(decoder.bit(&mut models[i % 5], false), bit);
                if i % 100 == 0 {
                    assert_eq!(decoder.plain(0, 12), i as u64);
                }
            }
            assert_eq!(decoder.finish(), Ok(()));
        }
    }

    #[test]
    fn probable_bits_cost_nothing_and_the_limit_holds() {
        let mut out = Vec::new();
        let mut encoder = RangeEncoder::new(&mut out, usize::MAX);
        let mut model = Bit::NEW;
        (0..30).for_each(|_| assert!(!encoder.bit(&mut model, false)));
        assert!(encoder.finish());
        assert!(out.is_empty());

        let mut encoder = RangeEncoder::new(&mut out, 10);
        encoder.plain(0x0123_4567_89ab_cdef, 64);
        encoder.plain(0x0123_4567_89ab_cdef, 64);
        assert!(!encoder.finish());
        assert!(out.len() <= 10);
    }

    #[test]
    fn left_over_bytes_are_corrupt() {
        let mut decoder = RangeDecoder::new(&[1, 2, 3, 4, 5, 6]);
        decoder.plain(0, 8);
        assert!(matches!(decoder.finish(), Err(CodecError::Corrupt(_))));
    }
}

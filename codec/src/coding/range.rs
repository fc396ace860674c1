//! Adaptive binary range coding, after (Martin 1979) with the carry handling of LZMA.
//!
//! 32 bits of range, probabilities of 16 bits. The encoder drops trailing zero bytes; the decoder
//! reads zeros past the end, so a block of nothing but expected bits takes no byte at all. Both are
//! exact integer arithmetic; `docs/codec.md` (Range coder) gives every step.
//!
//! A syntax is written once, over a [`BinaryCoder`], and then both encodes and decodes:
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

/// One adaptive bit: two estimates of the probability of `false`, a nimble one and a steady one.
#[derive(Debug, Clone, Copy)]
pub struct Bit {
    nimble: u16,
    steady: u16,
    /// Bits seen, saturating: young estimates move faster.
    seen: u8,
}

impl Bit {
    /// Shifts of the exponential averages once they are grown up.
    const NIMBLE_SHIFT: u32 = 5;
    const STEADY_SHIFT: u32 = 7;
    /// At this count `ilog2(seen + 2)` has reached the larger shift.
    const GROWN_UP: u8 = 126;

    /// How many bits a first guess weighs.
    const PRIOR_SEEN: u8 = 14;

    /// Even odds, nothing seen.
    pub const NEW: Self = Self { nimble: 1 << 15, steady: 1 << 15, seen: 0 };

    /// Starts from the odds of `true` in 1/256, as if a few bits had been seen.
    #[must_use]
    pub const fn expecting(odds: u8) -> Self {
        let estimate = u16::MAX - ((odds as u16) << 8 | 0x80);
        Self { nimble: estimate, steady: estimate, seen: Self::PRIOR_SEEN }
    }

    /// Probability of `false` in 2^-16: the mean of both estimates, never 0 or 1.
    fn probability(self) -> u32 {
        ((u32::from(self.nimble) + u32::from(self.steady)) >> 1).clamp(32, (1 << 16) - 32)
    }

    fn learn(&mut self, bit: bool) {
        let age = (u32::from(self.seen) + 2).ilog2();
        for (estimate, shift) in [
            (&mut self.nimble, age.min(Self::NIMBLE_SHIFT)),
            (&mut self.steady, age.min(Self::STEADY_SHIFT)),
        ] {
            if bit {
                *estimate -= *estimate >> shift;
            } else {
                *estimate += (u16::MAX - *estimate) >> shift;
            }
        }
        self.seen = (self.seen + 1).min(Self::GROWN_UP);
    }
}

/// Encoder and decoder behind one face, so that a syntax is written once for both.
pub trait BinaryCoder {
    /// Encodes `bit` and gives it back, or ignores it and gives the decoded one.
    fn split(&mut self, probability: u32, bit: bool) -> bool;

    /// An adaptive bit.
    fn bit(&mut self, model: &mut Bit, bit: bool) -> bool {
        let bit = self.split(model.probability(), bit);
        model.learn(bit);
        bit
    }

    /// An adaptive bit expected by two models together: the mean of both counts, and both learn.
    fn mixed(&mut self, a: &mut Bit, b: &mut Bit, bit: bool) -> bool {
        let bit = self.split((a.probability() + b.probability()) >> 1, bit);
        a.learn(bit);
        b.learn(bit);
        bit
    }

    /// `n` bits of equal odds, highest first.
    fn plain(&mut self, value: u64, n: u32) -> u64 {
        (0..n)
            .rev()
            .fold(0, |read, i| read << 1 | u64::from(self.split(1 << 15, value >> i & 1 == 1)))
    }
}

/// The part of the range that stands for `false`: at least 1, and less than the whole.
fn split_range(range: u32, probability: u32) -> u32 {
    ((u64::from(range) * u64::from(probability)) >> 16) as u32
}

/// Appends to a vector, at most `limit` bytes.
#[derive(Debug)]
pub struct RangeEncoder<'a> {
    out: &'a mut Vec<u8>,
    start: usize,
    limit: usize,
    overflow: bool,
    low: u64,
    range: u32,
    /// The last byte not written yet because a carry may still reach it; the first is always 0 and dropped.
    held: Option<u8>,
    /// Bytes of 0xff between `held` and `low`.
    pending: usize,
}

impl<'a> RangeEncoder<'a> {
    /// Appends to `out`, at most `limit` bytes.
    pub fn new(out: &'a mut Vec<u8>, limit: usize) -> Self {
        let start = out.len();
        Self { out, start, limit, overflow: false, low: 0, range: u32::MAX, held: None, pending: 0 }
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
            if let Some(held) = self.held {
                self.emit(held.wrapping_add(carry));
            }
            // The very first byte has nothing before it, and no carry: low + range starts below 2^32.
            for _ in 0..std::mem::take(&mut self.pending) {
                self.emit(0xff_u8.wrapping_add(carry));
            }
            self.held = Some((self.low >> 24) as u8);
        } else {
            self.pending += 1;
        }
        self.low = (self.low & 0x00ff_ffff) << 8;
    }

    /// After every eighth bit's worth of decisions, about.
    #[cold]
    fn refill(&mut self) {
        while self.range < TOP {
            self.range <<= 8;
            self.shift_low();
        }
    }

    /// Writes what is held; gives `false` when the limit was passed, and then the bytes are of no use.
    #[must_use]
    pub fn finish(mut self) -> bool {
        // Of all values in the range the one with most trailing zeros, which are then dropped.
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

/// Reads a slice, and zeros after it: any bytes give bits.
#[derive(Debug)]
pub struct RangeDecoder<'a> {
    rest: &'a [u8],
    code: u32,
    range: u32,
}

impl<'a> RangeDecoder<'a> {
    /// At the first bit.
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

    /// After every eighth bit's worth of decisions, about.
    #[cold]
    fn refill(&mut self) {
        while self.range < TOP {
            self.range <<= 8;
            self.shift();
        }
    }

    /// All bytes must have been needed.
    ///
    /// # Errors
    /// `Corrupt` when some were not: the encoder wrote something else.
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
        // Without a branch: the bit is what nobody knows.
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

    /// Skews from even odds to near certainty, so that carries and runs of 0xff occur.
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
    fn expected_bits_cost_nothing_and_the_limit_holds() {
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
    fn bytes_too_many_are_corrupt() {
        let mut decoder = RangeDecoder::new(&[1, 2, 3, 4, 5, 6]);
        decoder.plain(0, 8);
        assert!(matches!(decoder.finish(), Err(CodecError::Corrupt(_))));
    }
}

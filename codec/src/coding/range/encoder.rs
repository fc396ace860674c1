//! The encoding half.

use super::{BinaryCoder, TOP, split_range};

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

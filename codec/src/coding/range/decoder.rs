//! The decoding half.

use std::hint::select_unpredictable;

use super::{BinaryCoder, TOP, split_range};
use crate::CodecError;

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

//! The bits of a payload, read from the end.

use std::cmp::Ordering;

use super::{
    model::{STATE_BITS, STATES},
    tans::{BASE_AT, Entry, SHIFT_AT, Tables},
};
use crate::CodecError;

const CUT_SHORT: CodecError = CodecError::Truncated("the coded residuals");

/// Symbols that can be read after a refill: [`STATE_BITS`] each, of 56.
pub(super) const SYMBOLS_FILLED: usize = 56 / STATE_BITS as usize;

/// Bytes before the payload, so that eight can be read at any place that is not beyond the start.
pub(super) const PAD: usize = 16;

/// Reads bits from the end.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reader<'a> {
    padded: &'a [u8],
    /// Bytes that are not in `word` yet.
    bytes: usize,
    /// The next bits, from bit 63 down.
    word: u64,
    /// How many of them are there.
    filled: u32,
    /// What comes before the bits, padding and others' bytes.
    floor: usize,
    state: usize,
}

impl<'a> Reader<'a> {
    /// Copies the payload behind padding.
    pub(super) fn pad(payload: &[u8], padded: &mut Vec<u8>) {
        padded.clear();
        padded.extend_from_slice(&[0; PAD]);
        padded.extend_from_slice(payload);
    }

    /// `padded` comes from [`pad`](Self::pad).
    pub(super) fn new(padded: &'a [u8]) -> Result<Self, CodecError> {
        let last = padded.get(PAD..).and_then(<[u8]>::last).ok_or(CUT_SHORT)?;
        if *last == 0 {
            return Err(CodecError::Corrupt("residuals without an end mark"));
        }
        let bytes = padded.len();
        let mut reader = Self { padded, bytes, word: 0, filled: 0, floor: PAD, state: 0 };
        reader.refill()?;
        reader.skip(1 + last.leading_zeros());
        Ok(reader)
    }

    /// At least 56 bits are there afterwards.
    #[inline(always)]
    pub(super) fn refill(&mut self) -> Result<(), CodecError> {
        let bytes = self.padded.get(self.bytes.wrapping_sub(8)..self.bytes).ok_or(CUT_SHORT)?;
        let next = bytes.first_chunk::<8>().map_or(0, |bytes| u64::from_le_bytes(*bytes));
        // What is below the filled bits is what comes next: to set it twice does no harm.
        self.word |= next >> self.filled;
        self.bytes -= ((63 - self.filled) / 8) as usize;
        self.filled |= 56;
        Ok(())
    }

    /// The next bits from bit 63 down; at least 56 of them.
    #[inline(always)]
    pub(super) fn peek(&mut self) -> Result<u64, CodecError> {
        self.refill()?;
        Ok(self.word)
    }

    /// Passes bits that were peeked at.
    #[inline(always)]
    pub(super) fn skip(&mut self, width: u32) {
        self.word <<= width;
        self.filled -= width;
    }

    /// So many bytes of the payload, from its start, belong to another.
    pub(super) fn leave(&mut self, bytes: usize) {
        self.floor += bytes;
    }

    pub(super) fn flag(&mut self) -> Result<bool, CodecError> {
        let word = self.peek()?;
        self.skip(1);
        Ok(word >> 63 == 1)
    }

    pub(super) fn read_state(&mut self) -> Result<(), CodecError> {
        self.state = (self.peek()? >> (64 - STATE_BITS)) as usize;
        self.skip(STATE_BITS);
        Ok(())
    }

    /// The entry of the next symbol of the table at a place. At most [`STATE_BITS`] are read, which must be there.
    #[inline(always)]
    pub(super) fn entry(&mut self, tables: &Tables, place: usize) -> Result<Entry, CodecError> {
        // Not cut to the table's size: the next entry would wait for that.
        let at = place * STATES + self.state;
        let entry = *tables.entries.get(at).ok_or(CodecError::Corrupt("a state beyond all"))?;
        let shift = entry >> SHIFT_AT;
        let base = entry >> BASE_AT & (STATES as u32 - 1);
        // In two steps: a shift by 64 is none.
        self.state = (u64::from(base) + (self.word >> 1 >> shift)) as usize;
        self.skip(63 - shift);
        Ok(entry)
    }

    /// All must have been read, down to the state that the encoder began with.
    pub(super) fn finish(self) -> Result<(), CodecError> {
        match (8 * self.bytes + self.filled as usize).cmp(&(8 * self.floor)) {
            Ordering::Less => Err(CUT_SHORT),
            Ordering::Equal if self.state == 0 => Ok(()),
            _ => Err(CodecError::Corrupt("residuals left over")),
        }
    }
}

//! Byte and entropy coding that the resamplers share: exact integer arithmetic, bounded on hostile bytes. Here are
//! LEB128 varints and a bounds-checked reader of a block's bytes; [`range`] is the entropy coder.

pub(crate) mod isa;
pub mod range;

use super::{CodecError, Result, ensure};

/// Longest varint: ten groups of seven bits hold 64 bits.
pub(crate) const MAX_VARINT_BYTES: usize = 10;

/// Appends a LEB128 varint: groups of seven bits, least significant first, the high bit set on all but the last byte.
pub(crate) fn write_varint(mut value: u64, out: &mut Vec<u8>) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Number of bytes that [`write_varint`] appends.
pub(crate) fn varint_len(value: u64) -> usize {
    (64 - (value | 1).leading_zeros() as usize).div_ceil(7)
}

/// Reads a block from front to back; `what` names the value in errors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bytes<'a> {
    rest: &'a [u8],
}

impl<'a> Bytes<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.rest.is_empty()
    }

    pub(crate) fn take(&mut self, n: usize, what: &'static str) -> Result<&'a [u8]> {
        let (head, rest) = self.rest.split_at_checked(n).ok_or(CodecError::Truncated(what))?;
        self.rest = rest;
        Ok(head)
    }

    pub(crate) fn byte(&mut self, what: &'static str) -> Result<u8> {
        let (&first, rest) = self.rest.split_first().ok_or(CodecError::Truncated(what))?;
        self.rest = rest;
        Ok(first)
    }

    /// Reads a varint. Only the shortest form is valid, so that every value has one encoding.
    pub(crate) fn varint(&mut self, what: &'static str) -> Result<u64> {
        let mut value = 0_u64;
        for group in 0..MAX_VARINT_BYTES {
            let byte = self.byte(what)?;
            let bits = u64::from(byte & 0x7f);
            ensure(group < MAX_VARINT_BYTES - 1 || bits <= 1, "a varint of more than 64 bits")?;
            value |= bits << (7 * group);
            if byte & 0x80 == 0 {
                ensure(byte != 0 || group == 0, "a varint that is not in its shortest form")?;
                return Ok(value);
            }
        }
        Err(CodecError::Corrupt("a varint without a last byte"))
    }

    /// Takes all remaining bytes.
    pub(crate) fn rest(&mut self) -> &'a [u8] {
        std::mem::take(&mut self.rest)
    }

    /// Checks that no bytes remain: the payload must end with the block.
    pub(crate) fn finish(self) -> Result<()> {
        if self.is_empty() { Ok(()) } else { Err(CodecError::Corrupt("bytes after the payload")) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn varints_round_trip_at_their_announced_length() {
        for value in [0, 1, 127, 128, 16_383, 16_384, 1 << 63, u64::MAX] {
            let mut out = Vec::new();
            write_varint(value, &mut out);
            assert_eq!(out.len(), varint_len(value));
            let mut bytes = Bytes::new(&out);
            assert_eq!(bytes.varint("value"), Ok(value));
            assert!(bytes.finish().is_ok());
        }
    }

    #[test]
    fn only_the_shortest_form_is_accepted() {
        for bad in [&[0x80, 0x00][..], &[0xff; 10], &[0xff; 11]] {
            assert!(matches!(Bytes::new(bad).varint("value"), Err(CodecError::Corrupt(_))));
        }
        assert_eq!(Bytes::new(&[0x80]).varint("value"), Err(CodecError::Truncated("value")));
    }
}

//! A cursor over the bytes of a block, and LEB128 varints.

use crate::{CodecError, Result, ensure};

/// Longest varint: ten groups of seven bits hold 64.
pub(crate) const MAX_VARINT_BYTES: usize = 10;

/// Little-endian base 128, least significant group first, high bit set on all but the last byte.
pub(crate) fn write_varint(mut value: u64, out: &mut Vec<u8>) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Bytes that [`write_varint`] appends.
pub(crate) fn varint_len(value: u64) -> usize {
    (64 - (value | 1).leading_zeros() as usize).div_ceil(7)
}

/// Reads a block from front to back.
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

    /// Only the shortest form is accepted: one value has one spelling.
    pub(crate) fn varint(&mut self, what: &'static str) -> Result<u64> {
        let mut value = 0_u64;
        for group in 0..MAX_VARINT_BYTES {
            let byte = self.byte(what)?;
            let bits = u64::from(byte & 0x7f);
            ensure(group < MAX_VARINT_BYTES - 1 || bits <= 1, "a varint of more than 64 bits")?;
            value |= bits << (7 * group);
            if byte & 0x80 == 0 {
                ensure(byte != 0 || group == 0, "a varint longer than it needs to be")?;
                return Ok(value);
            }
        }
        Err(CodecError::Corrupt("a varint without an end"))
    }

    /// Everything not read yet.
    pub(crate) fn rest(&mut self) -> &'a [u8] {
        std::mem::take(&mut self.rest)
    }

    /// The payload must end where the block does.
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
    fn other_spellings_are_refused() {
        for bad in [&[0x80, 0x00][..], &[0xff; 10], &[0xff; 11]] {
            assert!(matches!(Bytes::new(bad).varint("value"), Err(CodecError::Corrupt(_))));
        }
        assert_eq!(Bytes::new(&[0x80]).varint("value"), Err(CodecError::Truncated("value")));
    }
}

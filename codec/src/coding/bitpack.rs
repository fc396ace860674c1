//! Groups of unsigned integers, each group at the width of its widest member.
//!
//! A group is one byte of width (0 to 64), then `len * width` bits, least significant bit first.

use super::bytes::Bytes;
use crate::CodecError;

/// Values of one group; the last group of a column may be shorter.
pub(crate) const GROUP_LEN: usize = 32;

const GROUP_BYTES: usize = GROUP_LEN * 8;

/// Bits that the widest member needs, given the bitwise or of all members.
pub(crate) const fn width_of(union: u64) -> u32 {
    64 - union.leading_zeros()
}

/// Bytes of a group, its width byte included.
pub(crate) const fn group_bytes(len: usize, width: u32) -> usize {
    1 + (len * width as usize).div_ceil(8)
}

/// Appends one group of at most [`GROUP_LEN`] values, none wider than `width` bits.
pub(crate) fn pack(values: &[u64], width: u32, out: &mut Vec<u8>) {
    out.push(width as u8);
    if width == 0 {
        return;
    }
    let mut packed = [0_u8; GROUP_BYTES];
    let mut words = packed.as_chunks_mut::<8>().0.iter_mut();
    let (mut word, mut filled) = (0_u64, 0_u32);
    let mut flush = |word: u64| {
        if let Some(slot) = words.next() {
            *slot = word.to_le_bytes();
        }
    };
    for &value in values {
        word |= value << filled;
        filled += width;
        if filled >= 64 {
            flush(word);
            filled -= 64;
            word = if filled == 0 { 0 } else { value >> (width - filled) };
        }
    }
    flush(word);
    out.extend_from_slice(&packed[..(values.len() * width as usize).div_ceil(8)]);
}

/// Reads one group into all of `values`, which is at most [`GROUP_LEN`] long.
pub(crate) fn unpack(input: &mut Bytes<'_>, values: &mut [u64]) -> Result<(), CodecError> {
    let width = u32::from(input.byte("the width of a group")?);
    if width > 64 {
        return Err(CodecError::Corrupt("a group wider than 64 bits"));
    }
    let bits = input.take((values.len() * width as usize).div_ceil(8), "a group of values")?;
    // Nine spare bytes, so that a window of nine never leaves the array.
    let mut padded = [0_u8; GROUP_BYTES + 9];
    padded[..bits.len()].copy_from_slice(bits);
    let mask = if width == 64 { u64::MAX } else { (1 << width) - 1 };
    for (i, value) in values.iter_mut().enumerate() {
        let at = i * width as usize;
        let window = &padded[at / 8..at / 8 + 9];
        let mut low = [0_u8; 8];
        low.copy_from_slice(&window[..8]);
        let shift = at % 8;
        let mut word = u64::from_le_bytes(low) >> shift;
        if shift != 0 {
            word |= u64::from(window[8]) << (64 - shift);
        }
        *value = word & mask;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_width_and_length_round_trips() {
        let mut seed = 1_u64;
        for width in 0..=64 {
            for len in [1, 2, 31, 32] {
                let values: Vec<u64> = (0..len)
                    .map(|_| {
                        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                        if width == 0 { 0 } else { seed >> (64 - width) }
                    })
                    .collect();
                let mut out = Vec::new();
                pack(&values, width, &mut out);
                assert_eq!(out.len(), group_bytes(len, width));
                let mut input = Bytes::new(&out);
                let mut back = vec![0; len];
                unpack(&mut input, &mut back).unwrap();
                assert_eq!(back, values, "width {width}");
                assert!(input.is_empty());
            }
        }
    }

    #[test]
    fn a_width_of_65_is_corrupt() {
        let mut back = [0; 4];
        assert!(matches!(
            unpack(&mut Bytes::new(&[65, 0]), &mut back),
            Err(CodecError::Corrupt(_))
        ));
    }
}

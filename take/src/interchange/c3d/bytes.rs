//! The three ways a C3D file stores its numbers.

/// The processor that wrote the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ByteOrder {
    /// Little endian, IEEE 754 floats.
    Intel,
    /// Little endian words, VAX F floats.
    Dec,
    /// Big endian, IEEE 754 floats.
    Mips,
}

impl ByteOrder {
    /// By the processor code of the parameter section: 84, 85, 86.
    pub(super) fn from_code(code: u8) -> Option<Self> {
        match code {
            84 => Some(Self::Intel),
            85 => Some(Self::Dec),
            86 => Some(Self::Mips),
            _ => None,
        }
    }

    /// A 16-bit word.
    pub(super) fn word(self, bytes: [u8; 2]) -> u16 {
        match self {
            Self::Intel | Self::Dec => u16::from_le_bytes(bytes),
            Self::Mips => u16::from_be_bytes(bytes),
        }
    }

    /// A 32-bit float.
    pub(super) fn float(self, bytes: [u8; 4]) -> f32 {
        match self {
            Self::Intel => f32::from_le_bytes(bytes),
            Self::Dec => vax_f_float(bytes),
            Self::Mips => f32::from_be_bytes(bytes),
        }
    }

    /// The word at `offset`, if there is one.
    pub(super) fn word_at(self, bytes: &[u8], offset: usize) -> Option<u16> {
        let found = bytes.get(offset..offset.checked_add(2)?)?;
        Some(self.word(found.try_into().ok()?))
    }

    /// The float at `offset`, if there is one.
    pub(super) fn float_at(self, bytes: &[u8], offset: usize) -> Option<f32> {
        let found = bytes.get(offset..offset.checked_add(4)?)?;
        Some(self.float(found.try_into().ok()?))
    }
}

/// VAX F floating point: two little endian words, the one with sign, exponent (excess 128) and the upper seven
/// bits of the fraction first; the fraction is 0.1f. A zero exponent is zero, or with the sign set a reserved
/// operand (VAX Architecture Reference Manual, 1987, section 2.4).
fn vax_f_float([b0, b1, b2, b3]: [u8; 4]) -> f32 {
    let bits = u32::from_be_bytes([b1, b0, b3, b2]);
    let negative = bits >> 31 == 1;
    let exponent = (bits >> 23 & 0xFF) as i32;
    if exponent == 0 {
        return if negative { f32::NAN } else { 0.0 };
    }
    let fraction = f64::from(bits & 0x007F_FFFF | 0x0080_0000) / f64::from(1 << 24);
    let magnitude = fraction * f64::from(exponent - 128).exp2();
    (if negative { -magnitude } else { magnitude }) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vax_floats_known_by_their_bytes() {
        // 1.0 is 0x4080 as a word, 0.5 is 0x4000, -1.5 is 0xC0C0.
        for (bytes, value) in [
            ([0x80, 0x40, 0, 0], 1.0),
            ([0x00, 0x40, 0, 0], 0.5),
            ([0xC0, 0xC0, 0, 0], -1.5),
            ([0x49, 0x41, 0xD0, 0x0F], std::f32::consts::PI),
            ([0, 0, 0, 0], 0.0),
        ] {
            let found = ByteOrder::Dec.float(bytes);
            assert!((found - value).abs() <= value.abs() * 1e-5, "{found} is not {value}");
        }
        assert!(ByteOrder::Dec.float([0x00, 0x80, 0, 0]).is_nan());
        assert_eq!(ByteOrder::Dec.float([0x80, 0x40, 0, 0]).to_bits(), 1.0f32.to_bits());
    }

    #[test]
    fn mips_is_big_endian() {
        assert_eq!(ByteOrder::Mips.word([1, 2]), 0x0102);
        assert_eq!(ByteOrder::Mips.float([0x3F, 0x80, 0, 0]).to_bits(), 1.0f32.to_bits());
    }
}

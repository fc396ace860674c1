//! The 512-byte header of a C3D file, and the number formats of the three processor types.

use crate::motion::MotionInfo;

/// Bytes of a block, in which C3D counts offsets.
pub(super) const BLOCK: usize = 512;
/// The value of header word 150 if event labels have four characters.
const FOUR_CHARACTER_LABELS: u16 = 12345;
/// Maximum number of events a header holds.
pub(super) const MAX_EVENTS: usize = 18;

/// An event of the header.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct HeaderEvent {
    /// Seconds from the start of the trial.
    pub(super) time_s: f32,
    /// The display flag as stored.
    pub(super) flag: u8,
    /// Four characters.
    pub(super) label: [u8; 4],
}

/// The header.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct C3dHeader {
    /// First block of the parameter section, counted from 1.
    pub(super) parameter_block: u8,
    /// Points in a frame.
    pub(super) n_points: u16,
    /// Analog samples in a frame, of all channels together.
    pub(super) analog_per_frame: u16,
    /// Number of the first frame.
    pub(super) first_frame: u16,
    /// Number of the last frame.
    pub(super) last_frame: u16,
    /// Longest interpolated gap in frames.
    pub(super) max_gap: u16,
    /// Scale factor of integer coordinates; negative if the file has floats.
    pub(super) scale: f32,
    /// First block of the data, counted from 1.
    pub(super) data_block: u16,
    /// Analog samples of one channel in a frame.
    pub(super) analog_ratio: u16,
    /// Frames a second.
    pub(super) rate_hz: f32,
    /// Header events; at most [`MAX_EVENTS`] are written.
    pub(super) events: Vec<HeaderEvent>,
}

impl C3dHeader {
    /// Parses a header; `None` if there are fewer bytes than a block.
    pub(super) fn parse(bytes: &[u8], order: ByteOrder) -> Option<Self> {
        let bytes = bytes.get(..BLOCK)?;
        Some(Self {
            parameter_block: *bytes.first()?,
            n_points: order.word_at(bytes, 2)?,
            analog_per_frame: order.word_at(bytes, 4)?,
            first_frame: order.word_at(bytes, 6)?,
            last_frame: order.word_at(bytes, 8)?,
            max_gap: order.word_at(bytes, 10)?,
            scale: order.float_at(bytes, 12)?,
            data_block: order.word_at(bytes, 16)?,
            analog_ratio: order.word_at(bytes, 18)?,
            rate_hz: order.float_at(bytes, 20)?,
            events: events(bytes, order).unwrap_or_default(),
        })
    }

    /// Encodes the header in Intel order.
    pub(super) fn to_bytes(&self) -> [u8; BLOCK] {
        let mut bytes = [0; BLOCK];
        let mut put = |offset: usize, field: &[u8]| {
            if let Some(place) = bytes.get_mut(offset..offset + field.len()) {
                place.copy_from_slice(field);
            }
        };
        put(0, &[self.parameter_block, 0x50]);
        put(2, &self.n_points.to_le_bytes());
        put(4, &self.analog_per_frame.to_le_bytes());
        put(6, &self.first_frame.to_le_bytes());
        put(8, &self.last_frame.to_le_bytes());
        put(10, &self.max_gap.to_le_bytes());
        put(12, &self.scale.to_le_bytes());
        put(16, &self.data_block.to_le_bytes());
        put(18, &self.analog_ratio.to_le_bytes());
        put(20, &self.rate_hz.to_le_bytes());
        put(298, &FOUR_CHARACTER_LABELS.to_le_bytes());
        put(300, &(self.events.len().min(MAX_EVENTS) as u16).to_le_bytes());
        for (index, event) in self.events.iter().take(MAX_EVENTS).enumerate() {
            put(304 + 4 * index, &event.time_s.to_le_bytes());
            put(376 + index, &[event.flag]);
            put(396 + 4 * index, &event.label);
        }
        bytes
    }
}

/// The events of a header with four-character labels; `None` for a header of the older form.
fn events(bytes: &[u8], order: ByteOrder) -> Option<Vec<HeaderEvent>> {
    if order.word_at(bytes, 298)? != FOUR_CHARACTER_LABELS {
        return None;
    }
    let n_events = usize::from(order.word_at(bytes, 300)?).min(MAX_EVENTS);
    let event = |index: usize| {
        Some(HeaderEvent {
            time_s: order.float_at(bytes, 304 + 4 * index)?,
            flag: *bytes.get(376 + index)?,
            label: bytes.get(396 + 4 * index..400 + 4 * index)?.try_into().ok()?,
        })
    };
    (0..n_events).map(event).collect()
}

/// The processor type of a file, which defines its byte order and float format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ByteOrder {
    /// Little endian, IEEE 754 floats.
    Intel,
    /// Little endian integers, VAX F floats.
    Dec,
    /// Big endian, IEEE 754 floats.
    Mips,
}

impl ByteOrder {
    /// The byte order of a processor code in the parameter section: 84, 85 or 86.
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

    /// The 16-bit word at `offset`; `None` past the end.
    pub(super) fn word_at(self, bytes: &[u8], offset: usize) -> Option<u16> {
        let found = bytes.get(offset..offset.checked_add(2)?)?;
        Some(self.word(found.try_into().ok()?))
    }

    /// The 32-bit float at `offset`; `None` past the end.
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

/// Whether a reader counts the frames by the length of the file and so would read padding as frames. ezc3d does if
/// POINT:FRAMES is 65535, which stands for every larger count; py-c3d does if the number of the first frame exceeds 16
/// bits, because it then computes that number one too low and expects one frame more.
pub(super) fn is_counted_by_length(info: &MotionInfo) -> bool {
    let max = u64::from(u16::MAX);
    info.n_frames >= max || info.source.first_frame > max
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vax_floats_decode() {
        // The upper word of 1.0 is 0x4080, of 0.5 0x4000, of -1.5 0xC0C0.
        for (bytes, value) in [
            ([0x80, 0x40, 0, 0], 1.0),
            ([0x00, 0x40, 0, 0], 0.5),
            ([0xC0, 0xC0, 0, 0], -1.5),
            ([0x49, 0x41, 0xD0, 0x0F], std::f32::consts::PI),
            ([0, 0, 0, 0], 0.0),
        ] {
            let found = ByteOrder::Dec.float(bytes);
            assert!((found - value).abs() <= value.abs() * 1e-5, "{found} for {value}");
        }
        assert!(ByteOrder::Dec.float([0x00, 0x80, 0, 0]).is_nan());
        assert_eq!(ByteOrder::Dec.float([0x80, 0x40, 0, 0]).to_bits(), 1.0f32.to_bits());
    }

    #[test]
    fn mips_is_big_endian() {
        assert_eq!(ByteOrder::Mips.word([1, 2]), 0x0102);
        assert_eq!(ByteOrder::Mips.float([0x3F, 0x80, 0, 0]).to_bits(), 1.0f32.to_bits());
    }

    #[test]
    fn a_written_header_reads_back() {
        let header = C3dHeader {
            parameter_block: 2,
            n_points: 300,
            analog_per_frame: 40,
            first_frame: 7,
            last_frame: 65535,
            max_gap: 10,
            scale: -0.1,
            data_block: 99,
            analog_ratio: 5,
            rate_hz: 119.88,
            events: vec![HeaderEvent { time_s: 0.25, flag: 1, label: *b"RHS " }],
        };
        assert_eq!(C3dHeader::parse(&header.to_bytes(), ByteOrder::Intel), Some(header));
    }
}

//! Samples on the wire: a tag, a time stamp if it is not left to the receiver, and one value per channel.
//!
//! The layout is that of protocol 1.10 (`sample.cpp` of liblsl). Values are decoded one at a time, without allocating.

/// The form of a stream's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ValueFormat {
    /// 32-bit floats.
    #[default]
    Float32,
    /// 64-bit floats.
    Double64,
    /// Texts.
    Text,
    /// 8-bit integers.
    Int8,
    /// 16-bit integers.
    Int16,
    /// 32-bit integers.
    Int32,
    /// 64-bit integers.
    Int64,
}

impl ValueFormat {
    const NAMES: [(&'static str, Self); 7] = [
        ("float32", Self::Float32),
        ("double64", Self::Double64),
        ("string", Self::Text),
        ("int8", Self::Int8),
        ("int16", Self::Int16),
        ("int32", Self::Int32),
        ("int64", Self::Int64),
    ];

    pub(super) fn named(name: &str) -> Option<Self> {
        Self::NAMES.iter().find(|(known, _)| *known == name).map(|(_, format)| *format)
    }

    /// Its name in descriptions.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, format)| *format == self).map_or("", |(name, _)| name)
    }

    /// Bytes of a value; `None` for texts.
    #[must_use]
    pub fn bytes(self) -> Option<usize> {
        match self {
            Self::Text => None,
            Self::Int8 => Some(1),
            Self::Int16 => Some(2),
            Self::Float32 | Self::Int32 => Some(4),
            Self::Double64 | Self::Int64 => Some(8),
        }
    }
}

/// Tags in front of a sample: without a time stamp, and with one.
const WITHOUT_TIME: u8 = 1;
const WITH_TIME: u8 = 2;

/// Longest text of a channel: settings as XML and pictures in base64 have been seen, of which an event has the beginning.
pub(super) const TEXT_BYTES_MAX: usize = 1 << 20;

/// Appends a sample of numbers; without a time it was taken one period after the one before.
pub(super) fn put_floats(
    time_s: Option<f64>,
    values: &[f32],
    is_big_endian: bool,
    suppresses_subnormals: bool,
    out: &mut Vec<u8>,
) {
    put_time(time_s, is_big_endian, out);
    for value in values {
        let is_suppressed = suppresses_subnormals && value.is_subnormal();
        let value = if is_suppressed { 0.0 } else { *value };
        let bytes = if is_big_endian { value.to_be_bytes() } else { value.to_le_bytes() };
        out.extend_from_slice(&bytes);
    }
}

/// Appends a sample of one text.
pub(super) fn put_text(time_s: f64, text: &str, is_big_endian: bool, out: &mut Vec<u8>) {
    put_time(Some(time_s), is_big_endian, out);
    match u8::try_from(text.len()) {
        Ok(length) => out.extend_from_slice(&[1, length]),
        Err(_) => {
            let length = u32::try_from(text.len()).unwrap_or(u32::MAX);
            out.push(4);
            out.extend_from_slice(&match is_big_endian {
                true => length.to_be_bytes(),
                false => length.to_le_bytes(),
            });
        }
    }
    out.extend_from_slice(text.as_bytes());
}

fn put_time(time_s: Option<f64>, is_big_endian: bool, out: &mut Vec<u8>) {
    let Some(time_s) = time_s else {
        out.push(WITHOUT_TIME);
        return;
    };
    out.push(WITH_TIME);
    out.extend_from_slice(&if is_big_endian { time_s.to_be_bytes() } else { time_s.to_le_bytes() });
}

/// What is agreed about a feed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct WireFormat {
    pub(super) format: ValueFormat,
    pub(super) n_channels: usize,
    /// Whether numbers have their most significant byte first.
    pub(super) is_big_endian: bool,
}

/// A sample in the bytes of a feed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WireSample<'a> {
    /// When it was taken, in seconds; `None` for a period after the one before.
    pub(super) time_s: Option<f64>,
    /// Its values.
    values: &'a [u8],
    wire: WireFormat,
}

/// Why the bytes of a feed cannot be decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FeedDamage {
    /// No sample begins with this byte.
    Tag(u8),
    /// A text states so many bytes.
    Length(u64),
}

impl WireFormat {
    /// The first sample of `bytes`, and its size; `None` when more bytes are needed.
    pub(super) fn sample<'a>(
        &self,
        bytes: &'a [u8],
    ) -> Result<Option<(WireSample<'a>, usize)>, FeedDamage> {
        let Some((&tag, rest)) = bytes.split_first() else { return Ok(None) };
        let (time_s, rest) = match tag {
            WITHOUT_TIME => (None, rest),
            WITH_TIME => match rest.split_first_chunk::<8>() {
                Some((time, rest)) => (Some(f64::from_bits(self.u64(*time))), rest),
                None => return Ok(None),
            },
            other => return Err(FeedDamage::Tag(other)),
        };
        let Some(n) = self.values_bytes(rest)? else { return Ok(None) };
        let Some(values) = rest.get(..n) else { return Ok(None) };
        let used = bytes.len() - rest.len() + n;
        Ok(Some((WireSample { time_s, values, wire: *self }, used)))
    }

    /// Bytes of the values of a sample; `None` when more bytes are needed to know.
    fn values_bytes(&self, bytes: &[u8]) -> Result<Option<usize>, FeedDamage> {
        if let Some(n) = self.format.bytes() {
            return Ok(Some(n * self.n_channels));
        }
        let mut n = 0;
        for _ in 0..self.n_channels {
            let Some(rest) = bytes.get(n..) else { return Ok(None) };
            match self.text_length(rest)? {
                Some((head, length)) => n += head + length,
                None => return Ok(None),
            }
        }
        Ok(Some(n))
    }

    /// Bytes of a text's length, and the length.
    fn text_length(&self, bytes: &[u8]) -> Result<Option<(usize, usize)>, FeedDamage> {
        let Some((&width, rest)) = bytes.split_first() else { return Ok(None) };
        let length = match width {
            1 => rest.first().map(|&length| u64::from(length)),
            2 => rest.first_chunk().map(|bytes| u64::from(self.u16(*bytes))),
            4 => rest.first_chunk().map(|bytes| u64::from(self.u32(*bytes))),
            8 => rest.first_chunk().map(|bytes| self.u64(*bytes)),
            other => return Err(FeedDamage::Tag(other)),
        };
        let Some(length) = length else { return Ok(None) };
        match usize::try_from(length) {
            Ok(n) if n <= TEXT_BYTES_MAX => Ok(Some((1 + usize::from(width), n))),
            _ => Err(FeedDamage::Length(length)),
        }
    }

    fn u16(&self, bytes: [u8; 2]) -> u16 {
        if self.is_big_endian { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) }
    }

    fn u32(&self, bytes: [u8; 4]) -> u32 {
        if self.is_big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
    }

    fn u64(&self, bytes: [u8; 8]) -> u64 {
        if self.is_big_endian { u64::from_be_bytes(bytes) } else { u64::from_le_bytes(bytes) }
    }
}

/// A value, with all its bits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Value {
    Float32(f32),
    Double64(f64),
    Integer(i64),
}

impl Value {
    /// The value as a float32, rounded once; an infinite or missing one stays so.
    pub(super) fn to_f32(self) -> f32 {
        match self {
            Self::Float32(value) => value,
            Self::Double64(value) => value as f32,
            Self::Integer(value) => value as f32,
        }
    }

    /// Whether [`to_f32`](Self::to_f32) rounds it.
    pub(super) fn is_rounded(self) -> bool {
        match self {
            Self::Float32(_) => false,
            Self::Double64(value) => f64::from(value as f32) != value && !value.is_nan(),
            Self::Integer(value) => value as f32 as i128 != i128::from(value),
        }
    }

    /// The value times a factor, rounded once to float32.
    pub(super) fn scaled(self, factor: f64) -> f32 {
        let value = match self {
            Self::Float32(value) => f64::from(value),
            Self::Double64(value) => value,
            Self::Integer(value) => value as f64,
        };
        (value * factor) as f32
    }
}

impl WireSample<'_> {
    /// The number of a channel; `None` for texts and channels that there are not.
    pub(super) fn value(&self, channel: usize) -> Option<Value> {
        let n = self.wire.format.bytes()?;
        let bytes = self.values.get(channel * n..(channel + 1) * n)?;
        let wire = &self.wire;
        Some(match wire.format {
            ValueFormat::Text => return None,
            ValueFormat::Float32 => Value::Float32(f32::from_bits(wire.u32(*bytes.first_chunk()?))),
            ValueFormat::Double64 => {
                Value::Double64(f64::from_bits(wire.u64(*bytes.first_chunk()?)))
            }
            ValueFormat::Int8 => Value::Integer(i64::from(bytes.first()?.cast_signed())),
            ValueFormat::Int16 => {
                Value::Integer(wire.u16(*bytes.first_chunk()?).cast_signed().into())
            }
            ValueFormat::Int32 => {
                Value::Integer(wire.u32(*bytes.first_chunk()?).cast_signed().into())
            }
            ValueFormat::Int64 => Value::Integer(wire.u64(*bytes.first_chunk()?).cast_signed()),
        })
    }

    /// The values as one line of text, separated by spaces.
    pub(super) fn text(&self) -> String {
        let values: Vec<String> = match self.wire.format {
            ValueFormat::Text => self.texts(),
            _ => (0..self.wire.n_channels)
                .filter_map(|channel| Some(number(self.value(channel)?)))
                .collect(),
        };
        values.join(" ")
    }

    fn texts(&self) -> Vec<String> {
        let mut rest = self.values;
        let mut texts = Vec::new();
        while let Ok(Some((head, length))) = self.wire.text_length(rest) {
            let text = rest.get(head..head + length).unwrap_or_default();
            texts.push(String::from_utf8_lossy(text).into_owned());
            rest = rest.get(head + length..).unwrap_or_default();
        }
        texts
    }
}

fn number(value: Value) -> String {
    match value {
        Value::Float32(value) => value.to_string(),
        Value::Double64(value) => value.to_string(),
        Value::Integer(value) => value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use labstream_core::wire::{ByteOrder, Codec, Format, Sample, Value as Theirs};

    use super::*;

    /// Makes a value of a format out of a number.
    type ValueOf = fn(i64) -> Theirs;

    fn formats() -> [(ValueFormat, Format, ValueOf); 7] {
        [
            (ValueFormat::Float32, Format::Float32, |n| Theirs::F32(n as f32 / 4.0)),
            (ValueFormat::Double64, Format::Double64, |n| Theirs::F64(n as f64 / 7.0)),
            (ValueFormat::Text, Format::String, |n| {
                Theirs::Str("x".repeat(n.unsigned_abs() as usize).into())
            }),
            (ValueFormat::Int8, Format::Int8, |n| Theirs::I8(n as i8)),
            (ValueFormat::Int16, Format::Int16, |n| Theirs::I16(n as i16)),
            (ValueFormat::Int32, Format::Int32, |n| Theirs::I32(n as i32)),
            (ValueFormat::Int64, Format::Int64, |n| Theirs::I64(n << 33)),
        ]
    }

    fn is_same(ours: Option<Value>, theirs: &Theirs) -> bool {
        match (ours, theirs) {
            (Some(Value::Float32(a)), Theirs::F32(b)) => a.to_bits() == b.to_bits(),
            (Some(Value::Double64(a)), Theirs::F64(b)) => a.to_bits() == b.to_bits(),
            (Some(Value::Integer(a)), Theirs::I8(b)) => a == i64::from(*b),
            (Some(Value::Integer(a)), Theirs::I16(b)) => a == i64::from(*b),
            (Some(Value::Integer(a)), Theirs::I32(b)) => a == i64::from(*b),
            (Some(Value::Integer(a)), Theirs::I64(b)) => a == *b,
            (None, Theirs::Str(_)) => true,
            _ => false,
        }
    }

    #[test]
    fn samples_of_the_crates_encoder_are_read_in_both_byte_orders_and_at_every_cut() {
        for (format, theirs, value) in formats() {
            for order in [ByteOrder::Little, ByteOrder::Big] {
                let values: Vec<Theirs> = [-100, 3, 0].map(value).to_vec();
                let codec = Codec::new(theirs, 3, order);
                let mut bytes = Vec::new();
                for timestamp in [12.5, -1.0] {
                    let sample = Sample { timestamp, values: values.clone() };
                    codec.encode(&sample, &mut bytes).unwrap();
                }
                let is_big_endian = order == ByteOrder::Big;
                let wire = WireFormat { format, n_channels: 3, is_big_endian };
                let (first, used) = wire.sample(&bytes).unwrap().unwrap();
                assert_eq!(first.time_s, Some(12.5), "{format:?}");
                for (channel, value) in values.iter().enumerate() {
                    assert!(is_same(first.value(channel), value), "{format:?} {order:?} {channel}");
                }
                for cut in 0..used {
                    assert_eq!(wire.sample(&bytes[..cut]), Ok(None), "{format:?} cut at {cut}");
                }
                let (second, rest) = wire.sample(&bytes[used..]).unwrap().unwrap();
                assert_eq!((second.time_s, used + rest), (None, bytes.len()), "{format:?}");
            }
        }
    }

    #[test]
    fn texts_are_bounded_and_other_bytes_are_out_of_step() {
        let wire = WireFormat { format: ValueFormat::Text, n_channels: 1, is_big_endian: false };
        let at = wire.sample(&[1, 4, 0, 0, 0, 200]);
        assert_eq!(at, Err(FeedDamage::Length(200 << 24)));
        assert_eq!(wire.sample(&[1, 3, 0]), Err(FeedDamage::Tag(3)));
        assert_eq!(wire.sample(&[7]), Err(FeedDamage::Tag(7)));
        let (sample, _) = wire.sample(&[1, 1, 2, b'o', b'k']).unwrap().unwrap();
        assert_eq!(sample.text(), "ok");
        let (sample, _) = wire.sample(&[1, 1, 1, 0xff]).unwrap().unwrap();
        assert_eq!(sample.text(), "\u{fffd}");
    }

    #[test]
    fn numbers_are_rounded_once_and_it_is_known_which() {
        assert_eq!(Value::Float32(0.1).scaled(1000.0), (f64::from(0.1_f32) * 1000.0) as f32);
        assert!(
            !Value::Integer(1 << 24).is_rounded() && Value::Integer((1 << 24) + 1).is_rounded()
        );
        assert!(Value::Integer(i64::MAX).is_rounded());
        assert!(Value::Double64(0.1).is_rounded() && !Value::Double64(0.5).is_rounded());
        assert!(!Value::Double64(f64::NAN).is_rounded());
    }
}

//! Encoding and decoding of sampled channels: the description of a group, and batches of its samples.

use super::{
    ENVELOPE_BYTES, EncodeError, GROUPS_MAX, SAMPLE_VALUES_MAX, SAMPLE_VALUES_PER_S_MAX,
    SAMPLED_CHANNELS_MAX, SAMPLES_HEADER_BYTES, TEXT_BYTES_MAX, UNIT_BYTES_MAX,
    envelope::Framer,
    messages::{kind, put_text},
    wire_bytes,
};
use crate::{
    bytes::{Cursor, WireValue},
    device::{SampleBatch, SampleForm, SampledChannelInfo, SampledGroupInfo},
};

impl SampleForm {
    const ALL: [Self; 3] = [Self::Int16, Self::Int32, Self::Float32];

    /// Bytes of a sample on the wire.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::Int16 => 2,
            Self::Int32 | Self::Float32 => 4,
        }
    }

    /// Whether the form has this number.
    #[must_use]
    pub fn has(self, sample: f32) -> bool {
        let is_bits = |number: f32| number.to_bits() == sample.to_bits();
        match self {
            Self::Int16 => is_bits(f32::from(sample as i16)),
            Self::Int32 => sample.abs() <= INT32_MAX as f32 && is_bits(sample as i32 as f32),
            Self::Float32 => true,
        }
    }
}

/// The largest magnitude of a count of form `Int32`: float32, in which takes store samples, has all integers up to it.
/// Converters have at most 24 bits of resolution.
const INT32_MAX: i32 = 1 << 24;

/// Bytes on the wire of a batch, at most.
#[must_use]
pub const fn batch_bytes_max(form: SampleForm, n_channels: usize, n_samples: usize) -> usize {
    wire_bytes(ENVELOPE_BYTES + SAMPLES_HEADER_BYTES + n_channels * n_samples * form.bytes())
}

/// The reason why a group is invalid; sender and receiver apply the same rule.
fn group_error(group: &SampledGroupInfo) -> Option<&'static str> {
    let n_channels = group.channels.len();
    let per_s = u64::from(group.rate_millihertz) * n_channels as u64 / 1000;
    let is_finite = |channel: &SampledChannelInfo| {
        channel.scale.is_finite() && channel.scale != 0.0 && channel.offset.is_finite()
    };
    if usize::from(group.id) >= GROUPS_MAX {
        Some("its number is not below 16")
    } else if group.rate_millihertz == 0 {
        Some("its rate is 0")
    } else if !(1..=SAMPLED_CHANNELS_MAX).contains(&n_channels) {
        Some("a group has 1 to 64 channels")
    } else if per_s > SAMPLE_VALUES_PER_S_MAX {
        Some("it has more than 4 000 000 samples a second")
    } else if !group.channels.iter().all(is_finite) {
        Some("a scale is 0, or a scale or an offset is not finite")
    } else {
        None
    }
}

pub(super) fn put_group(group: &SampledGroupInfo, out: &mut Vec<u8>) -> Result<(), EncodeError> {
    if let Some(error) = group_error(group) {
        return Err(EncodeError::SampledGroup(error));
    }
    group.id.put(out);
    out.push(group.form as u8);
    group.rate_millihertz.put(out);
    out.push(group.channels.len() as u8);
    for channel in &group.channels {
        put_text("channel name", &channel.name, TEXT_BYTES_MAX, out)?;
        put_text("unit", &channel.unit, UNIT_BYTES_MAX, out)?;
        channel.scale.put(out);
        channel.offset.put(out);
    }
    Ok(())
}

/// Decodes a group into `group`, reusing its memory. After `None` its contents are unspecified.
pub(super) fn get_group(payload: &[u8], group: &mut SampledGroupInfo) -> Option<()> {
    let mut cursor = Cursor::new(payload);
    group.id = cursor.get()?;
    group.form = get_form(&mut cursor)?;
    group.rate_millihertz = cursor.get()?;
    let n_channels = usize::from(cursor.get::<u8>()?);
    if n_channels > SAMPLED_CHANNELS_MAX {
        return None;
    }
    group.channels.resize_with(n_channels, SampledChannelInfo::default);
    for channel in &mut group.channels {
        cursor.text(TEXT_BYTES_MAX)?.clone_into(&mut channel.name);
        cursor.text(UNIT_BYTES_MAX)?.clone_into(&mut channel.unit);
        (channel.scale, channel.offset) = (cursor.get()?, cursor.get()?);
    }
    cursor.end(()).filter(|()| group_error(group).is_none())
}

fn get_form(cursor: &mut Cursor<'_>) -> Option<SampleForm> {
    SampleForm::ALL.get(usize::from(cursor.get::<u8>()?)).copied()
}

/// The reason why a batch is invalid.
fn batch_error(batch: &SampleBatch<'_>) -> Option<&'static str> {
    let n_channels = usize::from(batch.n_channels);
    if usize::from(batch.group) >= GROUPS_MAX {
        Some("the number of its group is not below 16")
    } else if !(1..=SAMPLED_CHANNELS_MAX).contains(&n_channels) {
        Some("a group has 1 to 64 channels")
    } else if batch.samples.len() > SAMPLE_VALUES_MAX {
        Some("it has more than 16 384 samples")
    } else if !batch.samples.len().is_multiple_of(n_channels) {
        Some("its channels have different numbers of samples")
    } else {
        None
    }
}

pub(super) fn put_batch(
    framer: &mut Framer,
    batch: &SampleBatch<'_>,
    out: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    if let Some(error) = batch_error(batch) {
        return Err(EncodeError::Samples(error));
    }
    if !batch.samples.iter().all(|&sample| batch.form.has(sample)) {
        return Err(EncodeError::Samples("a sample is no number of its form"));
    }
    let message = framer.open(kind::SAMPLES);
    batch.group.put(message);
    message.push(batch.form as u8);
    batch.n_channels.put(message);
    (batch.n_samples() as u16).put(message);
    batch.number.put(message);
    batch.first.put(message);
    batch.device_ticks.put(message);
    for &sample in batch.samples {
        match batch.form {
            SampleForm::Int16 => (sample as i16).put(message),
            SampleForm::Int32 => (sample as i32).put(message),
            SampleForm::Float32 => sample.put(message),
        }
    }
    framer.close(out);
    Ok(())
}

/// Decodes a batch; its samples are in `samples`.
pub(super) fn get_batch<'a>(payload: &[u8], samples: &'a mut Vec<f32>) -> Option<SampleBatch<'a>> {
    let mut cursor = Cursor::new(payload);
    let group = cursor.get()?;
    let form = get_form(&mut cursor)?;
    let n_channels: u8 = cursor.get()?;
    let n = usize::from(cursor.get::<u16>()?) * usize::from(n_channels);
    let (number, first, device_ticks) = (cursor.get()?, cursor.get()?, cursor.get()?);
    if n > SAMPLE_VALUES_MAX {
        return None;
    }
    let bytes = cursor.bytes(n * form.bytes())?;
    cursor.end(())?;
    samples.clear();
    match form {
        SampleForm::Int16 => {
            let counts = bytes.as_chunks().0.iter();
            samples.extend(counts.map(|&count| f32::from(i16::from_le_bytes(count))));
        }
        SampleForm::Int32 => {
            for &count in bytes.as_chunks().0 {
                let count = i32::from_le_bytes(count);
                if !(-INT32_MAX..=INT32_MAX).contains(&count) {
                    return None;
                }
                samples.push(count as f32);
            }
        }
        SampleForm::Float32 => {
            samples.extend(bytes.as_chunks().0.iter().map(|&bytes| f32::from_le_bytes(bytes)));
        }
    }
    let batch = SampleBatch { group, number, first, device_ticks, form, n_channels, samples };
    batch_error(&batch).is_none().then_some(batch)
}

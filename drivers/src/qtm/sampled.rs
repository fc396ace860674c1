//! Analog and force components of frames, in both directions.

use std::ops::Range;

use crate::bytes::{Cursor, WireValue};

/// Values of a force: force, moment and point of application, of three axes each.
pub const FORCE_VALUES: usize = 9;

/// Components of samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum SampledComponentKind {
    /// All samples of analog devices since the last frame.
    Analog = 3,
    /// All forces of force plates since the last frame.
    Force = 4,
    /// The latest sample of each analog channel.
    AnalogSingle = 13,
    /// The latest force of each plate.
    ForceSingle = 15,
}

impl SampledComponentKind {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Analog, Self::Force, Self::AnalogSingle, Self::ForceSingle];

    pub(super) fn of(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| u32::from(*kind as u8) == code)
    }

    /// Its name in commands.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Analog => "Analog",
            Self::Force => "Force",
            Self::AnalogSingle => "AnalogSingle",
            Self::ForceSingle => "ForceSingle",
        }
    }

    /// Whether it is about force plates.
    #[must_use]
    pub fn is_force(self) -> bool {
        matches!(self, Self::Force | Self::ForceSingle)
    }

    /// Whether it has the latest sample alone, without its number.
    #[must_use]
    pub fn is_single(self) -> bool {
        matches!(self, Self::AnalogSingle | Self::ForceSingle)
    }
}

/// The samples of a device, or of a plate, in a frame.
#[derive(Debug, Clone, Copy)]
pub struct DeviceSamples<'a> {
    /// The component that they are in.
    pub kind: SampledComponentKind,
    /// Id of the device or plate.
    pub id: u32,
    /// Values of a sample.
    pub n_channels: usize,
    /// Samples.
    pub n_samples: usize,
    /// Number of the first sample; 0 in a component that has none.
    pub first: u32,
    values: &'a [u8],
}

impl DeviceSamples<'_> {
    /// Appends some of the samples one after another; of each, these channels in order.
    pub fn put_interleaved(
        &self,
        channels: Range<usize>,
        samples: Range<usize>,
        out: &mut Vec<f32>,
    ) {
        // A count of channels may be stated without samples, and the reverse.
        if self.values.is_empty() {
            return;
        }
        let values = self.values.as_chunks::<4>().0;
        let value = |at: usize| values.get(at).map_or(f32::NAN, |bytes| f32::from_le_bytes(*bytes));
        for sample in samples {
            for channel in channels.clone() {
                out.push(value(match self.kind.is_force() {
                    true => sample * self.n_channels + channel,
                    // One channel after another.
                    false => channel * self.n_samples + sample,
                }));
            }
        }
    }
}

/// Reads a component's content; `None` when its size and its counts differ, and some of it may have been passed on.
///
/// An analog device without samples has no sample number by the document, and 0 or any other by Qualisys's own C++ client: the
/// layout is the one that uses every byte.
pub(super) fn read<'a>(
    kind: SampledComponentKind,
    content: &'a [u8],
    on_device: &mut dyn FnMut(DeviceSamples<'a>),
) -> Option<()> {
    let numbers_all =
        kind != SampledComponentKind::Analog || read_as(kind, true, content, &mut |_| {}).is_some();
    read_as(kind, numbers_all, content, on_device)
}

fn read_as<'a>(
    kind: SampledComponentKind,
    numbers_all: bool,
    content: &'a [u8],
    on_device: &mut dyn FnMut(DeviceSamples<'a>),
) -> Option<()> {
    let mut content = Cursor::new(content);
    // Each device takes 8 bytes at least, so that a false count ends with the bytes.
    for _ in 0..content.get::<u32>()? {
        let id = content.get()?;
        let n_channels = if kind.is_force() { FORCE_VALUES as u32 } else { content.get()? };
        let n_samples = if kind.is_single() { 1 } else { content.get::<u32>()? };
        let has_first = !kind.is_single() && (numbers_all || n_samples > 0);
        let first = if has_first { content.get()? } else { 0 };
        let (n_channels, n_samples) = (n_channels as usize, n_samples as usize);
        let n_values = n_channels.checked_mul(n_samples)?;
        let values = content.bytes(n_values.checked_mul(4)?)?;
        on_device(DeviceSamples { kind, id, n_channels, n_samples, first, values });
    }
    content.end(())
}

/// What a server sends of a device, or of a plate.
#[derive(Debug, Clone, Copy)]
pub struct SamplesToSend<'a> {
    /// Id of the device or plate.
    pub id: u32,
    /// Values of a sample.
    pub n_channels: usize,
    /// Number of the first sample.
    pub first: u32,
    /// The samples one after another; of each, all channels in order.
    pub samples: &'a [f32],
}

/// Appends a component.
pub(super) fn put(kind: SampledComponentKind, devices: &[SamplesToSend<'_>], out: &mut Vec<u8>) {
    let start = out.len();
    0_u32.put(out);
    u32::from(kind as u8).put(out);
    (devices.len() as u32).put(out);
    for device in devices {
        let n_channels = device.n_channels.max(1);
        let n_samples = device.samples.len() / n_channels;
        device.id.put(out);
        if !kind.is_force() {
            (n_channels as u32).put(out);
        }
        if !kind.is_single() {
            (n_samples as u32).put(out);
            device.first.put(out);
        }
        if kind.is_force() {
            device.samples.iter().for_each(|value| value.put(out));
            continue;
        }
        for channel in 0..n_channels {
            let of_channel = device.samples.iter().skip(channel).step_by(n_channels);
            of_channel.for_each(|value| value.put(out));
        }
    }
    let size = (out.len() - start) as u32;
    if let Some(field) = out.get_mut(start..start + 4) {
        field.copy_from_slice(&size.to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The layouts of "Analog data" and "Force components" in the documents, written out by hand.
    #[test]
    fn components_have_the_documented_bytes() {
        let mut out = Vec::new();
        let device =
            SamplesToSend { id: 1, n_channels: 2, first: 9, samples: &[1.0, 2.0, 3.0, 4.0] };
        put(SampledComponentKind::Analog, &[device], &mut out);
        let header = [44, 0, 0, 0, 3, 0, 0, 0, 1, 0, 0, 0];
        assert_eq!(out[..12], header);
        assert_eq!(out[12..28], [1, 0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0, 9, 0, 0, 0]);
        // Channel 1, samples 9 and 10; channel 2.
        assert_eq!(out[28..], [1.0_f32, 3.0, 2.0, 4.0].map(f32::to_le_bytes).concat());
        let mut out = Vec::new();
        let samples: Vec<f32> = (0..18).map(|value| value as f32).collect();
        let plate = SamplesToSend { id: 2, n_channels: 9, first: 7, samples: &samples };
        put(SampledComponentKind::Force, &[plate], &mut out);
        assert_eq!(out[..12], [96, 0, 0, 0, 4, 0, 0, 0, 1, 0, 0, 0]);
        assert_eq!(out[12..24], [2, 0, 0, 0, 2, 0, 0, 0, 7, 0, 0, 0]);
        let values: Vec<u8> = samples.iter().flat_map(|value| value.to_le_bytes()).collect();
        assert_eq!(out[24..], values);
    }

    /// Both of Qualisys's own clients' layouts, of which a frame may have either.
    #[test]
    fn an_analog_device_without_samples_may_have_a_sample_number_or_none() {
        let device = |id: u32, n_samples: u32, first: Option<u32>, values: &[f32]| {
            let words = [id, 2, n_samples].into_iter().chain(first);
            let bytes = words.flat_map(u32::to_le_bytes);
            bytes.chain(values.iter().flat_map(|value| value.to_le_bytes())).collect::<Vec<u8>>()
        };
        for numbered in [true, false] {
            let number = numbered.then_some(77);
            let mut content = 3_u32.to_le_bytes().to_vec();
            content.extend(device(1, 0, number, &[]));
            content.extend(device(2, 1, Some(9), &[1.0, 2.0]));
            content.extend(device(3, 0, number, &[]));
            let mut found = Vec::new();
            let is_read = read(SampledComponentKind::Analog, &content, &mut |device| {
                let mut values = Vec::new();
                device.put_interleaved(0..2, 0..device.n_samples, &mut values);
                found.push((device.id, device.n_samples, values));
            });
            assert_eq!(is_read, Some(()), "{numbered}");
            assert_eq!(found, [(1, 0, vec![]), (2, 1, vec![1.0, 2.0]), (3, 0, vec![])]);
            for cut in 0..content.len() {
                let cut = &content[..cut];
                assert_eq!(read(SampledComponentKind::Analog, cut, &mut |_| {}), None);
            }
        }
    }

    #[test]
    fn components_read_back_and_lies_are_refused() {
        let samples: Vec<f32> = (0..36).map(|value| value as f32).collect();
        for kind in SampledComponentKind::ALL {
            let n_channels = if kind.is_force() { FORCE_VALUES } else { 3 };
            let n = if kind.is_single() { n_channels } else { 2 * n_channels };
            let device = |id| SamplesToSend { id, n_channels, first: 5, samples: &samples[..n] };
            let mut out = Vec::new();
            put(kind, &[device(1), device(8)], &mut out);
            let content = &out[8..];
            let mut found = Vec::new();
            let read_back = read(kind, content, &mut |device| {
                let mut values = Vec::new();
                device.put_interleaved(0..device.n_channels, 0..device.n_samples, &mut values);
                found.push((device.id, device.first, values));
            });
            assert_eq!(read_back, Some(()), "{kind:?}");
            let first = if kind.is_single() { 0 } else { 5 };
            let expected = [1, 8].map(|id| (id, first, samples[..n].to_vec()));
            assert_eq!(found, expected);
            for cut in 0..content.len() {
                assert_eq!(read(kind, &content[..cut], &mut |_| {}), None, "{kind:?} {cut}");
            }
            for at in (0..12).step_by(4) {
                let mut lie = content.to_vec();
                lie[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
                let is_id = at == 4;
                assert_eq!(
                    read(kind, &lie, &mut |_| {}).is_some(),
                    is_id || (at == 8 && kind == SampledComponentKind::ForceSingle),
                    "{kind:?} {at}"
                );
            }
        }
    }
}

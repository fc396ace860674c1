//! Groups of sampled channels: one for each analog device and force plate of QTM.

use super::{
    sampled::DeviceSamples,
    settings::{AnalogDevice, ForcePlate, ForceUnits},
};
use crate::{
    device::{DeviceEvent, SampleBatch, SampleForm, SampledChannelInfo, SampledGroupInfo},
    link::{
        GROUPS_MAX, SAMPLE_VALUES_MAX, SAMPLE_VALUES_PER_S_MAX, SAMPLED_CHANNELS_MAX,
        TEXT_BYTES_MAX, UNIT_BYTES_MAX,
    },
};

/// Channels of a device that are recorded together.
#[derive(Debug)]
struct SampledGroup {
    info: SampledGroupInfo,
    is_force: bool,
    device: u32,
    /// Values of a sample of the device, and the first of this group.
    device_channels: usize,
    first_channel: usize,
    /// Number of the next sample, in 64 bits: QTM's has 32.
    next: Option<u64>,
    /// Number of the next batch.
    batch: u32,
    /// A sample and its time in microseconds, which follows the times of frames slowly.
    anchor: Option<(u64, f64)>,
}

/// The groups of a QTM.
#[derive(Debug, Default)]
pub(super) struct SampledGroups {
    groups: Vec<SampledGroup>,
    /// Devices and plates that cannot be recorded.
    left_out: usize,
    values: Vec<f32>,
}

impl SampledGroups {
    /// Forgets all groups.
    pub(super) fn clear(&mut self) {
        self.groups.clear();
        self.left_out = 0;
    }

    /// Adds the analog devices. One with more channels than a group has becomes several groups.
    pub(super) fn add_analog(&mut self, devices: &[AnalogDevice]) {
        for device in devices {
            let channel = |(label, unit): &(String, String)| SampledChannelInfo {
                name: bounded(label, TEXT_BYTES_MAX),
                unit: bounded(unit, UNIT_BYTES_MAX),
                scale: 1.0,
                offset: 0.0,
            };
            let channels: Vec<_> = device.channels.iter().map(channel).collect();
            self.add(false, (device.id, device.rate_hz), &channels);
        }
    }

    /// Adds the force plates.
    pub(super) fn add_plates(&mut self, plates: &[ForcePlate], units: &ForceUnits) {
        let (force, length) = (units.force.as_str(), units.length.as_str());
        for plate in plates {
            let channel = |what: &str, axis: &str, unit: &str| SampledChannelInfo {
                name: format!("{what}{axis}{}", plate.id),
                unit: bounded(unit, UNIT_BYTES_MAX),
                scale: 1.0,
                offset: 0.0,
            };
            // The documents do not state the unit of moments.
            let channels: Vec<_> = [("F", force), ("M", ""), ("COP", length)]
                .into_iter()
                .flat_map(|(what, unit)| ["x", "y", "z"].map(|axis| channel(what, axis, unit)))
                .collect();
            self.add(true, (plate.id, plate.rate_hz), &channels);
        }
    }

    fn add(
        &mut self,
        is_force: bool,
        (device, rate_hz): (u32, f64),
        channels: &[SampledChannelInfo],
    ) {
        let device_channels = channels.len();
        let per_s = rate_hz * device_channels.min(SAMPLED_CHANNELS_MAX) as f64;
        let n_groups = device_channels.div_ceil(SAMPLED_CHANNELS_MAX);
        let is_known = |group: &SampledGroup| (group.is_force, group.device) == (is_force, device);
        let fits = rate_hz >= 1.0
            && per_s <= SAMPLE_VALUES_PER_S_MAX as f64
            && n_groups > 0
            && self.groups.len() + n_groups <= GROUPS_MAX
            && !self.groups.iter().any(is_known);
        if !fits {
            self.left_out += 1;
            return;
        }
        for (index, channels) in channels.chunks(SAMPLED_CHANNELS_MAX).enumerate() {
            let info = SampledGroupInfo {
                id: self.groups.len() as u8,
                form: SampleForm::Float32,
                rate_millihertz: (rate_hz * 1000.0).round() as u32,
                channels: channels.to_vec(),
            };
            let first_channel = index * SAMPLED_CHANNELS_MAX;
            self.groups.push(SampledGroup {
                info,
                is_force,
                device,
                device_channels,
                first_channel,
                next: None,
                batch: 0,
                anchor: None,
            });
        }
    }

    /// The description of each group.
    pub(super) fn infos(&self) -> impl Iterator<Item = &SampledGroupInfo> {
        self.groups.iter().map(|group| &group.info)
    }

    /// Whether an analog device, or a force plate, is recorded.
    pub(super) fn has(&self, is_force: bool) -> bool {
        self.groups.iter().any(|group| group.is_force == is_force)
    }

    /// Devices and plates that cannot be recorded.
    pub(super) fn left_out(&self) -> usize {
        self.left_out
    }

    /// Passes the samples of a device on that a frame of this time has. `is_lossy`: what is missing may be lost on the way.
    /// Returns whether they have the channels that the settings state.
    pub(super) fn samples(
        &mut self,
        device: &DeviceSamples<'_>,
        (time_us, is_lossy): (u64, bool),
        on_event: &mut dyn FnMut(DeviceEvent<'_>),
    ) -> bool {
        let mut fits = false;
        let key = (device.kind.is_force(), device.id);
        for group in self.groups.iter_mut().filter(|group| (group.is_force, group.device) == key) {
            if group.device_channels != device.n_channels {
                return false;
            }
            fits = true;
            group.pass(device, (time_us, is_lossy), &mut self.values, on_event);
        }
        fits
    }
}

impl SampledGroup {
    fn pass(
        &mut self,
        device: &DeviceSamples<'_>,
        (time_us, is_lossy): (u64, bool),
        values: &mut Vec<f32>,
        on_event: &mut dyn FnMut(DeviceEvent<'_>),
    ) {
        if device.n_samples == 0 {
            return;
        }
        let n_channels = self.info.channels.len();
        let (start, is_behind) = self.number(device.first, is_lossy);
        let period_us = 1e9 / f64::from(self.info.rate_millihertz);
        // As if the last sample were of the frame's time; boards are read in lumps of several frames.
        let stamp_us = time_us as f64 - (device.n_samples - 1) as f64 * period_us;
        let first_us = self.time_us(start, stamp_us, period_us, is_behind);
        let channels = self.first_channel..self.first_channel + n_channels;
        let per_batch = (SAMPLE_VALUES_MAX / n_channels.max(1)).max(1);
        for at in (0..device.n_samples).step_by(per_batch) {
            let samples = at..(at + per_batch).min(device.n_samples);
            let n_samples = samples.len() as u64;
            values.clear();
            device.put_interleaved(channels.clone(), samples, values);
            on_event(DeviceEvent::Samples(SampleBatch {
                group: self.info.id,
                number: self.batch,
                first: start + at as u64,
                device_ticks: (first_us + at as f64 * period_us).round().max(0.0) as u64,
                form: self.info.form,
                n_channels: n_channels as u8,
                samples: values,
            }));
            if !is_behind {
                self.batch = self.batch.wrapping_add(1);
                self.next = Some(start + at as u64 + n_samples);
            }
        }
    }

    /// The time of a sample by the numbers since the anchor, which moves towards the stamps of frames.
    fn time_us(&mut self, number: u64, stamp_us: f64, period_us: f64, is_behind: bool) -> f64 {
        let expected = self
            .anchor
            .map(|(of, us)| us + number.wrapping_sub(of).cast_signed() as f64 * period_us);
        let near = expected.filter(|expected| (stamp_us - expected).abs() < ANCHOR_MAX_US);
        let time_us =
            near.map_or(stamp_us, |expected| expected + ANCHOR_GAIN * (stamp_us - expected));
        if !is_behind {
            self.anchor = Some((number, time_us));
        }
        time_us
    }

    /// The number of a batch's first sample in 64 bits, and whether an earlier batch had it. Numbers that were skipped on a
    /// lossless way were skipped by QTM.
    fn number(&mut self, first: u32, is_lossy: bool) -> (u64, bool) {
        let Some(next) = self.next else { return (u64::from(first), false) };
        let ahead = i64::from(first.wrapping_sub(next as u32).cast_signed());
        if ahead > 0 && is_lossy {
            self.batch = self.batch.wrapping_add(1);
        }
        let start = next.checked_add_signed(ahead).unwrap_or(u64::from(first));
        // A count that began again is no batch that came late, which only datagrams do.
        let late_max = (LATE_S_MAX * f64::from(self.info.rate_millihertz) / 1000.0) as i64;
        let is_behind = is_lossy && (-late_max..0).contains(&ahead);
        let start = if ahead < 0 && !is_behind { u64::from(first) } else { start };
        (start, is_behind)
    }
}

/// Time by which a repeated or late datagram may be behind, in seconds: as for the recorder's count of samples.
const LATE_S_MAX: f64 = 0.7;

/// Part of a stamp's deviation that the anchor takes over: it follows a clock that drifts, and hardly a lump.
const ANCHOR_GAIN: f64 = 1.0 / 64.0;

/// Deviation beyond which QTM's clock jumped or samples are missing, in microseconds.
const ANCHOR_MAX_US: f64 = 250_000.0;

/// A text of at most so many bytes.
pub(super) fn bounded(text: &str, bytes_max: usize) -> String {
    let mut end = text.len().min(bytes_max);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    text.get(..end).unwrap_or_default().to_owned()
}

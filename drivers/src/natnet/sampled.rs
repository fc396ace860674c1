//! Force plates and other devices as groups of sampled channels: as many samples of each channel in every frame.

use super::{
    frame::{FrameOfData, SampledData},
    model::SampledDescription,
};
use crate::{
    device::{DeviceEvent, SampleBatch, SampleForm, SampledChannelInfo, SampledGroupInfo},
    link::{GROUPS_MAX, SAMPLE_VALUES_PER_S_MAX, SAMPLED_CHANNELS_MAX},
};

/// Most samples of a channel in one frame: Motive's analog devices have some tens at most.
pub(super) const SAMPLES_PER_FRAME_MAX: u32 = 1000;

/// A force plate or device.
#[derive(Debug)]
struct DeviceGroup {
    is_plate: bool,
    /// Its number in frames.
    wire_id: u32,
    name: String,
    info: SampledGroupInfo,
    samples_per_frame: u32,
    /// Samples of the last frame, if these were others; and whether that was noted.
    other: Option<u32>,
    is_noted: bool,
}

/// All of them.
#[derive(Debug, Default)]
pub(super) struct DeviceGroups {
    groups: Vec<DeviceGroup>,
    /// Devices that were left out: too many, too many channels, or too many samples.
    n_left_out: usize,
    /// Devices of which neither a frame nor the server tells how many samples a frame has.
    n_guessed: usize,
    /// Devices whose first frame is unlike what the server states: what that is, and what is recorded.
    contradictions: Vec<String>,
    /// Frames of a device that had another number of channels or samples, or was not announced.
    pub(super) n_misfits: u64,
    /// What frames showed first during the stream, for the take: one line for each device at most.
    pub(super) notes: Vec<String>,
    values: Vec<f32>,
}

/// The unit of a channel's values.
fn unit(description: &SampledDescription) -> &'static str {
    if description.data_type == 1 { "V" } else { "" }
}

impl DeviceGroups {
    /// The described devices, with as many samples in a frame as the server states, and those of a frame that are not described.
    pub(super) fn new(
        described: &[SampledDescription],
        samples_per_frame: Option<u32>,
        frame: Option<&FrameOfData<'_>>,
        rate_millihertz: u32,
    ) -> Self {
        let mut groups = Self::default();
        let seen = || frame.into_iter().flat_map(FrameOfData::sampled);
        for description in described {
            let of = |data: &SampledData<'_>| {
                (data.is_plate, data.id) == (description.is_plate, description.id)
            };
            let data = seen().find(of);
            let seen = data.and_then(samples_of);
            let known = seen.or(samples_per_frame);
            groups.n_guessed += usize::from(known.is_none() && !description.channels.is_empty());
            let n_samples = known.unwrap_or(1);
            groups.compare(description, data, samples_per_frame);
            let as_sent = data.and_then(|data| as_sent(description, &data));
            groups.add(as_sent.as_ref().unwrap_or(description), n_samples, rate_millihertz);
        }
        for data in seen() {
            let is_new =
                |group: &DeviceGroup| (group.is_plate, group.wire_id) != (data.is_plate, data.id);
            if groups.groups.iter().all(is_new)
                && let Some(n_samples) = samples_of(data)
            {
                groups.add(&unnamed(&data), n_samples, rate_millihertz);
            }
        }
        groups
    }

    /// Notes where the first frame contradicts what the server states.
    fn compare(
        &mut self,
        description: &SampledDescription,
        data: Option<SampledData<'_>>,
        stated: Option<u32>,
    ) {
        let Some(data) = data.filter(|_| self.contradictions.len() < GROUPS_MAX) else { return };
        let SampledDescription { name, channels, .. } = description;
        let (described, sent) = (channels.len(), data.n_channels as usize);
        if described != sent {
            self.contradictions.push(format!(
                "'{name}' has {described} channels by its description and {sent} in frames, which are recorded"
            ));
        }
        if let (Some(sent), Some(stated)) = (samples_of(data), stated)
            && sent < stated
            && !stated.is_multiple_of(sent)
        {
            // A divisor is another rate than that of the first device. Anything else is a device that has just started.
            self.contradictions.push(format!(
                "'{name}' has {sent} samples in a frame, not the {stated} that the server states: frames with another number \
                 are left out"
            ));
        }
    }

    fn add(&mut self, description: &SampledDescription, samples_per_frame: u32, rate: u32) {
        let n_channels = description.channels.len();
        let rate_millihertz = rate.saturating_mul(samples_per_frame);
        let fits = (1..=SAMPLED_CHANNELS_MAX).contains(&n_channels)
            && has_room_for(n_channels, rate_millihertz);
        if !fits || self.groups.len() >= GROUPS_MAX {
            self.n_left_out += usize::from(n_channels > 0);
            return;
        }
        let SampledDescription { is_plate, id: wire_id, name, .. } = description;
        let channels = description.channels.iter().map(|channel| SampledChannelInfo {
            name: if name.is_empty() { channel.clone() } else { format!("{name}:{channel}") },
            unit: unit(description).to_owned(),
            scale: 1.0,
            offset: 0.0,
        });
        let info = SampledGroupInfo {
            id: self.groups.len() as u8,
            form: SampleForm::Float32,
            rate_millihertz,
            channels: channels.collect(),
        };
        let (is_plate, wire_id) = (*is_plate, *wire_id);
        self.groups.push(DeviceGroup {
            is_plate,
            wire_id,
            name: if name.is_empty() { unnamed_as(is_plate, wire_id) } else { name.clone() },
            info,
            samples_per_frame,
            other: None,
            is_noted: false,
        });
    }

    /// The groups.
    pub(super) fn infos(&self) -> impl Iterator<Item = &SampledGroupInfo> {
        self.groups.iter().map(|group| &group.info)
    }

    /// What is left out or unlike what the server states, for the take.
    pub(super) fn remarks(&self) -> Vec<String> {
        let left_out = (self.n_left_out > 0).then(|| {
            format!(
                "{} force plates or devices are left out: at most {GROUPS_MAX} of at most {SAMPLED_CHANNELS_MAX} channels \
                 and {SAMPLE_VALUES_PER_S_MAX} values a second are recorded",
                self.n_left_out
            )
        });
        let guessed = (self.n_guessed > 0).then(|| {
            format!(
                "no frame came that shows how many samples {} force plates or devices have in a frame: 1 is assumed; if \
                 they have more, start again while Motive is live",
                self.n_guessed
            )
        });
        self.contradictions.iter().cloned().chain(left_out).chain(guessed).collect()
    }

    /// Passes on the samples of a frame, which is the `index`th of the device and was exposed at `device_ticks`.
    ///
    /// A device that has another number of samples in two frames is announced anew with it: the recorder cannot record that
    /// any more, but counts its samples as lost.
    pub(super) fn pass_on(
        &mut self,
        frame: &FrameOfData<'_>,
        index: u64,
        device_ticks: u64,
        on_event: &mut dyn FnMut(DeviceEvent<'_>),
    ) {
        for data in frame.sampled() {
            let is_its = |group: &&mut DeviceGroup| {
                (group.is_plate, group.wire_id) == (data.is_plate, data.id)
            };
            let Some(group) = self.groups.iter_mut().find(is_its) else {
                self.n_misfits += u64::from(data.n_channels > 0);
                continue;
            };
            if fits(group, &data) {
                group.other = None;
            } else {
                self.n_misfits += u64::from(data.n_channels > 0);
                let Some(n_samples) = group.repeated_misfit(&data) else { continue };
                if !std::mem::replace(&mut group.is_noted, true) {
                    self.notes.push(group.misfit_note(&data));
                }
                if !group.take_over(&data, n_samples) {
                    continue;
                }
                on_event(DeviceEvent::SampledGroup(&group.info));
            }
            self.values.clear();
            for sample in 0..group.samples_per_frame as usize {
                self.values.extend(data.channels().filter_map(|channel| channel.get(sample)));
            }
            on_event(DeviceEvent::Samples(SampleBatch {
                group: group.info.id,
                number: index as u32,
                first: index.wrapping_mul(group.samples_per_frame.into()),
                device_ticks,
                form: SampleForm::Float32,
                n_channels: group.info.channels.len() as u8,
                samples: &self.values,
            }));
        }
    }
}

impl DeviceGroup {
    /// The samples of a frame that has as many of them as the one before it, and more or fewer than announced, or other
    /// channels. A device that has just started has one such frame.
    fn repeated_misfit(&mut self, data: &SampledData<'_>) -> Option<u32> {
        let now = samples_of(*data);
        let before = std::mem::replace(&mut self.other, now);
        now.filter(|_| now == before)
    }

    fn misfit_note(&self, data: &SampledData<'_>) -> String {
        let (name, announced) = (&self.name, self.info.channels.len());
        let (n, samples) = (self.samples_per_frame, self.other.unwrap_or_default());
        let sent = data.n_channels;
        format!(
            "'{name}' has {samples} samples of {sent} channels in a frame, not {n} of {announced} as announced: they are not \
             recorded; start again while frames come to record them"
        )
    }

    /// Has so many samples in a frame from now on. Returns `false` if they have other channels, or are too many.
    fn take_over(&mut self, data: &SampledData<'_>, n_samples: u32) -> bool {
        let n_channels = self.info.channels.len();
        let frame_millihertz = self.info.rate_millihertz / self.samples_per_frame.max(1);
        let rate_millihertz = frame_millihertz.saturating_mul(n_samples);
        if data.n_channels as usize != n_channels || !has_room_for(n_channels, rate_millihertz) {
            return false;
        }
        self.samples_per_frame = n_samples;
        self.info.rate_millihertz = rate_millihertz;
        self.other = None;
        true
    }
}

/// Whether the memory for samples is enough for so many.
fn has_room_for(n_channels: usize, rate_millihertz: u32) -> bool {
    n_channels as u64 * u64::from(rate_millihertz) <= 1000 * SAMPLE_VALUES_PER_S_MAX
}

fn fits(group: &DeviceGroup, data: &SampledData<'_>) -> bool {
    data.n_channels as usize == group.info.channels.len()
        && data.channels().all(|channel| channel.count() == group.samples_per_frame as usize)
}

/// Samples of its channels, if they all have as many.
fn samples_of(data: SampledData<'_>) -> Option<u32> {
    let n_samples = data.channels().next()?.count();
    let n_samples = data.channels().all(|c| c.count() == n_samples).then_some(n_samples)?;
    u32::try_from(n_samples).ok().filter(|n| (1..=SAMPLES_PER_FRAME_MAX).contains(n))
}

/// A description with as many channels as frames have, by their names as far as these go.
fn as_sent(description: &SampledDescription, data: &SampledData<'_>) -> Option<SampledDescription> {
    let n_channels = data.channels().count();
    if n_channels == description.channels.len() || n_channels == 0 {
        return None;
    }
    let mut channels = description.channels.clone();
    channels.truncate(n_channels);
    channels.extend((channels.len() + 1..=n_channels).map(|n| format!("channel {n}")));
    Some(SampledDescription { channels, ..description.clone() })
}

/// The description of a device that the server does not describe.
fn unnamed(data: &SampledData<'_>) -> SampledDescription {
    let SampledData { is_plate, id, .. } = *data;
    let name = unnamed_as(is_plate, id);
    let channels = (1..=data.channels().count()).map(|n| format!("channel {n}")).collect();
    SampledDescription { is_plate, id, name, data_type: 0, channels }
}

fn unnamed_as(is_plate: bool, id: u32) -> String {
    format!("{} {id}", if is_plate { "plate" } else { "device" })
}

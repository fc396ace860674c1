//! Encoding and decoding of all payloads except frames, in both directions: of the device and its markers, sampled channels,
//! force plates and rigid bodies.

/// Type bytes of the messages.
pub(super) mod kind {
    pub(in crate::link) const HELLO: u8 = 0x01;
    pub(in crate::link) const MARKERS: u8 = 0x02;
    pub(in crate::link) const SAMPLED_GROUP: u8 = 0x03;
    pub(in crate::link) const BODIES: u8 = 0x04;
    pub(in crate::link) const FORCE_PLATE: u8 = 0x05;
    pub(in crate::link) const FRAME_FLOAT: u8 = 0x10;
    pub(in crate::link) const FRAME_MICROMETRES: u8 = 0x11;
    pub(in crate::link) const FRAME_COMPACT: u8 = 0x12;
    pub(in crate::link) const SAMPLES: u8 = 0x13;
    pub(in crate::link) const POSES: u8 = 0x14;
    pub(in crate::link) const TRIGGER: u8 = 0x20;
    pub(in crate::link) const STATUS: u8 = 0x21;
    pub(in crate::link) const END_OF_STREAM: u8 = 0x22;
    pub(in crate::link) const PONG: u8 = 0x30;
    pub(in crate::link) const STARTED: u8 = 0x31;
    pub(in crate::link) const REFUSED: u8 = 0x32;
    pub(in crate::link) const RATE_SET: u8 = 0x33;

    pub(in crate::link) const IDENTIFY: u8 = 0x80;
    pub(in crate::link) const START: u8 = 0x81;
    pub(in crate::link) const STOP: u8 = 0x82;
    pub(in crate::link) const SET_RATE: u8 = 0x83;
    pub(in crate::link) const PING: u8 = 0x84;
}

use super::{
    ENVELOPE_BYTES, EncodeError, Framer, GROUPS_MAX, LABEL_BYTES_MAX, MARKERS_MAX, PLATES_MAX,
    POSE_BYTES_MAX, POSES_HEADER_BYTES, SAMPLE_VALUES_MAX, SAMPLE_VALUES_PER_S_MAX,
    SAMPLED_CHANNELS_MAX, SAMPLES_HEADER_BYTES, TEXT_BYTES_MAX, UNIT_BYTES_MAX, wire_bytes,
};
use crate::{
    bytes::{Cursor, WireValue, wire_struct},
    device::{
        BODIES_MAX, BodyInfo, Command, DeviceEvent, EndOfPoses, ForcePlateInfo, Hello, LinkBudget,
        MarkerInfo, PlateOutput, Pong, Pose, PoseFrame, PoseStatus, SampleBatch, SampleForm,
        SampledChannelInfo, SampledGroupInfo, Status, Trigger,
    },
};

const LABELLED: u8 = 1;

wire_struct!(Status { frames_produced, frames_dropped, temperature_c_100 });
wire_struct!(Trigger { device_ticks, input, kind });
wire_struct!(Pong { host_ns, device_ticks });
wire_struct!(LinkBudget { needed_bytes_per_s, available_bytes_per_s, rate_fits_millihertz });

/// The reason why a Hello is invalid; sender and receiver apply the same rule.
fn hello_error(hello: &Hello) -> Option<&'static str> {
    let rates_millihertz = hello.rate_min_millihertz..=hello.rate_max_millihertz;
    if hello.tick_hz == 0 {
        Some("tick_hz is 0: give the ticks per second of the device clock")
    } else if hello.rate_millihertz == 0 {
        Some("rate_millihertz is 0: give the frame rate of the next Start")
    } else if !rates_millihertz.contains(&hello.rate_millihertz) {
        Some("rate_millihertz is not within rate_min_millihertz..=rate_max_millihertz")
    } else if hello.up_axis > 3 {
        Some("up_axis is not one of 0 (unknown), 1 (x), 2 (y), 3 (z)")
    } else if usize::from(hello.markers_max) > MARKERS_MAX {
        Some("markers_max exceeds the link's limit of 10000")
    } else {
        None
    }
}

pub(super) fn put_text(
    field: &'static str,
    text: &str,
    bytes_max: usize,
    out: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    match u8::try_from(text.len()) {
        Ok(n) if text.len() <= bytes_max && !text.contains(char::is_control) => {
            out.push(n);
            out.extend_from_slice(text.as_bytes());
            Ok(())
        }
        _ => Err(EncodeError::Text { field, text: text.to_owned(), bytes_max }),
    }
}

pub(super) fn put_hello(hello: &Hello, out: &mut Vec<u8>) -> Result<(), EncodeError> {
    if let Some(error) = hello_error(hello) {
        return Err(EncodeError::Hello(error));
    }
    hello.rate_millihertz.put(out);
    hello.rate_min_millihertz.put(out);
    hello.rate_max_millihertz.put(out);
    hello.tick_hz.put(out);
    hello.up_axis.put(out);
    hello.markers_max.put(out);
    hello.n_frames.put(out);
    put_text("model", &hello.model, TEXT_BYTES_MAX, out)?;
    put_text("serial", &hello.serial, TEXT_BYTES_MAX, out)?;
    put_text("firmware", &hello.firmware, TEXT_BYTES_MAX, out)
}

/// Decodes a Hello into `hello`, reusing its memory. After `None` its contents are unspecified.
pub(super) fn get_hello(payload: &[u8], hello: &mut Hello) -> Option<()> {
    let mut cursor = Cursor::new(payload);
    hello.rate_millihertz = cursor.get()?;
    hello.rate_min_millihertz = cursor.get()?;
    hello.rate_max_millihertz = cursor.get()?;
    hello.tick_hz = cursor.get()?;
    hello.up_axis = cursor.get()?;
    hello.markers_max = cursor.get()?;
    hello.n_frames = cursor.get()?;
    for text in [&mut hello.model, &mut hello.serial, &mut hello.firmware] {
        cursor.text(TEXT_BYTES_MAX)?.clone_into(text);
    }
    cursor.end(()).filter(|()| hello_error(hello).is_none())
}

/// Bytes of a marker in a Markers message.
pub(super) fn marker_info_bytes(marker: &MarkerInfo) -> usize {
    2 + 1 + 1 + marker.label.len()
}

pub(super) fn put_marker_info(marker: &MarkerInfo, out: &mut Vec<u8>) -> Result<(), EncodeError> {
    marker.id.put(out);
    out.push(if marker.labelled { LABELLED } else { 0 });
    put_text("label", &marker.label, LABEL_BYTES_MAX, out)
}

/// Decodes a Markers message over the first entries of `markers`, reusing their memory, and returns them.
/// Later entries are stale; they only keep the memory of their labels.
pub(super) fn get_markers<'a>(
    payload: &[u8],
    markers: &'a mut Vec<MarkerInfo>,
) -> Option<&'a [MarkerInfo]> {
    let mut cursor = Cursor::new(payload);
    let n = usize::from(cursor.get::<u16>()?);
    if n > MARKERS_MAX {
        return None;
    }
    for index in 0..n {
        let (id, flags) = (cursor.get()?, cursor.get::<u8>()?);
        let label = cursor.text(LABEL_BYTES_MAX)?;
        if flags & !LABELLED != 0 {
            return None;
        }
        let labelled = flags & LABELLED != 0;
        if let Some(marker) = markers.get_mut(index) {
            (marker.id, marker.labelled) = (id, labelled);
            label.clone_into(&mut marker.label);
        } else {
            markers.push(MarkerInfo { id, label: label.to_owned(), labelled });
        }
    }
    cursor.end(markers.get(..n)?)
}

/// Decodes a command: `None` for an unknown type, `Some(None)` for an invalid payload.
pub(super) fn get_command(kind: u8, payload: &[u8]) -> Option<Option<Command>> {
    Some(match kind {
        kind::IDENTIFY => WireValue::decode(payload).map(|()| Command::Identify),
        kind::START => WireValue::decode(payload).map(|n| Command::Start { line_bytes_per_s: n }),
        kind::STOP => WireValue::decode(payload).map(|()| Command::Stop),
        kind::SET_RATE => WireValue::decode(payload).map(Command::SetRate),
        kind::PING => WireValue::decode(payload).map(|host_ns| Command::Ping { host_ns }),
        _ => return None,
    })
}

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

/// The reason why a plate is invalid; sender and receiver apply the same rule.
fn plate_error(plate: &ForcePlateInfo) -> Option<&'static str> {
    let mut numbers = plate.corners_mm.iter().flatten().chain(&plate.origin_mm);
    if !(1..=PLATES_MAX).contains(&usize::from(plate.number)) {
        Some("its number is not within 1 to 32")
    } else if usize::from(plate.group) >= GROUPS_MAX {
        Some("the number of its group is not below 16")
    } else if plate.channels.len() != plate.output.n_channels() {
        Some("it has another number of channels than its output")
    } else if plate.channels.iter().any(|&index| usize::from(index) >= SAMPLED_CHANNELS_MAX) {
        Some("the index of a channel is not below 64")
    } else if !numbers.all(|number| number.is_finite()) {
        Some("a corner or the origin is not finite")
    } else {
        None
    }
}

pub(super) fn put_plate(plate: &ForcePlateInfo, out: &mut Vec<u8>) -> Result<(), EncodeError> {
    if let Some(error) = plate_error(plate) {
        return Err(EncodeError::ForcePlate(error));
    }
    out.extend([plate.number, plate.output.code(), plate.group]);
    out.extend_from_slice(&plate.channels);
    for number in plate.corners_mm.iter().flatten().chain(&plate.origin_mm) {
        number.put(out);
    }
    Ok(())
}

/// Decodes a plate into `plate`, reusing its memory. After `None` its contents are unspecified.
pub(super) fn get_plate(payload: &[u8], plate: &mut ForcePlateInfo) -> Option<()> {
    let mut cursor = Cursor::new(payload);
    plate.number = cursor.get()?;
    let code: u8 = cursor.get()?;
    plate.output = PlateOutput::ALL.into_iter().find(|output| output.code() == code)?;
    plate.group = cursor.get()?;
    let channels = cursor.bytes(plate.output.n_channels())?;
    plate.channels.clear();
    plate.channels.extend_from_slice(channels);
    for number in plate.corners_mm.iter_mut().flatten().chain(&mut plate.origin_mm) {
        *number = cursor.get()?;
    }
    cursor.end(()).filter(|()| plate_error(plate).is_none())
}

/// Bytes on the wire of the poses of a frame, at most.
#[must_use]
pub const fn pose_frame_bytes_max(n_bodies: usize) -> usize {
    wire_bytes(ENVELOPE_BYTES + POSES_HEADER_BYTES + n_bodies * POSE_BYTES_MAX)
}

/// The reason why bodies with these ids cannot be sent; sender and receiver apply the same rule.
fn ids_error(ids: impl Iterator<Item = u16> + Clone) -> Option<&'static str> {
    if ids.clone().count() > BODIES_MAX {
        Some("there are more than 128 bodies")
    } else if !ids.is_sorted_by(|a, b| a < b) {
        Some("their ids do not ascend: sort them, without duplicates")
    } else {
        None
    }
}

pub(super) fn put_bodies(bodies: &[BodyInfo], out: &mut Vec<u8>) -> Result<(), EncodeError> {
    if let Some(error) = ids_error(bodies.iter().map(|body| body.id)) {
        return Err(EncodeError::Bodies(error));
    }
    (bodies.len() as u16).put(out);
    for body in bodies {
        body.id.put(out);
        put_text("body name", &body.name, LABEL_BYTES_MAX, out)?;
    }
    Ok(())
}

/// Decodes a table of bodies into `bodies`, reusing their memory. After `None` its contents are unspecified.
pub(super) fn get_bodies(payload: &[u8], bodies: &mut Vec<BodyInfo>) -> Option<()> {
    let mut cursor = Cursor::new(payload);
    let n = usize::from(cursor.get::<u16>()?);
    if n > BODIES_MAX {
        return None;
    }
    bodies.resize_with(n, BodyInfo::default);
    for body in bodies.iter_mut() {
        body.id = cursor.get()?;
        cursor.text(LABEL_BYTES_MAX)?.clone_into(&mut body.name);
    }
    cursor.end(()).filter(|()| ids_error(bodies.iter().map(|body| body.id)).is_none())
}

pub(super) fn put_poses(
    framer: &mut Framer,
    frame: &PoseFrame<'_>,
    out: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    if let Some(error) = ids_error(frame.poses.iter().map(|pose| pose.body)) {
        return Err(EncodeError::Poses(error));
    }
    let is_status = |status: PoseStatus| PoseStatus::from_code(status.code()) == Some(status);
    if !frame.poses.iter().all(|pose| is_status(pose.status)) {
        return Err(EncodeError::Poses("another status is not within 3 to 127"));
    }
    let message = framer.open(kind::POSES);
    frame.seq.put(message);
    frame.number.put(message);
    frame.device_ticks.put(message);
    (frame.poses.len() as u16).put(message);
    for pose in frame.poses {
        pose.body.put(message);
        pose.status.code().put(message);
        if pose.status == PoseStatus::Tracked {
            pose.position_mm.put(message);
            pose.quaternion.into_iter().for_each(|value| value.put(message));
            pose.residual_mm.put(message);
        }
    }
    framer.close(out);
    Ok(())
}

/// In place of the number of poses: there are no more.
const END: u16 = u16::MAX;

pub(super) fn put_end(framer: &mut Framer, end: EndOfPoses, out: &mut Vec<u8>) {
    let message = framer.open(kind::POSES);
    end.seq.put(message);
    end.number.put(message);
    end.device_ticks.put(message);
    END.put(message);
    framer.close(out);
}

/// Decodes the poses of a frame, which are in `poses`, or their end.
pub(super) fn get_poses<'a>(payload: &[u8], poses: &'a mut Vec<Pose>) -> Option<DeviceEvent<'a>> {
    let mut cursor = Cursor::new(payload);
    let (seq, number, device_ticks) = (cursor.get()?, cursor.get()?, cursor.get()?);
    let n = cursor.get::<u16>()?;
    if n == END {
        return cursor.end(DeviceEvent::EndOfPoses(EndOfPoses { seq, number, device_ticks }));
    }
    if usize::from(n) > BODIES_MAX {
        return None;
    }
    poses.clear();
    for _ in 0..n {
        let body = cursor.get()?;
        let status = PoseStatus::from_code(cursor.get()?)?;
        let mut pose = Pose::without(body, status);
        if status == PoseStatus::Tracked {
            pose.position_mm = cursor.get()?;
            for value in &mut pose.quaternion {
                *value = cursor.get()?;
            }
            pose.residual_mm = cursor.get()?;
        }
        poses.push(pose);
    }
    cursor.end(())?;
    let is_valid = ids_error(poses.iter().map(|pose| pose.body)).is_none();
    is_valid.then_some(DeviceEvent::Poses(PoseFrame { seq, number, device_ticks, poses }))
}

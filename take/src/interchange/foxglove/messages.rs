//! Points, transforms, samples and log entries.

use super::protobuf::Message;
use crate::interchange::text::unique_names;
use crate::motion::{Position, UpAxis, is_gap};

/// The frame of reference of the positions, and its parent, whose z points up.
pub(super) const FRAME: &str = "mocap";
const ROOT: &str = "world";

/// Foxglove's schemas have metres.
const MM_PER_METRE: f64 = 1000.0;

/// Bytes of a point: x, y and z as float32, the column as uint16, two bytes of padding.
const STRIDE: usize = 16;

/// Values of `PackedElementField.NumericType`.
const UINT16: u64 = 3;
const FLOAT32: u64 = 7;

/// The level of a log entry: `foxglove.Log.Level`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogLevel {
    /// What happens as intended.
    Info,
    /// What a person should look at.
    Warning,
    /// What has failed.
    Error,
}

/// `google.protobuf.Timestamp`.
pub(super) fn timestamp(time_ns: u64) -> Message {
    Message::default().int(1, time_ns / 1_000_000_000).int(2, time_ns % 1_000_000_000)
}

/// The start of a message with a time and a frame of reference in its first two fields.
pub(super) fn stamped(time_ns: u64, frame: &str) -> Message {
    Message::default().message(1, &timestamp(time_ns)).text(2, frame)
}

/// A message of doubles in fields 1, 2, 3...: a vector, a quaternion or a colour.
pub(super) fn doubles<const N: usize>(values: [f64; N]) -> Message {
    (1..).zip(values).fold(Message::default(), |out, (field, value)| out.double(field, value))
}

/// A pose of this orientation.
pub(super) fn pose(at_m: [f64; 3], xyzw: [f64; 4]) -> Message {
    Message::default().message(1, &doubles(at_m)).message(2, &doubles(xyzw))
}

pub(super) const UPRIGHT: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

pub(super) fn metres(position: Position) -> [f64; 3] {
    position.map(|mm| f64::from(mm) / MM_PER_METRE)
}

pub(super) fn metres_f64(position_mm: [f64; 3]) -> [f64; 3] {
    position_mm.map(|mm| mm / MM_PER_METRE)
}

/// Numbers of the fields of a sample's values, after that of its time. Protocol Buffers reserve 19000 to 19999.
pub(super) fn value_fields() -> impl Iterator<Item = u32> {
    (2..19_000).chain(20_000..)
}

/// A sample of all channels of a table, for the schema of [`sampled_descriptor`](super::sampled_descriptor).
#[must_use]
pub fn sampled(row: &[f32], time_ns: u64) -> Message {
    let message = Message::default().message(1, &timestamp(time_ns));
    value_fields().zip(row).fold(message, |message, (field, value)| message.float(field, *value))
}

/// The `foxglove.PointCloud` of the visible markers.
#[must_use]
pub fn cloud(row: &[Position], time_ns: u64) -> Message {
    let mut data = Vec::with_capacity(row.len() * STRIDE);
    for (column, position) in row.iter().enumerate().filter(|(_, position)| !is_gap(**position)) {
        for axis in metres(*position) {
            data.extend((axis as f32).to_le_bytes());
        }
        data.extend((column as u16).to_le_bytes());
        data.extend([0; 2]);
    }
    let header = stamped(time_ns, FRAME).message(3, &pose([0.0; 3], UPRIGHT));
    let header = header.fixed32(4, STRIDE as u32);
    [("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32), ("marker", 12, UINT16)]
        .map(|(name, offset, kind)| {
            Message::default().text(1, name).fixed32(2, offset).int(3, kind)
        })
        .iter()
        .fold(header, |cloud, field| cloud.message(5, field))
        .bytes(6, &data)
}

/// The `foxglove.FrameTransform` that rotates the take's up axis to z.
#[must_use]
pub fn up_transform(up: UpAxis, time_ns: u64) -> Message {
    const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;
    let rotation = match up {
        UpAxis::Z | UpAxis::Unknown => UPRIGHT,
        // 90° about x takes y to z; -90° about y takes x to z.
        UpAxis::Y => [HALF, 0.0, 0.0, HALF],
        UpAxis::X => [0.0, -HALF, 0.0, HALF],
    };
    transform(time_ns, [ROOT, FRAME], [0.0; 3], rotation)
}

fn transform(
    time_ns: u64,
    [parent, child]: [&str; 2],
    translation_m: [f64; 3],
    xyzw: [f64; 4],
) -> Message {
    let transform = stamped(time_ns, parent).text(3, child);
    transform.message(4, &doubles(translation_m)).message(5, &doubles(xyzw))
}

/// A rigid body in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacedBody<'a> {
    /// Its name, which is that of its frame of reference.
    pub name: &'a str,
    /// The position of its origin in millimetres.
    pub position_mm: [f32; 3],
    /// The rotation from its axes: w, x, y, z.
    pub quaternion: [f32; 4],
}

/// The `foxglove.FrameTransforms` of a frame: that of [`up_transform`] if an axis is given, and one for each rigid body, whose
/// rotation gets a length of 1.
#[must_use]
pub fn transforms(up: Option<UpAxis>, bodies: &[PlacedBody<'_>], time_ns: u64) -> Message {
    let up = up.map(|up| up_transform(up, time_ns));
    let all = up.iter().fold(Message::default(), |all, up| all.message(1, up));
    bodies.iter().fold(all, |all, body| {
        let [w, x, y, z] = body.quaternion.map(f64::from);
        let length = (w * w + x * x + y * y + z * z).sqrt();
        let [w, x, y, z] = [w, x, y, z].map(|number| number / length);
        let at_m = metres(body.position_mm);
        all.message(1, &transform(time_ns, [FRAME, body.name], at_m, [x, y, z, w]))
    })
}

/// The names of the bodies' frames of reference: none is that of the positions or of the world.
#[must_use]
pub fn child_frames(names: Vec<String>) -> Vec<String> {
    let all = [FRAME, ROOT].map(str::to_owned).into_iter().chain(names);
    unique_names(all).into_iter().skip(2).collect()
}

/// A `foxglove.Log` entry.
#[must_use]
pub fn log(level: LogLevel, name: &str, text: &str, time_ns: u64) -> Message {
    let level = match level {
        LogLevel::Info => 2,
        LogLevel::Warning => 3,
        LogLevel::Error => 4,
    };
    Message::default().message(1, &timestamp(time_ns)).int(2, level).text(3, text).text(4, name)
}

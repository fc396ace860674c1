//! Foxglove messages in a minimal Protocol Buffers encoder (protobuf.dev, "Encoding").

use crate::{
    interchange::text::unique_names,
    motion::{Position, UpAxis, is_gap},
    poses::Pose,
    varint,
};

/// The frame of reference of the positions, and its parent, whose z points up.
const FRAME: &str = "mocap";
const ROOT: &str = "world";

/// Foxglove's schemas have metres.
const MM_PER_METRE: f64 = 1000.0;

/// Bytes of a point: x, y and z as float32, the column as uint16, two bytes of padding.
const STRIDE: usize = 16;

/// Values of `PackedElementField.NumericType`.
const UINT16: u64 = 3;
const FLOAT32: u64 = 7;

/// Font size of labels, in metres.
const LABEL_HEIGHT_M: f64 = 0.03;

/// An encoded message, built field by field.
#[derive(Debug, Clone, Default)]
pub(super) struct Message(pub(super) Vec<u8>);

impl Message {
    /// Adds an integer, a bool or an enum value.
    pub(super) fn int(mut self, field: u32, value: u64) -> Self {
        self.tag(field, 0);
        varint::put(&mut self.0, value);
        self
    }

    pub(super) fn float(self, field: u32, value: f32) -> Self {
        self.fixed32(field, value.to_bits())
    }

    pub(super) fn double(mut self, field: u32, value: f64) -> Self {
        self.tag(field, 1);
        self.0.extend(value.to_le_bytes());
        self
    }

    pub(super) fn fixed32(mut self, field: u32, value: u32) -> Self {
        self.tag(field, 5);
        self.0.extend(value.to_le_bytes());
        self
    }

    pub(super) fn bytes(mut self, field: u32, value: &[u8]) -> Self {
        self.tag(field, 2);
        varint::put(&mut self.0, value.len() as u64);
        self.0.extend_from_slice(value);
        self
    }

    pub(super) fn text(self, field: u32, value: &str) -> Self {
        self.bytes(field, value.as_bytes())
    }

    pub(super) fn message(self, field: u32, value: &Self) -> Self {
        self.bytes(field, &value.0)
    }

    fn tag(&mut self, field: u32, wire_type: u32) {
        varint::put(&mut self.0, u64::from(field << 3 | wire_type));
    }
}

/// `google.protobuf.Timestamp`.
fn timestamp(time_ns: u64) -> Message {
    Message::default().int(1, time_ns / 1_000_000_000).int(2, time_ns % 1_000_000_000)
}

/// The start of a message with a time and a frame of reference in its first two fields.
fn stamped(time_ns: u64, frame: &str) -> Message {
    Message::default().message(1, &timestamp(time_ns)).text(2, frame)
}

/// A message of doubles in fields 1, 2, 3...: a vector, a quaternion or a colour.
fn doubles<const N: usize>(values: [f64; N]) -> Message {
    (1..).zip(values).fold(Message::default(), |out, (field, value)| out.double(field, value))
}

fn pose(at: [f64; 3]) -> Message {
    Message::default().message(1, &doubles(at)).message(2, &doubles([0.0, 0.0, 0.0, 1.0]))
}

fn metres(position: Position) -> [f64; 3] {
    position.map(|mm| f64::from(mm) / MM_PER_METRE)
}

/// Numbers of the fields of a sample's values, after that of its time. Protocol Buffers reserve 19000 to 19999.
pub(super) fn value_fields() -> impl Iterator<Item = u32> {
    (2..19_000).chain(20_000..)
}

/// A sample of all channels of a table: its time, and a float in each of the [`value_fields`].
pub(super) fn sampled(row: &[f32], time_ns: u64) -> Message {
    let message = Message::default().message(1, &timestamp(time_ns));
    value_fields().zip(row).fold(message, |message, (field, value)| message.float(field, *value))
}

/// The `foxglove.PointCloud` of the visible markers.
pub(super) fn cloud(row: &[Position], time_ns: u64) -> Message {
    let mut data = Vec::with_capacity(row.len() * STRIDE);
    for (column, position) in row.iter().enumerate().filter(|(_, position)| !is_gap(**position)) {
        for axis in metres(*position) {
            data.extend((axis as f32).to_le_bytes());
        }
        data.extend((column as u16).to_le_bytes());
        data.extend([0; 2]);
    }
    let header = stamped(time_ns, FRAME).message(3, &pose([0.0; 3])).fixed32(4, STRIDE as u32);
    [("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32), ("marker", 12, UINT16)]
        .map(|(name, offset, kind)| {
            Message::default().text(1, name).fixed32(2, offset).int(3, kind)
        })
        .iter()
        .fold(header, |cloud, field| cloud.message(5, field))
        .bytes(6, &data)
}

/// The `foxglove.SceneUpdate` with the labels of the visible markers.
pub(super) fn label_scene(row: &[Position], labels: &[String], time_ns: u64) -> Message {
    let mut entity = stamped(time_ns, FRAME).text(3, "names");
    for (position, label) in row.iter().zip(labels).filter(|(position, _)| !is_gap(**position)) {
        let text = Message::default()
            .message(1, &pose(metres(*position)))
            .int(2, 1)
            .double(3, LABEL_HEIGHT_M)
            .message(5, &doubles([1.0; 4]))
            .text(6, label);
        entity = entity.message(13, &text);
    }
    Message::default().message(2, &entity)
}

/// The names of the bodies' frames of reference: none is that of the positions or of the world.
pub(super) fn child_frames(names: Vec<String>) -> Vec<String> {
    let all = [FRAME, ROOT].map(str::to_owned).into_iter().chain(names);
    unique_names(all).into_iter().skip(2).collect()
}

/// The `foxglove.FrameTransforms` of the bodies that have a pose; rotations are of length 1.
pub(super) fn transforms(poses: &[Pose], names: &[String], time_ns: u64) -> Message {
    let tracked = poses.iter().zip(names).filter(|(pose, _)| pose.is_tracked());
    tracked.fold(Message::default(), |all, (pose, name)| {
        let [w, x, y, z] = pose.quaternion.map(f64::from);
        let length = (w * w + x * x + y * y + z * z).sqrt();
        let rotation = [x, y, z, w].map(|number| number / length);
        let transform = stamped(time_ns, FRAME).text(3, name);
        let transform = transform.message(4, &doubles(metres(pose.position_mm)));
        all.message(1, &transform.message(5, &doubles(rotation)))
    })
}

/// The `foxglove.FrameTransform` that rotates the take's up axis to z.
pub(super) fn up_transform(up: UpAxis, time_ns: u64) -> Message {
    const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;
    let rotation = match up {
        UpAxis::Z | UpAxis::Unknown => [0.0, 0.0, 0.0, 1.0],
        // 90° about x takes y to z; -90° about y takes x to z.
        UpAxis::Y => [HALF, 0.0, 0.0, HALF],
        UpAxis::X => [0.0, -HALF, 0.0, HALF],
    };
    let transform = stamped(time_ns, ROOT).text(3, FRAME);
    transform.message(4, &doubles([0.0; 3])).message(5, &doubles(rotation))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The examples of protobuf.dev, "Encoding".
    #[test]
    fn fields_are_encoded_as_specified() {
        let inner = Message::default().int(1, 150);
        assert_eq!(inner.0, [0x08, 0x96, 0x01]);
        let outer = Message::default().message(3, &inner).text(2, "testing");
        assert_eq!(outer.0[..5], [0x1a, 0x03, 0x08, 0x96, 0x01]);
        assert_eq!(outer.0[5..], [0x12, 7, b't', b'e', b's', b't', b'i', b'n', b'g']);
    }
}

//! The messages themselves, in Protocol Buffers: the little of them that is needed (protobuf.dev, "Encoding").

use crate::{
    motion::{Position, UpAxis, is_gap},
    varint,
};

/// The frame of reference of the positions, and the one above it, whose z is up.
const FRAME: &str = "mocap";
const ROOT: &str = "world";

/// Millimetres of a metre: viewers count in metres.
const MM: f64 = 1000.0;

/// Bytes of a point: x, y and z as float32, the column as uint16, two of nothing.
const STRIDE: usize = 16;

/// Numbers of `NumericType`.
const UINT16: u64 = 3;
const FLOAT32: u64 = 7;

/// Height of names, in metres.
const TEXT_M: f64 = 0.03;

/// A message as it is written, field after field.
#[derive(Debug, Clone, Default)]
pub(super) struct Message(pub(super) Vec<u8>);

impl Message {
    /// An integer, a bool or a value of an enum.
    pub(super) fn int(&mut self, field: u32, value: u64) {
        self.tag(field, 0);
        varint::put(&mut self.0, value);
    }

    pub(super) fn double(&mut self, field: u32, value: f64) {
        self.tag(field, 1);
        self.0.extend(value.to_le_bytes());
    }

    pub(super) fn fixed32(&mut self, field: u32, value: u32) {
        self.tag(field, 5);
        self.0.extend(value.to_le_bytes());
    }

    pub(super) fn bytes(&mut self, field: u32, value: &[u8]) {
        self.tag(field, 2);
        varint::put(&mut self.0, value.len() as u64);
        self.0.extend_from_slice(value);
    }

    pub(super) fn text(&mut self, field: u32, value: &str) {
        self.bytes(field, value.as_bytes());
    }

    pub(super) fn message(&mut self, field: u32, value: &Self) {
        self.bytes(field, &value.0);
    }

    fn tag(&mut self, field: u32, wire_type: u32) {
        varint::put(&mut self.0, u64::from(field << 3 | wire_type));
    }
}

/// `google.protobuf.Timestamp`.
fn timestamp(time_ns: u64) -> Message {
    let mut out = Message::default();
    out.int(1, time_ns / 1_000_000_000);
    out.int(2, time_ns % 1_000_000_000);
    out
}

fn vector([x, y, z]: [f64; 3]) -> Message {
    let mut out = Message::default();
    out.double(1, x);
    out.double(2, y);
    out.double(3, z);
    out
}

fn quaternion([x, y, z, w]: [f64; 4]) -> Message {
    let mut out = vector([x, y, z]);
    out.double(4, w);
    out
}

fn pose(at: [f64; 3]) -> Message {
    let mut out = Message::default();
    out.message(1, &vector(at));
    out.message(2, &quaternion([0.0, 0.0, 0.0, 1.0]));
    out
}

fn metres(position: Position) -> [f64; 3] {
    position.map(|mm| f64::from(mm) / MM)
}

/// `foxglove.PointCloud` of the markers that are seen.
pub(super) fn cloud(row: &[Position], time_ns: u64) -> Message {
    let mut data = Vec::with_capacity(row.len() * STRIDE);
    for (column, position) in row.iter().enumerate().filter(|(_, position)| !is_gap(**position)) {
        for axis in metres(*position) {
            data.extend((axis as f32).to_le_bytes());
        }
        data.extend((column as u16).to_le_bytes());
        data.extend([0; 2]);
    }
    let mut out = Message::default();
    out.message(1, &timestamp(time_ns));
    out.text(2, FRAME);
    out.message(3, &pose([0.0; 3]));
    out.fixed32(4, STRIDE as u32);
    for (name, offset, kind) in
        [("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32), ("marker", 12, UINT16)]
    {
        let mut field = Message::default();
        field.text(1, name);
        field.fixed32(2, offset);
        field.int(3, kind);
        out.message(5, &field);
    }
    out.bytes(6, &data);
    out
}

/// `foxglove.SceneUpdate` with the names of the markers that are seen.
pub(super) fn names(row: &[Position], labels: &[String], time_ns: u64) -> Message {
    let mut entity = Message::default();
    entity.message(1, &timestamp(time_ns));
    entity.text(2, FRAME);
    entity.text(3, "names");
    let mut colour = vector([1.0, 1.0, 1.0]);
    colour.double(4, 1.0);
    for (position, label) in row.iter().zip(labels).filter(|(position, _)| !is_gap(**position)) {
        let mut text = Message::default();
        text.message(1, &pose(metres(*position)));
        text.int(2, 1);
        text.double(3, TEXT_M);
        text.message(5, &colour);
        text.text(6, label);
        entity.message(13, &text);
    }
    let mut out = Message::default();
    out.message(2, &entity);
    out
}

/// `foxglove.FrameTransform` that turns the take's way up to z.
pub(super) fn way_up(up: UpAxis, time_ns: u64) -> Message {
    const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;
    let mut out = Message::default();
    out.message(1, &timestamp(time_ns));
    out.text(2, ROOT);
    out.text(3, FRAME);
    out.message(4, &vector([0.0; 3]));
    out.message(
        5,
        &quaternion(match up {
            UpAxis::Z | UpAxis::Unknown => [0.0, 0.0, 0.0, 1.0],
            // A quarter turn about x takes y to z; one back about y takes x to z.
            UpAxis::Y => [HALF, 0.0, 0.0, HALF],
            UpAxis::X => [0.0, -HALF, 0.0, HALF],
        }),
    );
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The examples of protobuf.dev, "Encoding".
    #[test]
    fn fields_are_as_they_are_specified() {
        let mut inner = Message::default();
        inner.int(1, 150);
        assert_eq!(inner.0, [0x08, 0x96, 0x01]);
        let mut outer = Message::default();
        outer.message(3, &inner);
        outer.text(2, "testing");
        assert_eq!(outer.0[..5], [0x1a, 0x03, 0x08, 0x96, 0x01]);
        assert_eq!(outer.0[5..], [0x12, 7, b't', b'e', b's', b't', b'i', b'n', b'g']);
    }
}

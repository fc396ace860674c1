//! Export to MCAP with Foxglove's schemas, which Foxglove and other viewers display without configuration.
//!
//! Each frame is a point cloud in metres, with the marker's column as a field of each point. Labels are a scene of
//! texts, the up axis is a transform at the start, and the take's header and ledger are metadata.

mod schema;

use std::{collections::BTreeMap, io::Write};

use mcap::{
    McapError, WriteOptions, Writer,
    records::{MessageHeader, Metadata},
    write::NoSeek,
};

use self::schema::descriptor_set;
use super::{InterchangeError, Result, metadata::metadata, text::column_labels};
use crate::{
    motion::{FrameSource, GAP, Position, UpAxis, is_gap},
    varint,
};

/// Size of a chunk in bytes. One chunk at a time is in memory.
const CHUNK_BYTES: u64 = 1 << 20;

/// Update rate of the labels: as texts they are larger than the points.
const NAMES_HZ: f64 = 10.0;

/// Writes the topics `/markers`, `/names` and `/tf`. A message has the time of its frame, counted from the start of the
/// recording, or from 1970 if that is unknown.
pub(super) fn write(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
    let info = frames.info().clone();
    let header = frames.take().map(|take| &take.header);
    let start_unix_ms = header.map_or(0, |header| header.created_unix_ms);
    let start_unix_ns = u64::try_from(start_unix_ms).unwrap_or(0).saturating_mul(1_000_000);
    // A part of a take keeps its times.
    let first_of_take = header.and_then(|h| h.source.as_ref()).map_or(1, |s| s.first_frame);
    let frames_before = header.map_or(0, |_| info.source.first_frame.saturating_sub(first_of_take));
    let time_of = |index: u64| {
        let elapsed_s = frames_before.saturating_add(index) as f64 / info.rate_hz;
        start_unix_ns.saturating_add((elapsed_s * 1e9).round() as u64)
    };
    let start_ns = time_of(0);
    let options = WriteOptions::new()
        .compression(None)
        .chunk_size(Some(CHUNK_BYTES))
        .library(concat!("mocapd ", env!("CARGO_PKG_VERSION")))
        .disable_seeking(true);
    let writer = options.create(NoSeek::new(out)).map_err(mcap_error)?;
    let mut file = McapFile { writer, sequence: 0 };
    let metadata: BTreeMap<String, String> = metadata(frames).into_iter().collect();
    let metadata = Metadata { name: "mocapd".to_owned(), metadata };
    file.writer.write_metadata(&metadata).map_err(mcap_error)?;
    let transform = file.channel("/tf", "foxglove.FrameTransform")?;
    let markers = file.channel("/markers", "foxglove.PointCloud")?;
    let scene = file.channel("/names", "foxglove.SceneUpdate")?;
    file.message(transform, start_ns, &up_transform(info.up, start_ns))?;
    let labels = column_labels(&info);
    let label_interval = (info.rate_hz / NAMES_HZ).ceil().max(1.0) as u64;
    let mut row = vec![GAP; info.markers.len()];
    let mut index = 0_u64;
    while frames.next_frame(&mut row)? {
        let time_ns = time_of(index);
        file.message(markers, time_ns, &cloud(&row, time_ns))?;
        if index.is_multiple_of(label_interval) {
            file.message(scene, time_ns, &label_scene(&row, &labels, time_ns))?;
        }
        index += 1;
    }
    file.writer.finish().map_err(mcap_error)?;
    Ok(file.writer.into_inner().into_inner().flush()?)
}

struct McapFile<'a> {
    writer: Writer<NoSeek<&'a mut dyn Write>>,
    sequence: u32,
}

impl McapFile<'_> {
    fn channel(&mut self, topic: &str, message: &'static str) -> Result<u16> {
        let schema = self.writer.add_schema(message, "protobuf", &descriptor_set(message));
        let schema = schema.map_err(mcap_error)?;
        self.writer.add_channel(schema, topic, "protobuf", &BTreeMap::new()).map_err(mcap_error)
    }

    fn message(&mut self, channel_id: u16, time_ns: u64, message: &Message) -> Result<()> {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        let header =
            MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
        self.writer.write_to_known_channel(&header, &message.0).map_err(mcap_error)
    }
}

fn mcap_error(error: McapError) -> InterchangeError {
    match error {
        McapError::Io(error) => error.into(),
        error => std::io::Error::other(error).into(),
    }
}

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
struct Message(Vec<u8>);

impl Message {
    /// Adds an integer, a bool or an enum value.
    fn int(mut self, field: u32, value: u64) -> Self {
        self.tag(field, 0);
        varint::put(&mut self.0, value);
        self
    }

    fn double(mut self, field: u32, value: f64) -> Self {
        self.tag(field, 1);
        self.0.extend(value.to_le_bytes());
        self
    }

    fn fixed32(mut self, field: u32, value: u32) -> Self {
        self.tag(field, 5);
        self.0.extend(value.to_le_bytes());
        self
    }

    fn bytes(mut self, field: u32, value: &[u8]) -> Self {
        self.tag(field, 2);
        varint::put(&mut self.0, value.len() as u64);
        self.0.extend_from_slice(value);
        self
    }

    fn text(self, field: u32, value: &str) -> Self {
        self.bytes(field, value.as_bytes())
    }

    fn message(self, field: u32, value: &Self) -> Self {
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

/// The `foxglove.PointCloud` of the visible markers.
fn cloud(row: &[Position], time_ns: u64) -> Message {
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
fn label_scene(row: &[Position], labels: &[String], time_ns: u64) -> Message {
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

/// The `foxglove.FrameTransform` that rotates the take's up axis to z.
fn up_transform(up: UpAxis, time_ns: u64) -> Message {
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

//! Export to MCAP with Foxglove's schemas, which Foxglove and other viewers display without configuration.
//!
//! Each frame is a point cloud in metres, with the marker's column as a field of each point. Labels are a scene of
//! texts, the up axis is a transform at the start, and the take's header and ledger are metadata. Analog samples and the
//! loads of force plates are messages with a field for each channel, which viewers plot by its name.

use std::{collections::BTreeMap, io::Write};

use mcap::{
    McapError, WriteOptions, Writer,
    records::{MessageHeader, Metadata},
    write::NoSeek,
};

use super::{
    InterchangeError, Result,
    foxglove::{self, Message, PlacedBody, descriptor_set, field_names},
    parquet::metadata,
    recorded_rows::{FramePoses, body_names},
    sampled_table::{SampledColumn, SampledTable},
    text::column_labels,
};
use crate::motion::{FrameSource, GAP};

/// Size of a chunk in bytes. One chunk at a time is in memory.
const CHUNK_BYTES: u64 = 1 << 20;

/// Update rate of the labels: as texts they are larger than the points.
const NAMES_HZ: f64 = 10.0;

/// Writes the topics `/markers`, `/names` and `/tf`, and if there are such samples `/analog` and `/force_plates`, and of
/// rigid bodies `/bodies`, their frames of reference, and `/poses`, all their numbers. A message has the time of its
/// frame, counted from the start of the recording, or from 1970 if that is unknown.
pub(super) fn write(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
    let info = frames.info().clone();
    let header = frames.take().map(|take| &take.header);
    let start_unix_ms = header.map_or(0, |header| header.created_unix_ms);
    let start_unix_ns = u64::try_from(start_unix_ms).unwrap_or(0).saturating_mul(1_000_000);
    // A part of a take keeps its times.
    let first_of_take = header.and_then(|h| h.source.as_ref()).map_or(1, |s| s.first_frame);
    let frames_before = header.map_or(0, |_| info.source.first_frame.saturating_sub(first_of_take));
    let time_between = |frames: f64| {
        let frames = frames_before as f64 + frames;
        start_unix_ns.saturating_add_signed((frames / info.rate_hz * 1e9).round() as i64)
    };
    let time_of = |index: u64| time_between(index as f64);
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
    let cloud = file.channel("/markers", "foxglove.PointCloud")?;
    let scene = file.channel("/names", "foxglove.SceneUpdate")?;
    file.message(transform, start_ns, &foxglove::up_transform(info.up, start_ns))?;
    let mut tables = Vec::new();
    for table in SampledTable::all(&info)? {
        tables.push((file.sampled_channel(&table)?, table));
    }
    let mut bodies = FramePoses::open(&info);
    let of_bodies = match &bodies {
        Some(_) => Some(file.channel("/bodies", "foxglove.FrameTransforms")?),
        None => None,
    };
    let names = foxglove::child_frames(body_names(&info));
    let labels = column_labels(&info);
    let label_interval = (info.rate_hz / NAMES_HZ).ceil().max(1.0) as u64;
    let mut row = vec![GAP; info.markers.len()];
    let mut index = 0_u64;
    while frames.next_frame(&mut row)? {
        let time_ns = time_of(index);
        file.message(cloud, time_ns, &foxglove::cloud(&row, time_ns))?;
        if index.is_multiple_of(label_interval) {
            file.message(scene, time_ns, &foxglove::label_scene(&row, &labels, time_ns))?;
        }
        if let (Some(poses), Some(channel)) = (&mut bodies, of_bodies) {
            let poses = poses.next_frame()?;
            let tracked = poses.iter().zip(&names).filter(|(pose, _)| pose.is_tracked());
            let placed = tracked.map(|(pose, name)| PlacedBody {
                name,
                position_mm: pose.position_mm,
                quaternion: pose.quaternion,
            });
            let placed: Vec<_> = placed.collect();
            file.message(channel, time_ns, &foxglove::transforms(None, &placed, time_ns))?;
        }
        for (channel, table) in &mut tables {
            let width = table.columns().len().max(1);
            while let Some((rows, times)) = table.next_rows(index)? {
                for (row, time) in rows.chunks_exact(width).zip(times) {
                    let time_ns = time_between(time.frames);
                    file.message(*channel, time_ns, &foxglove::sampled(row, time_ns))?;
                }
            }
            frames.count_sampled(1);
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

    /// A channel for the samples of a table. Its metadata has the name and unit of each field's channel.
    fn sampled_channel(&mut self, table: &SampledTable<'_>) -> Result<u16> {
        let message = table.kind().message_name();
        let names: Vec<&str> = table.columns().iter().map(|c| c.name.as_str()).collect();
        let fields = field_names(&names);
        let schema = foxglove::sampled_descriptor(&message, &fields);
        let schema = self.writer.add_schema(&message, "protobuf", &schema).map_err(mcap_error)?;
        let describe = |(field, column): (&String, &SampledColumn)| {
            let unit = Some(&column.unit).filter(|unit| !unit.is_empty());
            let unit = unit.map_or_else(String::new, |unit| format!(" ({unit})"));
            (field.clone(), format!("{}{unit}", column.name))
        };
        let metadata = fields.iter().zip(table.columns()).map(describe).collect();
        let topic = format!("/{}", table.kind().name());
        self.writer.add_channel(schema, &topic, "protobuf", &metadata).map_err(mcap_error)
    }

    fn message(&mut self, channel_id: u16, time_ns: u64, message: &Message) -> Result<()> {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        let header =
            MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
        self.writer.write_to_known_channel(&header, message.as_bytes()).map_err(mcap_error)
    }
}

fn mcap_error(error: McapError) -> InterchangeError {
    match error {
        McapError::Io(error) => error.into(),
        error => std::io::Error::other(error).into(),
    }
}

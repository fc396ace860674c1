//! MCAP, written: messages of Foxglove's schemas, so that its viewer and others show a take as it is.
//!
//! A point cloud a frame, in metres, with the column of each point's marker; the markers' names beside it as a
//! scene; the way up as a transform at the start; and what a take says of itself as metadata.

mod messages;
mod schema;

use std::{collections::BTreeMap, io::Write};

use mcap::{
    McapError, WriteOptions, Writer,
    records::{MessageHeader, Metadata},
    write::NoSeek,
};

use self::{messages::Message, schema::descriptor_set};
use super::{InterchangeError, Result, about::about, text::column_labels};
use crate::motion::{FrameSource, GAP};

/// Bytes of a chunk: all of the messages that are in memory.
const CHUNK_BYTES: u64 = 1 << 20;

/// Names move at most so often: they are text, and larger than the points.
const NAMES_HZ: f64 = 10.0;

/// Writes a take as three topics: `/markers`, `/names` and `/tf`. Times are those of frames, from when the recording
/// began, or from 1970 where that is not known.
pub(super) fn write(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
    let info = frames.info().clone();
    let header = frames.take().map(|take| &take.header);
    let begun_ms = header.map_or(0, |header| header.created_unix_ms);
    let begun_ns = u64::try_from(begun_ms).unwrap_or(0).saturating_mul(1_000_000);
    // A part keeps its place in the take.
    let number_of_first =
        header.and_then(|header| header.source.as_ref()).map_or(1, |s| s.first_frame);
    let lead = header.map_or(0, |_| info.source.first_frame.saturating_sub(number_of_first));
    let time_of = |index: u64| {
        let passed_s = lead.saturating_add(index) as f64 / info.rate_hz;
        begun_ns.saturating_add((passed_s * 1e9).round() as u64)
    };
    let start_ns = time_of(0);
    let options = WriteOptions::new()
        .compression(None)
        .chunk_size(Some(CHUNK_BYTES))
        .library(concat!("mocapd ", env!("CARGO_PKG_VERSION")))
        .disable_seeking(true);
    let mut file = File { writer: options.create(NoSeek::new(out)).map_err(failed)?, sequence: 0 };
    let metadata: BTreeMap<String, String> = about(frames).into_iter().collect();
    let metadata = Metadata { name: "mocapd".to_owned(), metadata };
    file.writer.write_metadata(&metadata).map_err(failed)?;
    let transform = file.channel("/tf", "foxglove.FrameTransform")?;
    let cloud = file.channel("/markers", "foxglove.PointCloud")?;
    let scene = file.channel("/names", "foxglove.SceneUpdate")?;
    file.message(transform, start_ns, &messages::way_up(info.up, start_ns))?;
    let labels = column_labels(&info);
    let every = (info.rate_hz / NAMES_HZ).ceil().max(1.0) as u64;
    let mut row = vec![GAP; info.markers.len()];
    let mut index = 0_u64;
    while frames.next_frame(&mut row)? {
        let time_ns = time_of(index);
        file.message(cloud, time_ns, &messages::cloud(&row, time_ns))?;
        if index.is_multiple_of(every) {
            file.message(scene, time_ns, &messages::names(&row, &labels, time_ns))?;
        }
        index += 1;
    }
    file.writer.finish().map_err(failed)?;
    Ok(file.writer.into_inner().into_inner().flush()?)
}

struct File<'a> {
    writer: Writer<NoSeek<&'a mut dyn Write>>,
    sequence: u32,
}

impl File<'_> {
    fn channel(&mut self, topic: &str, message: &'static str) -> Result<u16> {
        let schema = self.writer.add_schema(message, "protobuf", &descriptor_set(message));
        let schema = schema.map_err(failed)?;
        self.writer.add_channel(schema, topic, "protobuf", &BTreeMap::new()).map_err(failed)
    }

    fn message(&mut self, channel_id: u16, time_ns: u64, message: &Message) -> Result<()> {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        let header =
            MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
        self.writer.write_to_known_channel(&header, &message.0).map_err(failed)
    }
}

fn failed(error: McapError) -> InterchangeError {
    match error {
        McapError::Io(error) => error.into(),
        error => std::io::Error::other(error).into(),
    }
}

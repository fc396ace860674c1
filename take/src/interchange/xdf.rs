//! XDF, the recording format of Lab Streaming Layer (github.com/sccn/xdf, version 1.0): interleaved chunks of streams,
//! each with an XML header. Positions are a stream of the type `MoCap`, events one of the type `Markers`, analog channels
//! one of the type `Analog`, the loads of force plates one of the type `Force`, and poses of rigid bodies another one of
//! the type `MoCap`.

use std::io::{self, Write};

use super::{
    Result, check_frame_count,
    recorded_rows::BODY_COLUMNS,
    sampled_table::{SampledColumn, SampledKind, SampledTable},
    text::column_labels,
};
use crate::motion::{FrameSource, GAP, MotionInfo, is_gap};

/// Chunk tags.
const FILE_HEADER: u16 = 1;
const STREAM_HEADER: u16 = 2;
const SAMPLES: u16 = 3;
const CLOCK_OFFSET: u16 = 4;
const STREAM_FOOTER: u16 = 6;

/// Stream ids. Those of sampled channels follow.
const MOTION: u32 = 1;
const EVENTS: u32 = 2;
const SAMPLED: u32 = 3;

/// A chunk of samples is written once it has this many bytes.
const CHUNK_BYTES: usize = 1 << 16;

/// Writes a whole file. Each sample has its time stamp in seconds from the first frame; a missing sample is three NaN.
pub(super) fn write(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
    let info = frames.info().clone();
    out.write_all(b"XDF:")?;
    put_chunk(out, FILE_HEADER, &[b"<?xml version=\"1.0\"?><info><version>1.0</version></info>"])?;
    put_chunk(out, STREAM_HEADER, &[&MOTION.to_le_bytes(), motion_header(&info).as_bytes()])?;
    put_zero_clock_offset(out, MOTION)?;
    if !info.events.is_empty() {
        write_events(&info, out)?;
    }
    let mut streams = SampledStream::all(&info)?;
    for stream in &streams {
        stream.write_header(out)?;
    }
    let mut samples = SampleChunk::new(MOTION);
    let mut row = vec![GAP; info.markers.len()];
    let mut n_written = 0u64;
    while frames.next_frame(&mut row)? {
        let values = samples.push(n_written as f64 / info.rate_hz);
        for &position in &row {
            let position = if is_gap(position) { GAP } else { position };
            values.extend_from_slice(position.map(f32::to_le_bytes).as_flattened());
        }
        n_written += 1;
        samples.flush_if_full(out)?;
        for stream in &mut streams {
            stream.write_frame(n_written - 1, out)?;
            frames.count_sampled(1);
        }
    }
    check_frame_count(info.n_frames, n_written)?;
    samples.flush(out)?;
    for stream in &mut streams {
        stream.finish(out)?;
    }
    let last = n_written.saturating_sub(1) as f64 / info.rate_hz;
    let footer = footer(0.0, last, n_written, Some(info.rate_hz));
    put_chunk(out, STREAM_FOOTER, &[&MOTION.to_le_bytes(), footer.as_bytes()])?;
    Ok(out.flush()?)
}

/// A stream of analog channels, of the loads of force plates, or of poses.
struct SampledStream<'a> {
    table: SampledTable<'a>,
    samples: SampleChunk,
    n_written: u64,
    /// The times of the first and the last sample.
    ends_s: Option<(f64, f64)>,
}

impl<'a> SampledStream<'a> {
    fn all(info: &'a MotionInfo) -> io::Result<Vec<Self>> {
        let stream = |(table, id): (SampledTable<'a>, u32)| {
            let samples = SampleChunk::new(id);
            Self { table, samples, n_written: 0, ends_s: None }
        };
        Ok(SampledTable::all(info)?.into_iter().zip(SAMPLED..).map(stream).collect())
    }

    fn write_header(&self, out: &mut dyn Write) -> io::Result<()> {
        let header = sampled_header(&self.table);
        let id = self.samples.stream;
        put_chunk(out, STREAM_HEADER, &[&id.to_le_bytes(), header.as_bytes()])?;
        put_zero_clock_offset(out, id)
    }

    /// Writes the samples up to those of a frame.
    fn write_frame(&mut self, frame: u64, out: &mut dyn Write) -> io::Result<()> {
        let width = self.table.columns().len().max(1);
        while let Some((rows, times)) = self.table.next_rows(frame)? {
            for (row, time) in rows.chunks_exact(width).zip(times) {
                let first_s = self.ends_s.map_or(time.time_s, |(first_s, _)| first_s);
                self.ends_s = Some((first_s, time.time_s));
                let values = self.samples.push(time.time_s);
                values.extend(row.iter().flat_map(|value| value.to_le_bytes()));
                self.n_written += 1;
            }
            self.samples.flush_if_full(out)?;
        }
        Ok(())
    }

    fn finish(&mut self, out: &mut dyn Write) -> io::Result<()> {
        self.samples.flush(out)?;
        let (first_s, last_s) = self.ends_s.unwrap_or_default();
        let rate_hz = match self.table.is_recorded() && last_s > first_s {
            true => (self.n_written - 1) as f64 / (last_s - first_s),
            false => self.table.rate_hz(),
        };
        let footer = footer(first_s, last_s, self.n_written, Some(rate_hz));
        put_chunk(out, STREAM_FOOTER, &[&self.samples.stream.to_le_bytes(), footer.as_bytes()])
    }
}

fn write_events(info: &MotionInfo, out: &mut dyn Write) -> io::Result<()> {
    put_chunk(out, STREAM_HEADER, &[&EVENTS.to_le_bytes(), EVENT_HEADER.as_bytes()])?;
    put_zero_clock_offset(out, EVENTS)?;
    let mut samples = SampleChunk::new(EVENTS);
    let time_s = |frame: u64| frame as f64 / info.rate_hz;
    for event in &info.events {
        let values = samples.push(time_s(event.frame));
        put_length(values, event.label().len() as u64);
        values.extend(event.label().bytes());
        samples.flush_if_full(out)?;
    }
    samples.flush(out)?;
    let ends = info.events.first().zip(info.events.last());
    let (first, last) = ends.map_or((0.0, 0.0), |(a, b)| (time_s(a.frame), time_s(b.frame)));
    let footer = footer(first, last, info.events.len() as u64, None);
    put_chunk(out, STREAM_FOOTER, &[&EVENTS.to_le_bytes(), footer.as_bytes()])
}

/// Appends a variable-length integer: its size in bytes (1, 4 or 8), then its bytes.
fn put_length(out: &mut Vec<u8>, length: u64) {
    if let Ok(length) = u8::try_from(length) {
        out.extend([1, length]);
    } else if let Ok(length) = u32::try_from(length) {
        out.push(4);
        out.extend(length.to_le_bytes());
    } else {
        out.push(8);
        out.extend(length.to_le_bytes());
    }
}

/// Writes a chunk whose content is the concatenation of `pieces`.
fn put_chunk(out: &mut dyn Write, tag: u16, pieces: &[&[u8]]) -> io::Result<()> {
    let length = pieces.iter().map(|piece| piece.len() as u64).sum::<u64>() + 2;
    let mut header = Vec::with_capacity(16);
    put_length(&mut header, length);
    header.extend(tag.to_le_bytes());
    out.write_all(&header)?;
    pieces.iter().try_for_each(|piece| out.write_all(piece))
}

/// Writes a clock offset of 0 at time 0: all streams of the file share one clock.
fn put_zero_clock_offset(out: &mut dyn Write, stream: u32) -> io::Result<()> {
    let zero = 0_f64.to_le_bytes();
    put_chunk(out, CLOCK_OFFSET, &[&stream.to_le_bytes(), &zero, &zero])
}

/// A chunk of samples under construction.
struct SampleChunk {
    stream: u32,
    n: u64,
    bytes: Vec<u8>,
}

impl SampleChunk {
    fn new(stream: u32) -> Self {
        Self { stream, n: 0, bytes: Vec::new() }
    }

    /// Begins a sample with its time stamp. The caller appends its values to the returned buffer.
    fn push(&mut self, time_s: f64) -> &mut Vec<u8> {
        self.n += 1;
        self.bytes.push(8);
        self.bytes.extend(time_s.to_le_bytes());
        &mut self.bytes
    }

    /// Writes the chunk if it is full, and begins the next one.
    fn flush_if_full(&mut self, out: &mut dyn Write) -> io::Result<()> {
        if self.bytes.len() >= CHUNK_BYTES { self.flush(out) } else { Ok(()) }
    }

    /// Writes the chunk, if it has samples, and begins the next one.
    fn flush(&mut self, out: &mut dyn Write) -> io::Result<()> {
        if self.n == 0 {
            return Ok(());
        }
        let mut header = self.stream.to_le_bytes().to_vec();
        put_length(&mut header, self.n);
        put_chunk(out, SAMPLES, &[&header, &self.bytes])?;
        self.n = 0;
        self.bytes.clear();
        Ok(())
    }
}

/// A text as XML: markup characters are escaped, and characters that XML does not allow are replaced.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '\t' | '\n' | '\r' => out.push(' '),
            '\0'..'\x20' | '\u{fffe}' | '\u{ffff}' => out.push(char::REPLACEMENT_CHARACTER),
            other => out.push(other),
        }
    }
    out
}

/// The header of the stream of positions: three channels for each marker.
fn motion_header(info: &MotionInfo) -> String {
    let labels: Vec<String> = column_labels(info).iter().map(|label| escaped(label)).collect();
    let channel = |label: &String, axis: &str| {
        format!(
            "<channel><label>{label}.{}</label><marker>{label}</marker><type>Position{axis}</type>\
             <unit>millimeters</unit></channel>",
            axis.to_ascii_lowercase()
        )
    };
    let channels: String =
        labels.iter().flat_map(|label| ["X", "Y", "Z"].map(|axis| channel(label, axis))).collect();
    let markers: String =
        labels.iter().map(|label| format!("<marker><label>{label}</label></marker>")).collect();
    format!(
        "<?xml version=\"1.0\"?><info><name>mocapd</name><type>MoCap</type><channel_count>{}</channel_count>\
         <nominal_srate>{}</nominal_srate><channel_format>float32</channel_format><source_id>mocapd</source_id>\
         <version>1.1</version><created_at>0</created_at><desc><channels>{channels}</channels><setup>\
         <name>mocapd</name><markers>{markers}</markers></setup></desc></info>",
        3 * labels.len(),
        info.rate_hz
    )
}

/// The types of a body's channels: those of the metadata convention of motion capture, in which A is the real part of a
/// quaternion, and two of our own.
const BODY_TYPES: [&str; BODY_COLUMNS] = [
    "PositionX",
    "PositionY",
    "PositionZ",
    "OrientationA",
    "OrientationB",
    "OrientationC",
    "OrientationD",
    "Residual",
    "State",
];

/// The channels of a stream of poses, which name their bodies.
fn body_channels(table: &SampledTable<'_>) -> String {
    let channel = |(column, of_body): (&SampledColumn, &str)| {
        let body = column.name.rsplit_once('.').map_or("", |(body, _)| body);
        let [label, body] = [&column.name, body].map(escaped);
        let unit = match column.unit.as_str() {
            "mm" => "millimeters",
            _ if of_body == "State" => "none",
            _ => "quaternion",
        };
        format!(
            "<channel><label>{label}</label><object>{body}</object><type>{of_body}</type><unit>{unit}</unit></channel>"
        )
    };
    table.columns().iter().zip(BODY_TYPES.into_iter().cycle()).map(channel).collect()
}

/// The header of a stream of sampled channels.
fn sampled_header(table: &SampledTable<'_>) -> String {
    let kind = match table.kind() {
        SampledKind::Poses => "MoCap",
        SampledKind::ForcePlates(_) => "Force",
        SampledKind::Analog | SampledKind::Group(_) => "Analog",
    };
    let name = format!("mocapd {}", table.kind().name().replace('_', " "));
    let channel = |column: &SampledColumn| {
        let [label, unit] = [&column.name, &column.unit].map(|text| escaped(text));
        format!("<channel><label>{label}</label><type>{kind}</type><unit>{unit}</unit></channel>")
    };
    let channels = match table.kind() {
        SampledKind::Poses => body_channels(table),
        _ => table.columns().iter().map(channel).collect(),
    };
    format!(
        "<?xml version=\"1.0\"?><info><name>{name}</name><type>{kind}</type><channel_count>{}</channel_count>\
         <nominal_srate>{}</nominal_srate><channel_format>float32</channel_format><source_id>{name}</source_id>\
         <version>1.1</version><created_at>0</created_at><desc><channels>{channels}</channels></desc></info>",
        table.columns().len(),
        // 0 is irregular: readers take the times as they are, where others draw a line through them.
        if table.is_recorded() { 0.0 } else { table.rate_hz() }
    )
}

/// The header of the stream of events: one string per sample, at irregular times.
const EVENT_HEADER: &str = "<?xml version=\"1.0\"?><info><name>mocapd events</name><type>Markers</type>\
     <channel_count>1</channel_count><nominal_srate>0</nominal_srate><channel_format>string</channel_format>\
     <source_id>mocapd events</source_id><version>1.1</version><created_at>0</created_at><desc><channels><channel>\
     <label>event</label></channel></channels></desc></info>";

/// The content of a stream's footer.
fn footer(first_s: f64, last_s: f64, n: u64, rate_hz: Option<f64>) -> String {
    let rate =
        rate_hz.map_or_else(String::new, |hz| format!("<measured_srate>{hz}</measured_srate>"));
    format!(
        "<?xml version=\"1.0\"?><info><first_timestamp>{first_s}</first_timestamp><last_timestamp>{last_s}\
         </last_timestamp><sample_count>{n}</sample_count>{rate}<clock_offsets><offset><time>0</time><value>0</value></offset></clock_offsets></info>"
    )
}

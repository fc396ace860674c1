//! XDF, the format of Lab Streaming Layer's recorder (github.com/sccn/xdf, version 1.0): chunks of streams, each with
//! an XML head. The markers are one stream of the type `MoCap`, what happened another of the type `Markers`.

use std::{
    fmt::Write as _,
    io::{self, Write},
};

use super::{InterchangeError, expect_frames, text::column_labels};
use crate::motion::{FrameSource, GAP, MotionInfo, is_gap};

/// Ids of the streams.
const MOTION: u32 = 1;
const EVENTS: u32 = 2;

/// Bytes of samples that make a chunk, about.
const CHUNK_BYTES: usize = 1 << 16;

/// Writes a whole file. Times are seconds from the first frame, each sample with its own; a missing sample is three
/// NaN.
pub(super) fn write(
    frames: &mut dyn FrameSource,
    out: &mut dyn Write,
) -> Result<(), InterchangeError> {
    let info = frames.info().clone();
    out.write_all(b"XDF:")?;
    put_chunk(
        out,
        tags::FILE_HEADER,
        &[b"<?xml version=\"1.0\"?><info><version>1.0</version></info>"],
    )?;
    put_chunk(out, tags::STREAM_HEADER, &[&MOTION.to_le_bytes(), motion_head(&info).as_bytes()])?;
    put_own_clock(out, MOTION)?;
    if !info.events.is_empty() {
        write_events(&info, out)?;
    }
    let mut samples = Samples::new(MOTION);
    let mut row = vec![GAP; info.markers.len()];
    let mut n_written = 0u64;
    while frames.next_frame(&mut row)? {
        let values = samples.push(n_written as f64 / info.rate_hz);
        for &position in &row {
            let position = if is_gap(position) { GAP } else { position };
            values.extend_from_slice(position.map(f32::to_le_bytes).as_flattened());
        }
        n_written += 1;
        if samples.len() >= CHUNK_BYTES {
            samples.flush(out)?;
        }
    }
    expect_frames(info.n_frames, n_written)?;
    samples.flush(out)?;
    let last = n_written.saturating_sub(1) as f64 / info.rate_hz;
    let foot = foot(0.0, last, n_written, Some(info.rate_hz));
    put_chunk(out, tags::STREAM_FOOTER, &[&MOTION.to_le_bytes(), foot.as_bytes()])?;
    out.flush()?;
    Ok(())
}

fn write_events(info: &MotionInfo, out: &mut dyn Write) -> io::Result<()> {
    put_chunk(out, tags::STREAM_HEADER, &[&EVENTS.to_le_bytes(), event_head().as_bytes()])?;
    put_own_clock(out, EVENTS)?;
    let mut samples = Samples::new(EVENTS);
    let time_s = |frame: u64| frame as f64 / info.rate_hz;
    for event in &info.events {
        let values = samples.push(time_s(event.frame));
        put_length(values, event.label().len() as u64);
        values.extend(event.label().bytes());
        if samples.len() >= CHUNK_BYTES {
            samples.flush(out)?;
        }
    }
    samples.flush(out)?;
    let ends = info.events.first().zip(info.events.last());
    let (first, last) = ends.map_or((0.0, 0.0), |(a, b)| (time_s(a.frame), time_s(b.frame)));
    let foot = foot(first, last, info.events.len() as u64, None);
    put_chunk(out, tags::STREAM_FOOTER, &[&EVENTS.to_le_bytes(), foot.as_bytes()])
}

/// What chunks are.
mod tags {
    pub(super) const FILE_HEADER: u16 = 1;
    pub(super) const STREAM_HEADER: u16 = 2;
    pub(super) const SAMPLES: u16 = 3;
    pub(super) const CLOCK_OFFSET: u16 = 4;
    pub(super) const STREAM_FOOTER: u16 = 6;
}

/// Appends a length: how many bytes it has, 1, 4 or 8, and then those.
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

/// Writes a chunk of several pieces.
fn put_chunk(out: &mut dyn Write, tag: u16, pieces: &[&[u8]]) -> io::Result<()> {
    let length = pieces.iter().map(|piece| piece.len() as u64).sum::<u64>() + 2;
    let mut head = Vec::with_capacity(16);
    put_length(&mut head, length);
    head.extend(tag.to_le_bytes());
    out.write_all(&head)?;
    pieces.iter().try_for_each(|piece| out.write_all(piece))
}

/// Says that the times of a stream are those of the file: an offset of nothing, found at its beginning.
fn put_own_clock(out: &mut dyn Write, stream: u32) -> io::Result<()> {
    let nothing = 0_f64.to_le_bytes();
    put_chunk(out, tags::CLOCK_OFFSET, &[&stream.to_le_bytes(), &nothing, &nothing])
}

/// Samples of a stream, gathered into a chunk.
struct Samples {
    stream: u32,
    n: u64,
    bytes: Vec<u8>,
}

impl Samples {
    fn new(stream: u32) -> Self {
        Self { stream, n: 0, bytes: Vec::new() }
    }

    /// Begins a sample with its time; its values are to be appended to what is given.
    fn push(&mut self, time_s: f64) -> &mut Vec<u8> {
        self.n += 1;
        self.bytes.push(8);
        self.bytes.extend(time_s.to_le_bytes());
        &mut self.bytes
    }

    /// Bytes gathered.
    fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Writes what was gathered.
    fn flush(&mut self, out: &mut dyn Write) -> io::Result<()> {
        if self.n == 0 {
            return Ok(());
        }
        let mut head = self.stream.to_le_bytes().to_vec();
        put_length(&mut head, self.n);
        put_chunk(out, tags::SAMPLES, &[&head, &self.bytes])?;
        self.n = 0;
        self.bytes.clear();
        Ok(())
    }
}

/// A text as XML: marks escaped, and what XML cannot hold replaced.
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

/// The markers' stream: a channel a coordinate.
fn motion_head(info: &MotionInfo) -> String {
    let labels: Vec<String> = column_labels(info).iter().map(|label| escaped(label)).collect();
    let mut head = format!(
        "<?xml version=\"1.0\"?><info><name>mocapd</name><type>MoCap</type><channel_count>{}</channel_count>\
         <nominal_srate>{}</nominal_srate><channel_format>float32</channel_format><source_id>mocapd</source_id>\
         <version>1.1</version><created_at>0</created_at><desc><channels>",
        3 * labels.len(),
        info.rate_hz
    );
    for label in &labels {
        for axis in ["X", "Y", "Z"] {
            let name = axis.to_ascii_lowercase();
            write!(
                head,
                "<channel><label>{label}.{name}</label><marker>{label}</marker><type>Position{axis}</type>\
                 <unit>millimeters</unit></channel>"
            )
            .unwrap_or_default();
        }
    }
    head.push_str("</channels><setup><name>mocapd</name><markers>");
    for label in &labels {
        write!(head, "<marker><label>{label}</label></marker>").unwrap_or_default();
    }
    head.push_str("</markers></setup></desc></info>");
    head
}

/// The stream of what happened: one text a sample, at uneven times.
fn event_head() -> String {
    "<?xml version=\"1.0\"?><info><name>mocapd events</name><type>Markers</type><channel_count>1</channel_count>\
     <nominal_srate>0</nominal_srate><channel_format>string</channel_format><source_id>mocapd events</source_id>\
     <version>1.1</version><created_at>0</created_at><desc><channels><channel><label>event</label></channel>\
     </channels></desc></info>"
        .to_owned()
}

/// What closes a stream.
fn foot(first_s: f64, last_s: f64, n: u64, rate_hz: Option<f64>) -> String {
    let rate =
        rate_hz.map_or_else(String::new, |hz| format!("<measured_srate>{hz}</measured_srate>"));
    format!(
        "<?xml version=\"1.0\"?><info><first_timestamp>{first_s}</first_timestamp><last_timestamp>{last_s}\
         </last_timestamp><sample_count>{n}</sample_count>{rate}<clock_offsets><offset><time>0</time><value>0</value></offset></clock_offsets></info>"
    )
}

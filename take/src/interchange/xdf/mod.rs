//! XDF, the format of Lab Streaming Layer's recorder (github.com/sccn/xdf, version 1.0): chunks of streams, each with
//! an XML head. The markers are one stream of the type `MoCap`, what happened another of the type `Markers`.

mod chunk;
mod xml;

use std::io::Write;

use self::{
    chunk::{Samples, put_chunk, put_own_clock, tags},
    xml::{event_head, foot, motion_head},
};
use super::{InterchangeError, expect_frames};
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

fn write_events(info: &MotionInfo, out: &mut dyn Write) -> std::io::Result<()> {
    put_chunk(out, tags::STREAM_HEADER, &[&EVENTS.to_le_bytes(), event_head().as_bytes()])?;
    put_own_clock(out, EVENTS)?;
    let mut samples = Samples::new(EVENTS);
    let time_s = |frame: u64| frame as f64 / info.rate_hz;
    for event in &info.events {
        let values = samples.push(time_s(event.frame));
        chunk::put_length(values, event.label().len() as u64);
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

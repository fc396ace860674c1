//! Trajectories -> a C3D file: Intel, floats, millimetres.

use std::io::Write;

use super::analog;
use super::body::{Body, Point};
use super::events;
use super::foreign::kept_parameters;
use super::header::{BLOCK, Header};
use super::parameters::Parameters;
use super::section::encode_records;
use super::subjects;
use crate::interchange::{InterchangeError, expect_frames};
use crate::motion::{FrameSource, GAP, MotionInfo};

/// Bytes gathered before they are written.
const BUFFER_BYTES: usize = 1 << 16;
/// The parameter section's processor code for Intel.
const INTEL: u8 = 84;

/// Writes a whole file.
pub(crate) fn write(
    frames: &mut dyn FrameSource,
    out: &mut dyn Write,
) -> Result<(), InterchangeError> {
    let info = frames.info().clone();
    let first_frame = info.source.first_frame;
    let mut body = Body::new(&info, first_frame)?;
    let (mut header, mut parameters) = kept_parameters(&info.foreign)?.unwrap_or_default();
    fill_parameters(&mut parameters, &info, &mut body)?;
    fill_header(&mut header, &parameters, &info, &body);
    out.write_all(&front(header, parameters)?)?;
    let mut row = vec![GAP; info.markers.len()];
    let mut buffer = Vec::with_capacity(BUFFER_BYTES + 16 * body.n_points());
    let mut n_written = 0u64;
    let mut n_bytes = 0usize;
    while frames.next_frame(&mut row)? {
        n_written += 1;
        if n_written > info.n_frames {
            break;
        }
        body.push_frame(&row, &mut buffer)?;
        if buffer.len() >= BUFFER_BYTES {
            out.write_all(&buffer)?;
            n_bytes = (n_bytes + buffer.len()) % BLOCK;
            buffer.clear();
        }
    }
    expect_frames(info.n_frames, n_written)?;
    let block = if is_counted_by_length(&info) { 1 } else { BLOCK };
    let end = (n_bytes + buffer.len()).next_multiple_of(block) - n_bytes;
    buffer.resize(end, 0);
    out.write_all(&buffer)?;
    out.flush()?;
    Ok(())
}

/// Whether some reader counts the frames by the length of the file, so that padding would be frames to it: ezc3d where
/// POINT:FRAMES is 65535, which stands for every count that 16 bits do not hold; py-c3d where the first frame's number has
/// more than 16 bits, of which it makes one too few and so reads a frame too many.
fn is_counted_by_length(info: &MotionInfo) -> bool {
    let max = u64::from(u16::MAX);
    info.n_frames >= max || info.source.first_frame > max
}

/// The labels of all points.
fn labels(parameters: &Parameters, info: &MotionInfo, points: &[Point]) -> Vec<String> {
    let source = parameters.texts("POINT", "LABELS");
    points
        .iter()
        .enumerate()
        .map(|(place, point)| match *point {
            Point::Marker(index) => {
                info.markers.get(index).map(|m| m.label.clone()).unwrap_or_default()
            }
            Point::ModelOutput(_) => source.get(place).cloned().unwrap_or_default(),
        })
        .collect()
}

/// Makes the parameters say what will be written; all others stay as they came.
fn fill_parameters(
    parameters: &mut Parameters,
    info: &MotionInfo,
    body: &mut Body<'_>,
) -> Result<(), InterchangeError> {
    let n_points = u16::try_from(body.n_points()).map_err(|_| {
        InterchangeError::Unsupported(format!(
            "c3d holds at most 65535 points, there are {}",
            body.n_points()
        ))
    })?;
    let last = last_frame(info).ok_or_else(|| {
        InterchangeError::Unsupported(format!(
            "c3d counts frames in 32 bits: {} frames from number {} are too many",
            info.n_frames, info.source.first_frame
        ))
    })?;
    // What was kept says how many frames it was kept of: a part of them has its own events only.
    let kept_frames = parameters.number("POINT", "FRAMES");
    let whole = kept_frames.is_some_and(|n| n as u64 == info.n_frames.min(u64::from(u16::MAX)));
    let labels = labels(parameters, info, &body.points);
    let mut descriptions = parameters.texts("POINT", "DESCRIPTIONS");
    parameters.set_word("POINT", "USED", n_points);
    parameters.set_float("POINT", "SCALE", -residual_scale(parameters, info.source.factor));
    parameters.set_float("POINT", "RATE", info.rate_hz as f32);
    parameters.set_word("POINT", "DATA_START", 0);
    parameters.set_word("POINT", "FRAMES", u16::try_from(info.n_frames).unwrap_or(u16::MAX));
    if info.n_frames > u64::from(u16::MAX) || parameters.get("POINT", "LONG_FRAMES").is_some() {
        parameters.set_float("POINT", "LONG_FRAMES", info.n_frames as f32);
    }
    if parameters.get("POINT", "UNITS").is_some() && info.source.factor != 1.0 {
        // These are lengths in POINT:UNITS, which becomes mm.
        parameters.scale_floats("FORCE_PLATFORM", "CORNERS", info.source.factor);
        parameters.scale_floats("FORCE_PLATFORM", "ORIGIN", info.source.factor);
    }
    parameters.set_text("POINT", "UNITS", "mm");
    parameters.set_texts("POINT", "LABELS", &labels).map_err(|label| {
        InterchangeError::Unsupported(format!(
            "c3d labels have at most 255 bytes: `{label}` has {}",
            label.len()
        ))
    })?;
    if descriptions.len() != labels.len() {
        descriptions.resize(labels.len(), String::new());
        // None is longer than what was read.
        parameters.set_texts("POINT", "DESCRIPTIONS", &descriptions).unwrap_or_default();
    }
    parameters.set_screen(info.up);
    parameters.set_manufacturer();
    subjects::fill(parameters, &info.markers);
    events::fill(parameters, info, whole);
    let (ratio, n_channels) = body.analog_shape();
    if n_channels == 0 {
        parameters.set_no_analog();
    } else {
        body.analog_offsets = analog::complete(parameters, n_channels, ratio, info.rate_hz);
    }
    parameters.set_double_word("TRIAL", "ACTUAL_START_FIELD", first_frame(info));
    parameters.set_double_word("TRIAL", "ACTUAL_END_FIELD", last);
    Ok(())
}

/// Number of the first frame; C3D counts from 1.
fn first_frame(info: &MotionInfo) -> u32 {
    u32::try_from(info.source.first_frame).unwrap_or(u32::MAX).max(1)
}

/// Number of the last frame, if 32 bits hold it.
fn last_frame(info: &MotionInfo) -> Option<u32> {
    let last = info.source.first_frame.max(1).checked_add(info.n_frames)?.checked_sub(1)?;
    u32::try_from(last).ok()
}

/// The magnitude of POINT:SCALE: what a residual is counted in, in millimetres.
fn residual_scale(parameters: &Parameters, factor: f64) -> f32 {
    let source = parameters.number("POINT", "SCALE").unwrap_or(1.0).abs();
    let factor = if factor.is_finite() && factor > 0.0 { factor } else { 1.0 };
    let scale = (source * factor) as f32;
    if scale.is_finite() && scale > 0.0 { scale } else { 1.0 }
}

fn fill_header(header: &mut Header, parameters: &Parameters, info: &MotionInfo, body: &Body<'_>) {
    let word = |value: u32| u16::try_from(value).unwrap_or(u16::MAX);
    let float =
        |name: &str| parameters.get("POINT", name).and_then(|p| p.floats().first().copied());
    let (ratio, n_channels) = body.analog_shape();
    header.parameter_block = 2;
    header.n_points = body.n_points() as u16;
    header.first_frame = word(first_frame(info));
    header.last_frame = word(last_frame(info).unwrap_or(u32::MAX));
    header.scale = float("SCALE").unwrap_or(-1.0);
    header.rate_hz = float("RATE").unwrap_or(0.0);
    header.analog_per_frame = word((ratio * n_channels) as u32);
    header.analog_ratio =
        if n_channels > 0 { word(ratio as u32) } else { idle_analog_ratio(parameters) };
}

/// Analog samples a frame when there are no channels: what the two rates say, so that readers find them to agree.
fn idle_analog_ratio(parameters: &Parameters) -> u16 {
    let analog = parameters.number("ANALOG", "RATE").unwrap_or(0.0);
    let ratio = analog / parameters.number("POINT", "RATE").unwrap_or(0.0);
    if ratio.is_finite() && ratio.fract() == 0.0 && (0.0..65536.0).contains(&ratio) {
        ratio as u16
    } else {
        0
    }
}

/// Header and parameter section. Where the section is too long for its count of blocks, descriptions of points
/// give way first.
fn front(mut header: Header, mut parameters: Parameters) -> Result<Vec<u8>, InterchangeError> {
    let mut records = Vec::new();
    encode_records(&parameters, &mut records);
    if section_blocks(&records) > 255 {
        parameters.remove_list("POINT", "DESCRIPTIONS");
        records.clear();
        encode_records(&parameters, &mut records);
    }
    let n_blocks = u8::try_from(section_blocks(&records)).map_err(|_| {
        InterchangeError::Unsupported(format!(
            "c3d holds at most {} bytes of parameters, labels among them; there are {}",
            255 * BLOCK,
            records.len()
        ))
    })?;
    header.data_block = u16::from(n_blocks) + 2;
    parameters.set_word("POINT", "DATA_START", header.data_block);
    records.clear();
    encode_records(&parameters, &mut records);
    let mut front = header.to_bytes().to_vec();
    front.extend([1, 0x50, n_blocks, INTEL]);
    front.extend(records);
    front.resize(usize::from(header.data_block - 1) * BLOCK, 0);
    Ok(front)
}

/// Blocks that a section of these records takes.
fn section_blocks(records: &[u8]) -> usize {
    (records.len() + 4).div_ceil(BLOCK)
}

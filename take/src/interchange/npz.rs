//! `NumPy` archives (`.npz`): a ZIP file with one `.npy` file for each array (NEP 1).
//!
//! | array | shape | type | content |
//! |---|---|---|---|
//! | `labels` | markers | text | the markers' names |
//! | `labelled` | markers | bool | whether the source gave the marker its name |
//! | `rate_hz` | | f64 | frames a second |
//! | `first_frame` | | i64 | the number of the first frame |
//! | `unit` | | text | `mm` |
//! | `up` | | text | the up axis: `x`, `y`, `z`, or empty if unknown |
//! | `event_frame`, `event_time_s`, `event_kind`, `event_label` | events | i64, f64, text, text | the events; frames count from 0 |
//! | `time_s` | frames | f64 | seconds from the first frame |
//! | `positions_mm` | frames, markers, 3 | f32 | NaN where a sample is missing |

use std::io::{BufWriter, Seek, Write};

use super::{InterchangeError, Result, check_frame_count, write_frames, zip::Archive};
use crate::motion::{FrameSource, GAP, MotionEvent, MotionInfo, is_gap};

/// The length of a `.npy` header is a multiple of this number of bytes, so that elements are aligned.
const ALIGNMENT: usize = 64;
/// Most bytes of a text array: every element is as long as the longest text.
const TEXT_BYTES_MAX: u64 = 1 << 26;

/// Writes an archive at the current position of `out`. The writer seeks back to fill in the checksums of the long
/// arrays, so that a program can stream the archive, as from a pipe: each member's length and checksum stand in front
/// of it.
///
/// # Errors
/// `Unsupported` if the labels are too long for a text array; `Io` if reading or writing fails.
pub fn write(frames: &mut dyn FrameSource, out: &mut (impl Write + Seek)) -> Result<()> {
    // One copy of the code, built with this crate.
    write_to(frames, &mut (out as &mut dyn WriteSeek))
}

trait WriteSeek: Write + Seek {}

impl<T: Write + Seek> WriteSeek for T {}

fn write_to(frames: &mut dyn FrameSource, out: &mut &mut dyn WriteSeek) -> Result<()> {
    let info = frames.info().clone();
    let mut archive = Archive::new(out)?;
    write_metadata(&info, &mut archive)?;
    write_events(&info, &mut archive)?;
    let header = npy_header(F64, &[info.n_frames]);
    let n_bytes = array_bytes(&header, &[info.n_frames, 8]);
    archive.stream("time_s.npy", n_bytes, |out| {
        let mut out = BufWriter::new(out);
        out.write_all(&header)?;
        let times_s = (0..info.n_frames).map(|index| index as f64 / info.rate_hz);
        times_s.map(f64::to_le_bytes).try_for_each(|time| out.write_all(&time))?;
        out.flush()
    })?;
    let shape = [info.n_frames, info.markers.len() as u64, 3];
    let header = npy_header(F32, &shape);
    let n_bytes = array_bytes(&header, &[&shape[..], &[4]].concat());
    archive.stream("positions_mm.npy", n_bytes, |out| {
        let n_written = write_frames(frames, out, header, |buffer, _, row| {
            for &position in row {
                let position = if is_gap(position) { GAP } else { position };
                buffer.extend_from_slice(position.map(f32::to_le_bytes).as_flattened());
            }
            Ok(())
        })?;
        check_frame_count(info.n_frames, n_written)
    })?;
    Ok(archive.finish()?)
}

/// The size of a `.npy` file with this header, in bytes; its data has as many bytes as the product of `factors`.
fn array_bytes(header: &[u8], factors: &[u64]) -> u64 {
    let n_bytes = factors.iter().fold(1, |product: u64, &n| product.saturating_mul(n));
    n_bytes.saturating_add(header.len() as u64)
}

/// Writes the arrays of the markers and the scalars.
fn write_metadata(info: &MotionInfo, archive: &mut Archive<'_, impl Write + Seek>) -> Result<()> {
    let labels: Vec<&str> = info.markers.iter().map(|marker| marker.label.as_str()).collect();
    archive.put("labels.npy", &text_array(&labels)?)?;
    let mut labelled = npy_header(BOOL, &[info.markers.len() as u64]);
    labelled.extend(info.markers.iter().map(|marker| u8::from(marker.labelled)));
    archive.put("labelled.npy", &labelled)?;
    let one = |kind: &str, bytes: [u8; 8]| [npy_header(kind, &[]), bytes.to_vec()].concat();
    archive.put("rate_hz.npy", &one(F64, info.rate_hz.to_le_bytes()))?;
    archive.put("first_frame.npy", &one(I64, info.source.first_frame.to_le_bytes()))?;
    archive.put("unit.npy", &text_scalar("mm"))?;
    Ok(archive.put("up.npy", &text_scalar(info.up.name().unwrap_or_default()))?)
}

fn write_events(info: &MotionInfo, archive: &mut Archive<'_, impl Write + Seek>) -> Result<()> {
    let events = &info.events;
    let n = events.len() as u64;
    let mut numbers = npy_header(I64, &[n]);
    numbers.extend(events.iter().flat_map(|event| event.frame.to_le_bytes()));
    archive.put("event_frame.npy", &numbers)?;
    let mut times = npy_header(F64, &[n]);
    let time_s = events.iter().map(|event| event.frame as f64 / info.rate_hz);
    times.extend(time_s.flat_map(f64::to_le_bytes));
    archive.put("event_time_s.npy", &times)?;
    let kinds: Vec<&str> = events.iter().map(|event| event.kind.name()).collect();
    archive.put("event_kind.npy", &text_array(&kinds)?)?;
    let labels: Vec<&str> = events.iter().map(MotionEvent::label).collect();
    Ok(archive.put("event_label.npy", &text_array(&labels)?)?)
}

// Element types in NumPy's notation. Texts are UTF-32 of a fixed number of characters: `<U8`.
const BOOL: &str = "|b1";
const I64: &str = "<i8";
const F32: &str = "<f4";
const F64: &str = "<f8";

/// The header of a `.npy` file; a scalar has no dimensions.
fn npy_header(kind: &str, shape: &[u64]) -> Vec<u8> {
    let shape: String = shape.iter().map(|n| format!("{n}, ")).collect();
    // A tuple of one needs its trailing comma, and longer tuples may have one.
    let shape = shape.trim_end();
    let dictionary = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}");
    let mut header = b"\x93NUMPY\x01\x00\0\0".to_vec();
    let padded = (header.len() + dictionary.len() + 1).next_multiple_of(ALIGNMENT);
    let description_bytes = (padded - header.len()) as u16;
    if let Some(place) = header.get_mut(8..10) {
        place.copy_from_slice(&description_bytes.to_le_bytes());
    }
    header.extend(dictionary.bytes());
    header.resize(padded - 1, b' ');
    header.push(b'\n');
    header
}

/// A one-dimensional array of texts.
fn text_array(texts: &[&str]) -> Result<Vec<u8>> {
    let longest = texts.iter().map(|text| text.chars().count()).max().unwrap_or(0).max(1);
    let n = texts.len() as u64;
    if n.saturating_mul(4 * longest as u64) > TEXT_BYTES_MAX {
        return Err(InterchangeError::Unsupported(format!(
            "npz stores every text at the length of the longest: {n} texts of {longest} characters are too large"
        )));
    }
    let mut array = npy_header(&format!("<U{longest}"), &[n]);
    texts.iter().for_each(|text| push_text(text, longest, &mut array));
    Ok(array)
}

/// A scalar text.
fn text_scalar(text: &str) -> Vec<u8> {
    let characters = text.chars().count().max(1);
    let mut array = npy_header(&format!("<U{characters}"), &[]);
    push_text(text, characters, &mut array);
    array
}

fn push_text(text: &str, characters: usize, out: &mut Vec<u8>) {
    let end = out.len() + 4 * characters;
    out.extend(text.chars().flat_map(|c| u32::from(c).to_le_bytes()));
    out.resize(end, 0);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_match_those_of_numpy() {
        for (shape, expected) in [
            (&[][..], "'shape': (), }"),
            (&[7][..], "'shape': (7,), }"),
            (&[7, 2, 3], "'shape': (7, 2, 3,), }"),
        ] {
            let header = npy_header(F32, shape);
            assert!(header.len().is_multiple_of(ALIGNMENT) && header.ends_with(b"\n"));
            assert_eq!(usize::from(u16::from_le_bytes([header[8], header[9]])), header.len() - 10);
            let text = String::from_utf8_lossy(&header[10..]).into_owned();
            assert!(text.starts_with("{'descr': '<f4', ") && text.contains(expected), "{text}");
        }
    }

    #[test]
    fn texts_are_padded_to_the_longest() {
        let array = text_array(&["a", "", "\u{4e2d}b"]).unwrap();
        let header = npy_header("<U2", &[3]).len();
        let code_points: Vec<u32> =
            array[header..].as_chunks().0.iter().map(|&b| u32::from_le_bytes(b)).collect();
        assert_eq!(code_points, [0x61, 0, 0, 0, 0x4e2d, 0x62]);
        let long = "x".repeat(1 << 20);
        assert!(text_array(&[long.as_str(); 1000]).is_err());
    }
}

//! `NumPy` archives (`.npz`): a ZIP file of arrays, each a `.npy` (NEP 1).
//!
//! | array | shape | type | what |
//! |---|---|---|---|
//! | `labels` | markers | text | their names |
//! | `labelled` | markers | bool | whether a name came from the source |
//! | `rate_hz` | | f64 | frames a second |
//! | `first_frame` | | i64 | number of the first frame |
//! | `unit` | | text | `mm` |
//! | `up` | | text | the axis that points up: `x`, `y`, `z`, or nothing |
//! | `event_frame`, `event_time_s`, `event_kind`, `event_label` | events | i64, f64, text, text | what happened; frames count from 0 |
//! | `time_s` | frames | f64 | seconds from the first frame |
//! | `positions_mm` | frames, markers, 3 | f32 | NaN where a sample is missing |

use std::io::{BufWriter, Seek, Write};

use super::{InterchangeError, Result, expect_frames, write_frames, zip::Archive};
use crate::motion::{FrameSource, GAP, MotionEvent, MotionInfo, is_gap};

/// Bytes that a head's length is a multiple of, so that elements are aligned.
const ALIGNMENT: usize = 64;
/// Most bytes of an array of texts: every element has the room of the longest.
const TEXT_BYTES_MAX: u64 = 1 << 26;

/// Writes a whole archive from where `out` stands. The checksums of long members are put in front of them once they are
/// known, so that what reads from front to back, as from a pipe, finds each member's length and checksum before it.
///
/// # Errors
/// `Unsupported` when labels are too long; `Io`.
pub fn write(frames: &mut dyn FrameSource, out: &mut (impl Write + Seek)) -> Result<()> {
    let info = frames.info().clone();
    let mut archive = Archive::new(out)?;
    about(&info, &mut archive)?;
    events(&info, &mut archive)?;
    let head = header(F64, &[info.n_frames]);
    let n_bytes = array_bytes(&head, &[info.n_frames, 8]);
    archive.stream("time_s.npy", n_bytes, |out| {
        let mut out = BufWriter::new(out);
        out.write_all(&head)?;
        let times_s = (0..info.n_frames).map(|index| index as f64 / info.rate_hz);
        times_s.map(f64::to_le_bytes).try_for_each(|time| out.write_all(&time))?;
        out.flush()
    })?;
    let shape = [info.n_frames, info.markers.len() as u64, 3];
    let head = header(F32, &shape);
    let n_bytes = array_bytes(&head, &[&shape[..], &[4]].concat());
    archive.stream("positions_mm.npy", n_bytes, |out| {
        let n_written = write_frames(frames, out, head, |buffer, _, row| {
            for &position in row {
                let position = if is_gap(position) { GAP } else { position };
                buffer.extend_from_slice(position.map(f32::to_le_bytes).as_flattened());
            }
            Ok(())
        })?;
        expect_frames(info.n_frames, n_written)
    })?;
    archive.finish()?;
    Ok(())
}

/// Bytes of an array with this head, whose bytes are the product of `factors`.
fn array_bytes(head: &[u8], factors: &[u64]) -> u64 {
    factors
        .iter()
        .fold(1, |product: u64, &n| product.saturating_mul(n))
        .saturating_add(head.len() as u64)
}

/// The markers, and what stands once.
fn about(info: &MotionInfo, archive: &mut Archive<'_, impl Write + Seek>) -> Result<()> {
    let labels: Vec<&str> = info.markers.iter().map(|marker| marker.label.as_str()).collect();
    archive.put("labels.npy", &texts(&labels)?)?;
    let mut labelled = header(BOOL, &[info.markers.len() as u64]);
    labelled.extend(info.markers.iter().map(|marker| u8::from(marker.labelled)));
    archive.put("labelled.npy", &labelled)?;
    let one = |kind: &str, bytes: [u8; 8]| [header(kind, &[]), bytes.to_vec()].concat();
    archive.put("rate_hz.npy", &one(F64, info.rate_hz.to_le_bytes()))?;
    archive.put("first_frame.npy", &one(I64, info.source.first_frame.to_le_bytes()))?;
    archive.put("unit.npy", &text("mm"))?;
    archive.put("up.npy", &text(info.up.name().unwrap_or_default()))?;
    Ok(())
}

fn events(info: &MotionInfo, archive: &mut Archive<'_, impl Write + Seek>) -> Result<()> {
    let events = &info.events;
    let n = events.len() as u64;
    let mut numbers = header(I64, &[n]);
    numbers.extend(events.iter().flat_map(|event| event.frame.to_le_bytes()));
    archive.put("event_frame.npy", &numbers)?;
    let mut times = header(F64, &[n]);
    let time_s = events.iter().map(|event| event.frame as f64 / info.rate_hz);
    times.extend(time_s.flat_map(f64::to_le_bytes));
    archive.put("event_time_s.npy", &times)?;
    let kinds: Vec<&str> = events.iter().map(|event| event.kind.word()).collect();
    archive.put("event_kind.npy", &texts(&kinds)?)?;
    let labels: Vec<&str> = events.iter().map(MotionEvent::label).collect();
    archive.put("event_label.npy", &texts(&labels)?)?;
    Ok(())
}

// Types of elements, as NumPy writes them; texts are of UTF-32, so many characters each: `<U8`.
const BOOL: &str = "|b1";
const I64: &str = "<i8";
const F32: &str = "<f4";
const F64: &str = "<f8";

/// The head of an array; no dimensions for a single element.
fn header(kind: &str, shape: &[u64]) -> Vec<u8> {
    let shape: String = shape.iter().map(|n| format!("{n}, ")).collect();
    // A tuple of one keeps its comma; Python reads one behind the last of several, too.
    let about = format!(
        "{{'descr': '{}', 'fortran_order': False, 'shape': ({}), }}",
        kind,
        shape.trim_end()
    );
    let mut head = b"\x93NUMPY\x01\x00\0\0".to_vec();
    let padded = (head.len() + about.len() + 1).next_multiple_of(ALIGNMENT);
    let about_bytes = (padded - head.len()) as u16;
    if let Some(place) = head.get_mut(8..10) {
        place.copy_from_slice(&about_bytes.to_le_bytes());
    }
    head.extend(about.bytes());
    head.resize(padded - 1, b' ');
    head.push(b'\n');
    head
}

/// An array of texts.
fn texts(texts: &[&str]) -> Result<Vec<u8>> {
    let longest = texts.iter().map(|text| text.chars().count()).max().unwrap_or(0).max(1);
    let n = texts.len() as u64;
    if n.saturating_mul(4 * longest as u64) > TEXT_BYTES_MAX {
        return Err(InterchangeError::Unsupported(format!(
            "npz gives every text the room of the longest: {n} of {longest} characters are too many"
        )));
    }
    let mut array = header(&format!("<U{longest}"), &[n]);
    texts.iter().for_each(|text| push_text(text, longest, &mut array));
    Ok(array)
}

/// A single text.
fn text(text: &str) -> Vec<u8> {
    let characters = text.chars().count().max(1);
    let mut array = header(&format!("<U{characters}"), &[]);
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
    fn heads_are_as_numpy_writes_them() {
        for (shape, said) in [
            (&[][..], "'shape': (), }"),
            (&[7][..], "'shape': (7,), }"),
            (&[7, 2, 3], "'shape': (7, 2, 3,), }"),
        ] {
            let head = header(F32, shape);
            assert!(head.len().is_multiple_of(ALIGNMENT) && head.ends_with(b"\n"));
            assert_eq!(usize::from(u16::from_le_bytes([head[8], head[9]])), head.len() - 10);
            let text = String::from_utf8_lossy(&head[10..]).into_owned();
            assert!(text.starts_with("{'descr': '<f4', ") && text.contains(said), "{text}");
        }
    }

    #[test]
    fn texts_have_the_room_of_the_longest() {
        let array = texts(&["a", "", "\u{4e2d}b"]).unwrap();
        let head = header("<U2", &[3]).len();
        let words: Vec<u32> =
            array[head..].as_chunks().0.iter().map(|&b| u32::from_le_bytes(b)).collect();
        assert_eq!(words, [0x61, 0, 0, 0, 0x4e2d, 0x62]);
        let long = "x".repeat(1 << 20);
        assert!(texts(&[long.as_str(); 1000]).is_err());
    }
}

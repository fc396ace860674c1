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

mod archive;
mod array;

use std::io::Write;

use self::{
    archive::Archive,
    array::{Kind, header, texts},
};
use super::{InterchangeError, expect_frames};
use crate::motion::{FrameSource, GAP, MotionEvent, MotionInfo, UpAxis, is_gap};

/// Bytes gathered before they are written.
const BUFFER_BYTES: usize = 1 << 16;

/// Writes a whole archive. The positions come last: what is known before them stands in front with its checksum, so
/// that readers which go through the file in order find everything.
pub(super) fn write(
    frames: &mut dyn FrameSource,
    out: &mut dyn Write,
) -> Result<(), InterchangeError> {
    let info = frames.info().clone();
    let mut archive = Archive::new(out);
    about(&info, &mut archive)?;
    events(&info, &mut archive)?;
    let time_s = |index: u64| index as f64 / info.rate_hz;
    let times = || (0..info.n_frames).map(|index| time_s(index).to_le_bytes());
    archive.repeatable(
        "time_s.npy",
        &header(Kind::F64, &[info.n_frames]),
        8 * info.n_frames,
        times,
    )?;
    positions(frames, &info, &mut archive)?;
    archive.finish()?;
    Ok(())
}

/// The markers, and what stands once.
fn about(info: &MotionInfo, archive: &mut Archive<'_>) -> Result<(), InterchangeError> {
    let labels: Vec<&str> = info.markers.iter().map(|marker| marker.label.as_str()).collect();
    archive.small("labels.npy", &texts(&labels)?)?;
    let mut labelled = header(Kind::Bool, &[info.markers.len() as u64]);
    labelled.extend(info.markers.iter().map(|marker| u8::from(marker.labelled)));
    archive.small("labelled.npy", &labelled)?;
    let one = |kind: Kind, bytes: [u8; 8]| [header(kind, &[]), bytes.to_vec()].concat();
    archive.small("rate_hz.npy", &one(Kind::F64, info.rate_hz.to_le_bytes()))?;
    archive.small("first_frame.npy", &one(Kind::I64, info.source.first_frame.to_le_bytes()))?;
    archive.small("unit.npy", &array::text("mm"))?;
    let up = match info.up {
        UpAxis::Unknown => "",
        UpAxis::X => "x",
        UpAxis::Y => "y",
        UpAxis::Z => "z",
    };
    archive.small("up.npy", &array::text(up))?;
    Ok(())
}

fn events(info: &MotionInfo, archive: &mut Archive<'_>) -> Result<(), InterchangeError> {
    let events = &info.events;
    let n = events.len() as u64;
    let mut numbers = header(Kind::I64, &[n]);
    numbers.extend(events.iter().flat_map(|event| event.frame.to_le_bytes()));
    archive.small("event_frame.npy", &numbers)?;
    let mut times = header(Kind::F64, &[n]);
    let time_s = events.iter().map(|event| event.frame as f64 / info.rate_hz);
    times.extend(time_s.flat_map(f64::to_le_bytes));
    archive.small("event_time_s.npy", &times)?;
    let kinds: Vec<&str> = events.iter().map(|event| event.kind.word()).collect();
    archive.small("event_kind.npy", &texts(&kinds)?)?;
    let labels: Vec<&str> = events.iter().map(MotionEvent::label).collect();
    archive.small("event_label.npy", &texts(&labels)?)?;
    Ok(())
}

fn positions(
    frames: &mut dyn FrameSource,
    info: &MotionInfo,
    archive: &mut Archive<'_>,
) -> Result<(), InterchangeError> {
    let n_markers = info.markers.len() as u64;
    let head = header(Kind::F32, &[info.n_frames, n_markers, 3]);
    let too_many = || InterchangeError::Unsupported("more samples than a file can hold".to_owned());
    let n_bytes = info.n_frames.checked_mul(12 * n_markers).ok_or_else(too_many)?;
    archive.begin("positions_mm.npy", head.len() as u64 + n_bytes)?;
    archive.put(&head)?;
    let mut row = vec![GAP; info.markers.len()];
    let mut buffer = Vec::with_capacity(BUFFER_BYTES + 12 * row.len());
    let mut n_written = 0u64;
    while frames.next_frame(&mut row)? {
        n_written += 1;
        if n_written > info.n_frames {
            break;
        }
        for &position in &row {
            let position = if is_gap(position) { GAP } else { position };
            buffer.extend_from_slice(position.map(f32::to_le_bytes).as_flattened());
        }
        if buffer.len() >= BUFFER_BYTES {
            archive.put(&buffer)?;
            buffer.clear();
        }
    }
    expect_frames(info.n_frames, n_written)?;
    archive.put(&buffer)?;
    archive.end()?;
    Ok(())
}

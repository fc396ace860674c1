//! Reading a frame of any form.

use super::{RESIDUALS, TIMECODE, compact, plain, position::millimetres};
use crate::{
    device::{Frame, MarkerSample},
    link::{MARKERS_MAX, cursor::Cursor, kind},
};

/// Reads a frame into `markers`, and counts into `not_finite` the positions that were none.
/// `kind` is one of the three of frames.
pub(in crate::link) fn get_frame<'a>(
    kind: u8,
    payload: &[u8],
    markers: &'a mut Vec<MarkerSample>,
    not_finite: &mut u64,
) -> Option<Frame<'a>> {
    let mut cursor = Cursor::new(payload);
    let (seq, device_ticks, flags) = (cursor.u32()?, cursor.u64()?, cursor.u8()?);
    let n = usize::from(cursor.u16()?);
    if flags & !(TIMECODE | RESIDUALS) != 0 || n > MARKERS_MAX {
        return None;
    }
    let timecode = if flags & TIMECODE != 0 { Some(cursor.array::<4>()?) } else { None };
    let residuals = flags & RESIDUALS != 0;
    markers.clear();
    match kind {
        kind::FRAME_FLOAT => {
            plain::get(&mut cursor, n, residuals, markers, |axes| axes.map(f32::from_le_bytes))?;
            cursor.end(())?;
            *not_finite += occlude_not_finite(markers);
        }
        kind::FRAME_MICROMETRES => {
            plain::get(&mut cursor, n, residuals, markers, |axes| {
                millimetres(axes.map(i32::from_le_bytes))
            })?;
            cursor.end(())?;
        }
        _ => {
            compact::get(&mut cursor, n, residuals, markers)?;
            cursor.end(())?;
        }
    }
    Some(Frame { seq, device_ticks, timecode, markers })
}

fn occlude_not_finite(markers: &mut [MarkerSample]) -> u64 {
    let mut count = 0;
    for marker in markers {
        if !marker.position_mm.iter().all(|mm| mm.is_finite()) {
            *marker = MarkerSample { id: marker.id, occluded: true, ..MarkerSample::default() };
            count += 1;
        }
    }
    count
}

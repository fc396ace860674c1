//! The two forms in which every marker stands for itself: `{id, flags, [residual], x, y, z}`.

use super::{
    OCCLUDED,
    encode::{has_position, marker_flags},
};
use crate::{device::MarkerSample, link::cursor::Cursor};

const HEAD_BYTES: usize = 2 + 1;

/// Bytes that [`put`] appends.
pub(super) fn markers_bytes(markers: &[MarkerSample], residuals: bool) -> usize {
    let present = markers.iter().filter(|marker| has_position(marker)).count();
    markers.len() * HEAD_BYTES + present * (12 + usize::from(residuals))
}

pub(super) fn put(
    markers: &[MarkerSample],
    residuals: bool,
    message: &mut Vec<u8>,
    coordinates: impl Fn([f32; 3]) -> [[u8; 4]; 3],
) {
    for marker in markers {
        let present = has_position(marker);
        message.extend_from_slice(&marker.id.to_le_bytes());
        message.push(marker_flags(present));
        if present {
            if residuals {
                message.push(marker.residual_10um);
            }
            message.extend_from_slice(coordinates(marker.position_mm).as_flattened());
        }
    }
}

/// Appends `n` markers to `markers`.
#[inline]
pub(super) fn get(
    cursor: &mut Cursor<'_>,
    n: usize,
    residuals: bool,
    markers: &mut Vec<MarkerSample>,
    coordinates: impl Fn([[u8; 4]; 3]) -> [f32; 3],
) -> Option<()> {
    let mut previous = None;
    for _ in 0..n {
        let [id_0, id_1, flags] = cursor.array::<HEAD_BYTES>()?;
        let id = u16::from_le_bytes([id_0, id_1]);
        // `None` is below every id.
        if flags & !OCCLUDED != 0 || previous >= Some(id) {
            return None;
        }
        previous = Some(id);
        let mut marker =
            MarkerSample { id, occluded: flags & OCCLUDED != 0, ..MarkerSample::default() };
        if !marker.occluded {
            if residuals {
                marker.residual_10um = cursor.u8()?;
            }
            let [x, y, z] = [cursor.array::<4>()?, cursor.array::<4>()?, cursor.array::<4>()?];
            marker.position_mm = coordinates([x, y, z]);
        }
        markers.push(marker);
    }
    Some(())
}

//! The compact form: runs of consecutive ids, a presence bit per marker, and i24 differences.
//!
//! Each difference refers to the previous marker *of the same frame*, so a lost frame affects no other.

use super::{
    super::{DELTA_UM_MAX, RUN_MARKERS_MAX},
    has_position, micrometres, millimetres,
};
use crate::{
    bytes::{Cursor, WireValue},
    device::MarkerSample,
};

/// Replaces an x difference and announces three i32: the one i24 value that no difference takes.
const ESCAPE: [u8; 3] = [0x00, 0x00, 0x80];

/// Splits `markers` (ids ascending) into runs of consecutive ids.
fn runs(markers: &[MarkerSample]) -> impl Iterator<Item = &[MarkerSample]> {
    markers.chunk_by(|a, b| b.id - a.id == 1).flat_map(|run| run.chunks(RUN_MARKERS_MAX))
}

/// Returns the difference from `from_um` to `to_um` when every axis fits, and moves `from_um` there.
fn delta(from_um: &mut [i32; 3], to_um: [i32; 3]) -> Option<[i32; 3]> {
    let [fx, fy, fz] = std::mem::replace(from_um, to_um);
    let [x, y, z] = to_um;
    let delta = [x.checked_sub(fx)?, y.checked_sub(fy)?, z.checked_sub(fz)?];
    delta.iter().all(|axis| axis.unsigned_abs() <= DELTA_UM_MAX.unsigned_abs()).then_some(delta)
}

/// Bytes that [`put`] appends.
pub(super) fn markers_bytes(markers: &[MarkerSample], residuals: bool) -> usize {
    let mut last_um = [0; 3];
    let mut bytes = 0;
    for run in runs(markers) {
        bytes += 3 + run.len().div_ceil(8);
        for marker in run.iter().filter(|marker| has_position(marker)) {
            let position_um = micrometres(marker.position_mm).unwrap_or_default();
            let position = if delta(&mut last_um, position_um).is_some() { 9 } else { 3 + 12 };
            bytes += position + usize::from(residuals);
        }
    }
    bytes
}

/// Encodes `markers`. Every position must fit into i32 micrometres.
pub(super) fn put(markers: &[MarkerSample], residuals: bool, message: &mut Vec<u8>) {
    let mut last_um = [0; 3];
    for run in runs(markers) {
        let first_id = run.first().map_or(0, |marker| marker.id);
        first_id.put(message);
        message.push(run.len() as u8);
        for octet in run.chunks(8) {
            let present = octet.iter().rev().map(|marker| u8::from(has_position(marker)));
            message.push(present.fold(0, |bits, bit| bits << 1 | bit));
        }
        for marker in run.iter().filter(|marker| has_position(marker)) {
            if residuals {
                message.push(marker.residual_10um);
            }
            let position_um = micrometres(marker.position_mm).unwrap_or_default();
            if let Some(axes) = delta(&mut last_um, position_um) {
                for axis in axes {
                    let [a, b, c, _] = axis.to_le_bytes();
                    message.extend_from_slice(&[a, b, c]);
                }
            } else {
                message.extend_from_slice(&ESCAPE);
                message.extend_from_slice(position_um.map(i32::to_le_bytes).as_flattened());
            }
        }
    }
}

/// Appends `n` markers to `markers`.
pub(super) fn get(
    cursor: &mut Cursor<'_>,
    n: usize,
    residuals: bool,
    markers: &mut Vec<MarkerSample>,
) -> Option<()> {
    let mut last_um = [0; 3];
    let mut left = n;
    // Lowest id at which the next run may start; 65536 when none is left.
    let mut id_min = 0;
    while left > 0 {
        let first_id = u32::from(cursor.get::<u16>()?);
        let len = usize::from(cursor.get::<u8>()?);
        let id_end = first_id + len as u32;
        if len == 0 || len > left || first_id < id_min || id_end > 1 << 16 {
            return None;
        }
        (left, id_min) = (left - len, id_end);
        get_run(cursor, first_id as u16, len, residuals, &mut last_um, markers)?;
    }
    Some(())
}

fn get_run(
    cursor: &mut Cursor<'_>,
    first_id: u16,
    len: usize,
    residuals: bool,
    last_um: &mut [i32; 3],
    markers: &mut Vec<MarkerSample>,
) -> Option<()> {
    let bitmap = cursor.bytes(len.div_ceil(8))?;
    let spare_bits = bitmap.len() * 8 - len;
    if bitmap.last()?.leading_zeros() < spare_bits as u32 {
        return None;
    }
    let present = bitmap.iter().flat_map(|&bits| (0..8).map(move |bit| bits >> bit & 1 == 1));
    for (index, present) in present.take(len).enumerate() {
        let id = first_id + index as u16;
        let mut marker = MarkerSample { id, occluded: !present, ..MarkerSample::default() };
        if present {
            if residuals {
                marker.residual_10um = cursor.get()?;
            }
            *last_um = get_position(cursor, *last_um)?;
            marker.position_mm = millimetres(*last_um);
        }
        markers.push(marker);
    }
    Some(())
}

#[inline]
fn get_position(cursor: &mut Cursor<'_>, [fx, fy, fz]: [i32; 3]) -> Option<[i32; 3]> {
    let x = cursor.array::<3>()?;
    if x == ESCAPE {
        let [x, y, z] = [cursor.array()?, cursor.array()?, cursor.array()?];
        return Some([x, y, z].map(i32::from_le_bytes));
    }
    let [x, y, z] = [x, cursor.array::<3>()?, cursor.array::<3>()?].map(|[a, b, c]| {
        // Into the upper three bytes, then back down with sign extension.
        i32::from_le_bytes([0, a, b, c]) >> 8
    });
    Some([fx.checked_add(x)?, fy.checked_add(y)?, fz.checked_add(z)?])
}

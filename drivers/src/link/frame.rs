//! Encoding and decoding of frames: a header, and the markers in one of three forms.
//!
//! In the compact form they are runs of consecutive ids, with a presence bit per marker and i24 differences. Each
//! difference refers to the previous marker *of the same frame*, so a lost frame affects no other.

use super::{
    DELTA_UM_MAX, ENVELOPE_BYTES, EncodeError, FRAME_HEADER_BYTES_MAX, Framer, MARKER_BYTES_MAX,
    MARKERS_MAX, RUN_MARKERS_MAX, messages::kind, wire_bytes,
};
use crate::{
    bytes::{Cursor, WireValue},
    device::{Frame, MarkerSample},
};

/// Flag of a frame: a timecode follows the header.
const TIMECODE: u8 = 1;
/// Flag of a frame: every marker with a position has a residual byte.
const RESIDUALS: u8 = 2;
/// Flag of a marker: it has no position.
const OCCLUDED: u8 = 1;

/// Encoding of the positions in a frame. Every frame names its form; a device may switch at any time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum FrameForm {
    /// f32 millimetres, bit for bit.
    Float,
    /// i32 micrometres: at most 0.5 um of rounding error, to 2147 m from the origin.
    Micrometres,
    /// Micrometres in runs of consecutive ids, each position as an i24 difference from the one before it.
    #[default]
    Compact,
}

impl FrameForm {
    fn kind(self) -> u8 {
        match self {
            Self::Float => kind::FRAME_FLOAT,
            Self::Micrometres => kind::FRAME_MICROMETRES,
            Self::Compact => kind::FRAME_COMPACT,
        }
    }
}

/// Upper bound of a frame of `n_markers` in bytes on the wire, for any positions and ids.
///
/// The three forms share one bound: a frame whose compact form would be longer, because its markers
/// lie more than 8.388607 m apart or their ids have gaps, is sent in micrometres.
#[must_use]
pub const fn frame_bytes_max(n_markers: usize) -> usize {
    wire_bytes(ENVELOPE_BYTES + FRAME_HEADER_BYTES_MAX + n_markers * MARKER_BYTES_MAX)
}

/// Upper bound of a frame of `n_markers` in bytes on the wire inside a capture volume: consecutive ids, no
/// marker more than 8.388607 m from the one before it along any axis, and the first one as near to the
/// origin.
///
/// Link budgets use this bound. Outside such a volume the bound is [`frame_bytes_max`].
#[must_use]
pub const fn frame_bytes_in_volume(form: FrameForm, n_markers: usize) -> usize {
    match form {
        FrameForm::Float | FrameForm::Micrometres => frame_bytes_max(n_markers),
        FrameForm::Compact => {
            let whole_runs = n_markers / RUN_MARKERS_MAX;
            let rest = n_markers % RUN_MARKERS_MAX;
            let run_headers = whole_runs * (3 + RUN_MARKERS_MAX.div_ceil(8))
                + if rest > 0 { 3 + rest.div_ceil(8) } else { 0 };
            let positions = n_markers * (1 + 3 * 3);
            wire_bytes(ENVELOPE_BYTES + FRAME_HEADER_BYTES_MAX + run_headers + positions)
        }
    }
}

/// Encodes `frame` into `out` in the preferred form, or in one that can represent it.
pub(super) fn put_frame(
    framer: &mut Framer,
    preferred: FrameForm,
    frame: &Frame<'_>,
    out: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    let markers = frame.markers;
    let n = checked_marker_count(markers)?;
    let residuals = markers.iter().any(|marker| has_position(marker) && marker.residual_10um > 0);
    let form = choose_form(preferred, markers, residuals);
    let message = framer.open(form.kind());
    frame.seq.put(message);
    frame.device_ticks.put(message);
    let timecode_flag = if frame.timecode.is_some() { TIMECODE } else { 0 };
    message.push(timecode_flag | if residuals { RESIDUALS } else { 0 });
    n.put(message);
    if let Some(timecode) = frame.timecode {
        message.extend_from_slice(&timecode);
    }
    match form {
        FrameForm::Float => put_plain(markers, residuals, message, |mm| mm.map(f32::to_le_bytes)),
        FrameForm::Micrometres => put_plain(markers, residuals, message, |position_mm| {
            // `choose_form` has checked that every position fits.
            micrometres(position_mm).unwrap_or_default().map(i32::to_le_bytes)
        }),
        FrameForm::Compact => put(markers, residuals, message),
    }
    framer.close(out);
    Ok(())
}

/// Whether the marker has a finite position; one without is sent as occluded.
fn has_position(marker: &MarkerSample) -> bool {
    !marker.occluded && marker.position_mm.iter().all(|mm| mm.is_finite())
}

fn checked_marker_count(markers: &[MarkerSample]) -> Result<u16, EncodeError> {
    if markers.len() > MARKERS_MAX {
        return Err(EncodeError::TooManyMarkers { found: markers.len(), max: MARKERS_MAX });
    }
    for [previous, next] in markers.array_windows() {
        if previous.id >= next.id {
            return Err(EncodeError::IdsNotAscending { previous: previous.id, id: next.id });
        }
    }
    Ok(markers.len() as u16)
}

fn choose_form(preferred: FrameForm, markers: &[MarkerSample], residuals: bool) -> FrameForm {
    if preferred == FrameForm::Float {
        return FrameForm::Float;
    }
    let mut present = markers.iter().filter(|marker| has_position(marker));
    if !present.all(|marker| micrometres(marker.position_mm).is_some()) {
        FrameForm::Float
    } else if preferred == FrameForm::Compact
        && markers_bytes(markers, residuals) <= plain_bytes(markers, residuals)
    {
        FrameForm::Compact
    } else {
        FrameForm::Micrometres
    }
}

/// Decodes a frame into `markers`, and adds the number of positions that are not finite to `not_finite`.
/// `kind` must be one of the three frame types.
pub(super) fn get_frame<'a>(
    kind: u8,
    payload: &[u8],
    markers: &'a mut Vec<MarkerSample>,
    not_finite: &mut u64,
) -> Option<Frame<'a>> {
    let mut cursor = Cursor::new(payload);
    let (seq, device_ticks) = (cursor.get()?, cursor.get()?);
    let (flags, n) = (cursor.get::<u8>()?, usize::from(cursor.get::<u16>()?));
    if flags & !(TIMECODE | RESIDUALS) != 0 || n > MARKERS_MAX {
        return None;
    }
    let timecode = if flags & TIMECODE != 0 { Some(cursor.array::<4>()?) } else { None };
    let residuals = flags & RESIDUALS != 0;
    markers.clear();
    match kind {
        kind::FRAME_FLOAT => {
            get_plain(&mut cursor, n, residuals, markers, |axes| axes.map(f32::from_le_bytes))?;
        }
        kind::FRAME_MICROMETRES => get_plain(&mut cursor, n, residuals, markers, |axes| {
            millimetres(axes.map(i32::from_le_bytes))
        })?,
        _ => get(&mut cursor, n, residuals, markers)?,
    }
    cursor.end(())?;
    if kind == kind::FRAME_FLOAT {
        *not_finite += occlude_not_finite(markers);
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

// The two plain forms, which encode every marker on its own: `{id, flags, [residual], x, y, z}`.

const PLAIN_HEADER_BYTES: usize = 2 + 1;

/// Bytes that [`put_plain`] appends.
fn plain_bytes(markers: &[MarkerSample], residuals: bool) -> usize {
    let present = markers.iter().filter(|marker| has_position(marker)).count();
    markers.len() * PLAIN_HEADER_BYTES + present * (12 + usize::from(residuals))
}

fn put_plain(
    markers: &[MarkerSample],
    residuals: bool,
    message: &mut Vec<u8>,
    coordinates: impl Fn([f32; 3]) -> [[u8; 4]; 3],
) {
    for marker in markers {
        let present = has_position(marker);
        marker.id.put(message);
        message.push(if present { 0 } else { OCCLUDED });
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
fn get_plain(
    cursor: &mut Cursor<'_>,
    n: usize,
    residuals: bool,
    markers: &mut Vec<MarkerSample>,
    coordinates: impl Fn([[u8; 4]; 3]) -> [f32; 3],
) -> Option<()> {
    let mut previous = None;
    for _ in 0..n {
        let [id_0, id_1, flags] = cursor.array::<PLAIN_HEADER_BYTES>()?;
        let id = u16::from_le_bytes([id_0, id_1]);
        // `None` compares below every id.
        if flags & !OCCLUDED != 0 || previous >= Some(id) {
            return None;
        }
        previous = Some(id);
        let mut marker = MarkerSample { id, occluded: flags & OCCLUDED != 0, ..Default::default() };
        if !marker.occluded {
            if residuals {
                marker.residual_10um = cursor.get()?;
            }
            let [x, y, z] = [cursor.array::<4>()?, cursor.array::<4>()?, cursor.array::<4>()?];
            marker.position_mm = coordinates([x, y, z]);
        }
        markers.push(marker);
    }
    Some(())
}

/// To the nearest micrometre, halves away from zero. `None` when a coordinate is outside i32.
#[inline]
fn micrometres(position_mm: [f32; 3]) -> Option<[i32; 3]> {
    let [x, y, z] = position_mm.map(|mm| {
        // An f32 times 1000 is exact in f64, and so is adding the half: truncation rounds correctly.
        let um = f64::from(mm) * 1000.0;
        (um + 0.5f64.copysign(um)) as i64
    });
    Some([i32::try_from(x).ok()?, i32::try_from(y).ok()?, i32::try_from(z).ok()?])
}

/// Millimetres as the nearest f32.
#[inline]
fn millimetres(position_um: [i32; 3]) -> [f32; 3] {
    position_um.map(|um| (f64::from(um) / 1000.0) as f32)
}

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
fn markers_bytes(markers: &[MarkerSample], residuals: bool) -> usize {
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
fn put(markers: &[MarkerSample], residuals: bool, message: &mut Vec<u8>) {
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
fn get(
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_to_the_nearest_micrometre() {
        assert_eq!(micrometres([0.0005, -0.0005, 0.000_499]), Some([1, -1, 0]));
        assert_eq!(micrometres([1234.567, -0.0, 1e-30]), Some([1_234_567, 0, 0]));
        assert_eq!(
            micrometres([2_147_483.5, -2_147_483.5, 0.0]),
            Some([2_147_483_500, -2_147_483_500, 0])
        );
    }

    #[test]
    fn a_coordinate_outside_i32_micrometres_is_none() {
        assert_eq!(micrometres([2_147_484.0, 0.0, 0.0]), None);
        assert_eq!(micrometres([0.0, 0.0, -3.0e38]), None);
    }

    #[test]
    fn round_trips_within_half_a_micrometre_plus_f32_precision() {
        for mm in [0.0f32, 0.001, 999.999, -4321.1235, 8000.0005] {
            let back = millimetres(micrometres([mm; 3]).unwrap())[0];
            assert!(
                (back - mm).abs() <= 0.0005 + mm.abs() * f32::EPSILON,
                "{mm} came back as {back}"
            );
        }
    }
}

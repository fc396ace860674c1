//! Writing a frame: checks, header, and the form that fits.

use super::{FrameForm, OCCLUDED, RESIDUALS, TIMECODE, compact, plain, position::micrometres};
use crate::{
    device::{Frame, MarkerSample},
    link::{EncodeError, MARKERS_MAX, envelope::Framer},
};

/// Writes `frame` to `out` in the wanted form, or in the one that can say it.
pub(in crate::link) fn put_frame(
    framer: &mut Framer,
    wanted: FrameForm,
    frame: &Frame<'_>,
    out: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    let n = checked_count(frame.markers)?;
    let residuals =
        frame.markers.iter().any(|marker| has_position(marker) && marker.residual_10um > 0);
    let form = form_that_fits(wanted, frame.markers, residuals);
    let message = framer.open(form.kind());
    message.extend_from_slice(&frame.seq.to_le_bytes());
    message.extend_from_slice(&frame.device_ticks.to_le_bytes());
    let timecode_flag = if frame.timecode.is_some() { TIMECODE } else { 0 };
    message.push(timecode_flag | if residuals { RESIDUALS } else { 0 });
    message.extend_from_slice(&n.to_le_bytes());
    if let Some(timecode) = frame.timecode {
        message.extend_from_slice(&timecode);
    }
    match form {
        FrameForm::Float => plain::put(frame.markers, residuals, message, |position_mm| {
            position_mm.map(f32::to_le_bytes)
        }),
        FrameForm::Micrometres => plain::put(frame.markers, residuals, message, |position_mm| {
            // Every position fits: form_that_fits saw to it.
            micrometres(position_mm).unwrap_or_default().map(i32::to_le_bytes)
        }),
        FrameForm::Compact => compact::put(frame.markers, residuals, message),
    }
    framer.close(out);
    Ok(())
}

/// A position that is not finite is none: it travels as occluded.
pub(super) fn has_position(marker: &MarkerSample) -> bool {
    !marker.occluded && marker.position_mm.iter().all(|mm| mm.is_finite())
}

fn checked_count(markers: &[MarkerSample]) -> Result<u16, EncodeError> {
    if markers.len() > MARKERS_MAX {
        return Err(EncodeError::TooManyMarkers { found: markers.len(), max: MARKERS_MAX });
    }
    for pair in markers.windows(2) {
        if let [previous, next] = pair
            && previous.id >= next.id
        {
            return Err(EncodeError::IdsNotAscending { previous: previous.id, id: next.id });
        }
    }
    Ok(markers.len() as u16)
}

fn form_that_fits(wanted: FrameForm, markers: &[MarkerSample], residuals: bool) -> FrameForm {
    if wanted == FrameForm::Float {
        return FrameForm::Float;
    }
    let all_fit = markers
        .iter()
        .all(|marker| !has_position(marker) || micrometres(marker.position_mm).is_some());
    if !all_fit {
        FrameForm::Float
    } else if wanted == FrameForm::Compact
        && compact::markers_bytes(markers, residuals) <= plain::markers_bytes(markers, residuals)
    {
        FrameForm::Compact
    } else {
        FrameForm::Micrometres
    }
}

/// The flags byte of a marker.
pub(super) fn marker_flags(has_position: bool) -> u8 {
    if has_position { 0 } else { OCCLUDED }
}

//! Frames on the wire: one header, and the markers in one of three forms.

mod compact;
mod decode;
mod encode;
mod plain;
mod position;

pub(super) use decode::get_frame;
pub(super) use encode::put_frame;

use super::{
    kind,
    limits::{
        ENVELOPE_BYTES, FRAME_HEADER_BYTES_MAX, MARKER_BYTES_MAX, RUN_MARKERS_MAX, wire_bytes,
    },
};

/// Set in a frame's flags when a timecode follows the header.
const TIMECODE: u8 = 1;
/// Set in a frame's flags when every marker with a position has a residual byte.
const RESIDUALS: u8 = 2;
/// Set in a marker's flags when it has no position.
const OCCLUDED: u8 = 1;

/// How the positions of a frame travel. Every frame says which; a device may change it at any time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum FrameForm {
    /// f32 millimetres, bit for bit.
    Float,
    /// i32 micrometres: 0.5 um off at most, to 2147 m from the origin.
    Micrometres,
    /// Micrometres, in runs of consecutive ids, each marker as i24 from the one before it.
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

/// Bytes on the wire that no frame of `n_markers` exceeds, whatever its positions and ids.
///
/// The three forms share one bound: a frame whose compact form would be longer, because its markers
/// lie more than 8.388607 m apart or their ids have gaps, is sent in micrometres.
#[must_use]
pub const fn frame_bytes_max(n_markers: usize) -> usize {
    wire_bytes(ENVELOPE_BYTES + FRAME_HEADER_BYTES_MAX + n_markers * MARKER_BYTES_MAX)
}

/// Bytes on the wire that no frame of `n_markers` exceeds inside a capture volume: with consecutive
/// ids, no marker more than 8.388607 m from the one before it along any axis, and the first one as
/// near to the origin.
///
/// This is what a link budget needs. Outside such a volume the bound is [`frame_bytes_max`].
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

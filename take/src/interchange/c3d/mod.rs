//! C3D, the binary format of biomechanics (The C3D File Format: User Guide, Motion Lab Systems, 2021).
//!
//! Read: Intel, DEC and MIPS files, integers and floats, more points than a LABELS parameter holds, more frames
//! than 16 bits count, and files whose parameter section is damaged, as far as they make sense. Written: Intel,
//! floats, millimetres.

use super::InterchangeError;

mod analog;
mod body;
mod bytes;
mod columns;
mod events;
mod foreign;
mod frame_count;
mod gap_coordinates;
mod header;
mod labels;
mod layout;
mod parameters;
mod read;
mod section;
mod stride;
mod subjects;
mod write;

pub(super) use events::EVENTS_MAX;
pub(super) use foreign::{MODEL_OUTPUTS, turn};
pub(super) use read::read;
pub(super) use write::write;

/// What cannot be read.
fn malformed(place: impl Into<String>, message: impl Into<String>) -> InterchangeError {
    InterchangeError::Malformed { format: "c3d", place: place.into(), message: message.into() }
}

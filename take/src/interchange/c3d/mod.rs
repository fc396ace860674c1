//! C3D, the binary format of biomechanics (The C3D File Format: User Guide, Motion Lab Systems, 2021).
//!
//! Read: Intel, DEC and MIPS files, integers and floats, more points than a LABELS parameter holds, more frames
//! than 16 bits count, and files whose parameter section is damaged, as far as they make sense. Written: Intel,
//! floats, millimetres.

mod columns;
mod events;
mod foreign;
mod frames;
mod gap_coordinates;
mod header;
mod layout;
mod parameters;
mod read;
mod stride;
mod write;

use super::InterchangeError;

pub(super) use events::EVENTS_MAX;
pub(super) use foreign::{MODEL_OUTPUTS, turn};
pub(super) use read::read;
pub(super) use write::write;

/// Version of the layouts in which a take keeps what is not a trajectory (`docs/foreign.md`).
const VERSION: u8 = 1;

/// What cannot be read.
fn malformed(place: &str, message: impl Into<String>) -> InterchangeError {
    InterchangeError::malformed("c3d", place, message)
}

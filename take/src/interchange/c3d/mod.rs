//! C3D, the binary format of biomechanics (The C3D File Format: User Guide, Motion Lab Systems, 2021).
//!
//! The reader accepts Intel, DEC and MIPS files with integer or float samples, more points than one LABELS parameter
//! holds, more frames than 16 bits count, and files with a partly damaged parameter section. The writer produces Intel
//! files with float samples in millimetres.

mod columns;
mod events;
mod foreign;
mod frames;
mod gap_coordinates;
mod header;
mod layout;
mod parameters;
mod read;
pub(crate) mod sample_parts;
mod stride;
mod write;

use super::InterchangeError;

pub(super) use events::EVENTS_MAX;
pub(super) use foreign::{MODEL_OUTPUTS, rotate};
pub(super) use read::read;
pub(super) use write::write;

/// Version of the layouts of the foreign parts (`docs/foreign.md`).
const VERSION: u8 = 1;

fn malformed(place: &str, message: impl Into<String>) -> InterchangeError {
    InterchangeError::malformed("c3d", place, message)
}

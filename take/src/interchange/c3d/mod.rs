//! C3D, the binary format of biomechanics (The C3D File Format: User Guide, Motion Lab Systems, 2021).
//!
//! The reader holds a few blocks of frames at a time, whatever the size of the file. It accepts Intel, DEC and MIPS
//! files with integer or float samples, more points than one LABELS parameter holds, more frames than 16 bits count, and
//! files with a partly damaged parameter section. The writer produces Intel files with float samples in millimetres.

mod analog;
pub(crate) mod columns;
mod events;
mod foreign;
mod frames;
mod gap_coordinates;
mod header;
mod layout;
mod marker_order;
mod parameters;
mod read;
mod recorded;
mod rotations;
pub(crate) mod sample_parts;
mod stride;
mod write;

use super::InterchangeError;

pub use analog::AnalogChannel;
pub(crate) use analog::{
    channels as analog_channels, describe as describe_sampled, factor_of_unit,
    plates as force_plates,
};
pub(super) use columns::MODEL_OUTPUTS;
pub(crate) use columns::{ANALOG, value as sample_value};
pub(super) use events::EVENTS_MAX;
pub(super) use foreign::rotate;
pub(crate) use foreign::{PARAMETERS, PartSamples, kept_parameters};
pub(crate) use marker_order::{is_by_marker, reordered};
pub use parameters::{C3dParameter, C3dValues};
pub(crate) use parameters::{Parameters, is_unsigned as is_analog_unsigned, parameter_values};
pub(super) use read::{C3dFrames, open};
pub(super) use recorded::{RecordedPlan, name_of, warnings_of};
pub(crate) use stride::ANALOG_MAX;
pub(super) use write::write;

/// Version of the layouts of the foreign parts (`docs/foreign.md`).
const VERSION: u8 = 1;

fn malformed(place: &str, message: impl Into<String>) -> InterchangeError {
    InterchangeError::malformed("c3d", place, message)
}

//! The DVMC-style link protocol, sans-io: both ends.
//!
//! The bytes are described in `docs/link-protocol.md`. The protocol is our own.

mod budget;
mod cursor;
mod device;
mod envelope;
mod error;
mod frame;
mod host;
mod kind;
mod limits;
mod records;

pub use budget::{RESERVE_BYTES_PER_S, link_budget};
pub use device::DeviceLink;
pub use error::EncodeError;
pub use frame::{FrameForm, frame_bytes_in_volume, frame_bytes_max};
pub use host::HostLink;
pub use limits::{
    COMMAND_WIRE_BYTES_MAX, DELTA_UM_MAX, ENVELOPE_BYTES, FRAME_HEADER_BYTES_MAX, LABEL_BYTES_MAX,
    LINK_VERSION, MARKER_BYTES_MAX, MARKERS_MAX, MARKERS_MESSAGE_BYTES_MAX, MESSAGE_BYTES_MAX,
    RUN_MARKERS_MAX, TEXT_BYTES_MAX, WIRE_BYTES_MAX,
};

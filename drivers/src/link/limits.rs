//! The protocol's limits. Every buffer of the link is bounded by one of these.

/// The version byte that this build writes and reads.
pub const LINK_VERSION: u8 = 1;

/// Version, type and CRC-32 around every payload.
pub const ENVELOPE_BYTES: usize = 1 + 1 + 4;

/// Markers in one frame, and in a device's table.
///
/// Ten times the largest rigs known (a dense face or an unlabelled cloud is below 1000).
pub const MARKERS_MAX: usize = 10_000;

/// Sequence number, ticks, flags, marker count, timecode.
pub const FRAME_HEADER_BYTES_MAX: usize = 4 + 8 + 1 + 2 + 4;

/// Id, flags, residual, three 32-bit coordinates.
pub const MARKER_BYTES_MAX: usize = 2 + 1 + 1 + 3 * 4;

/// The largest message before COBS: a frame of [`MARKERS_MAX`] markers, 160 025 bytes.
pub const MESSAGE_BYTES_MAX: usize =
    ENVELOPE_BYTES + FRAME_HEADER_BYTES_MAX + MARKERS_MAX * MARKER_BYTES_MAX;

/// The largest message on the wire, its closing 0x00 included: one more byte for every 254.
pub const WIRE_BYTES_MAX: usize = wire_bytes(MESSAGE_BYTES_MAX);

/// Bytes of a model, serial number or firmware version (UTF-8).
pub const TEXT_BYTES_MAX: usize = 64;

/// Bytes of a marker's label (UTF-8): its length is one byte.
pub const LABEL_BYTES_MAX: usize = 255;

/// The longest Markers message before COBS; a table that needs more is sent in several.
///
/// A marker takes 4 + 255 bytes at most, so at least three fit; a message of this size keeps the
/// line for 3.5 ms at 3 Mbaud.
pub const MARKERS_MESSAGE_BYTES_MAX: usize = 1024;

/// The longest run of consecutive ids in a compact frame: its length is one byte.
pub const RUN_MARKERS_MAX: usize = 255;

/// The largest delta of a compact frame, in micrometres: i24 without the value that marks an escape.
pub const DELTA_UM_MAX: i32 = (1 << 23) - 1;

/// What a device keeps of bytes that may become a command.
///
/// The longest command of version 1 is Ping, 16 bytes on the wire. The rest is room for commands to
/// come, so that an older device counts them as unknown and not as damage.
pub const COMMAND_WIRE_BYTES_MAX: usize = 64;

/// Bytes on the wire of a message of `message_bytes`, at most, its closing 0x00 included.
pub(crate) const fn wire_bytes(message_bytes: usize) -> usize {
    cobs::max_encoding_length(message_bytes) + 1
}

const _: () = assert!(MESSAGE_BYTES_MAX == 160_025);
const _: () = assert!(MARKERS_MESSAGE_BYTES_MAX >= ENVELOPE_BYTES + 2 + 3 * (4 + LABEL_BYTES_MAX));

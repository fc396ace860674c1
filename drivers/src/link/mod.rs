//! The DVMC family and the link protocol of `docs/link-protocol.md`: both ends, sans-io.
//!
//! The DVMC-8820 has no public wire specification. This protocol is mocapd's own, in the style of such a
//! rig, and the simulator speaks it.

mod endpoints;
mod frame;
mod messages;

use crate::{
    bytes::WireValue,
    device::{Claim, Family, LinkBudget, LinkCounters},
    uri::Location,
};
pub use endpoints::{DeviceLink, HostLink};
pub use frame::{FrameForm, frame_bytes_in_volume, frame_bytes_max};
pub use messages::{batch_bytes_max, pose_frame_bytes_max};

pub(crate) const FAMILY: Family = Family {
    name: "dvmc",
    claims: |candidate| {
        if matches!(candidate.location, Location::Network(_) | Location::Streams(_)) {
            // Its scheme is its protocol, whatever it calls itself.
            Claim::No
        } else if candidate.name_matches(|name| name.contains("dvmc") || name.contains("mocapd")) {
            Claim::Certain
        } else if candidate.is_serial() {
            // A plain adapter does not reveal the device that is connected to it.
            Claim::Possible
        } else {
            Claim::No
        }
    },
    protocol: |_| Box::new(HostLink::new()),
};

// These constants bound every buffer of the link.

/// Protocol version that this build writes and reads.
pub const LINK_VERSION: u8 = 1;

/// Bytes around every payload: version, type and CRC-32.
pub const ENVELOPE_BYTES: usize = 1 + 1 + 4;

/// Maximum number of markers in a frame, and in a device's table.
///
/// Ten times the largest rigs known: a dense face or an unlabelled cloud stays below 1000.
pub const MARKERS_MAX: usize = 10_000;

/// Longest frame header: sequence number, ticks, flags, marker count, timecode.
pub const FRAME_HEADER_BYTES_MAX: usize = 4 + 8 + 1 + 2 + 4;

/// Maximum number of bytes of a marker in a frame: id, flags, residual, three 32-bit coordinates.
pub const MARKER_BYTES_MAX: usize = 2 + 1 + 1 + 3 * 4;

/// The largest message before COBS: a frame of [`MARKERS_MAX`] markers, 160 025 bytes.
pub const MESSAGE_BYTES_MAX: usize =
    ENVELOPE_BYTES + FRAME_HEADER_BYTES_MAX + MARKERS_MAX * MARKER_BYTES_MAX;

/// The largest message on the wire with its closing 0x00: COBS adds one byte for every 254.
pub const WIRE_BYTES_MAX: usize = wire_bytes(MESSAGE_BYTES_MAX);

/// Maximum number of bytes of a model, serial number or firmware version (UTF-8).
pub const TEXT_BYTES_MAX: usize = 64;

/// Maximum number of bytes of a marker's label (UTF-8): its length is one byte.
pub const LABEL_BYTES_MAX: usize = 255;

/// The longest Markers message before COBS. Longer tables are split.
///
/// A marker takes 4 + 255 bytes at most, so at least three fit. A message of this size occupies a line of
/// 3 Mbaud for 3.5 ms.
pub const MARKERS_MESSAGE_BYTES_MAX: usize = 1024;

/// Maximum number of groups of sampled channels of a device: its force plates, electrodes and inertial sensors, of
/// several rates and of more than 64 channels.
pub const GROUPS_MAX: usize = 16;

/// Maximum number of channels of a group: those that are encoded together.
pub const SAMPLED_CHANNELS_MAX: usize = 64;

/// Maximum number of samples of a group in a second, those of all channels: six times 64 electrodes at 10 kHz. It
/// bounds the memory for the samples of two seconds.
pub const SAMPLE_VALUES_PER_S_MAX: u64 = 4_000_000;

/// Maximum number of samples of a batch, those of all channels: 25 ms of 64 channels at 10 kHz. A batch is then
/// shorter than a frame may be.
pub const SAMPLE_VALUES_MAX: usize = 1 << 14;

/// Maximum number of bytes of a channel's unit (UTF-8).
pub const UNIT_BYTES_MAX: usize = 32;

/// Maximum number of force plates of a device: a walkway of a laboratory has at most twelve.
pub const PLATES_MAX: usize = 32;

/// What precedes the samples of a batch: group, form, channels, samples, number, first sample, ticks.
pub const SAMPLES_HEADER_BYTES: usize = 1 + 1 + 1 + 2 + 4 + 8 + 8;

/// What precedes the poses of a frame: its number, that of the message, ticks, number of poses.
pub const POSES_HEADER_BYTES: usize = 4 + 4 + 8 + 2;

/// Maximum number of bytes of a pose: body, status, position, quaternion, residual.
pub const POSE_BYTES_MAX: usize = 2 + 1 + 3 * 4 + 4 * 4 + 4;

const _: () = assert!(SAMPLES_HEADER_BYTES + 4 * SAMPLE_VALUES_MAX < MESSAGE_BYTES_MAX);

/// The longest run of consecutive ids in a compact frame: its length is one byte.
pub const RUN_MARKERS_MAX: usize = 255;

/// The largest delta of a compact frame, in micrometres: i24 without the value that marks an escape.
pub const DELTA_UM_MAX: i32 = (1 << 23) - 1;

/// Size of a device's receive buffer for commands.
///
/// The longest command of version 1 is Ping, 16 bytes on the wire. The rest is reserved for future
/// commands, which an older device then counts as unknown and not as damage.
pub const COMMAND_WIRE_BYTES_MAX: usize = 64;

/// Maximum number of bytes on the wire of a message of `message_bytes`, its closing 0x00 included.
pub(crate) const fn wire_bytes(message_bytes: usize) -> usize {
    cobs::max_encoding_length(message_bytes) + 1
}

const _: () = assert!(MESSAGE_BYTES_MAX == 160_025);
const _: () = assert!(MARKERS_MESSAGE_BYTES_MAX >= ENVELOPE_BYTES + 2 + 3 * (4 + LABEL_BYTES_MAX));

/// Reasons why a message was not encoded. Nothing was appended to the output.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// The frame or table has too many markers.
    #[error("{found} markers exceed the link's limit of {max}: send fewer")]
    TooManyMarkers {
        /// Markers in the frame or table.
        found: usize,
        /// [`MARKERS_MAX`].
        max: usize,
    },
    /// A frame lists an id twice, or not in ascending order.
    #[error(
        "marker {id} follows marker {previous}: sort a frame's markers by id, without duplicates"
    )]
    IdsNotAscending {
        /// Id before it.
        previous: u16,
        /// Id that should have been larger.
        id: u16,
    },
    /// A text is too long or contains control characters.
    #[error("{field} '{text}' cannot be sent: use at most {bytes_max} bytes and no control characters", text = text.escape_debug())]
    Text {
        /// `label`, `model`, `serial` or `firmware`.
        field: &'static str,
        /// The text.
        text: String,
        /// Maximum number of bytes that fit.
        bytes_max: usize,
    },
    /// The group cannot be announced.
    #[error("invalid group of sampled channels: {0}")]
    SampledGroup(&'static str),
    /// The force plate cannot be announced.
    #[error("invalid force plate: {0}")]
    ForcePlate(&'static str),
    /// The batch cannot be sent.
    #[error("invalid batch of samples: {0}")]
    Samples(&'static str),
    /// The table of bodies cannot be sent.
    #[error("invalid table of bodies: {0}")]
    Bodies(&'static str),
    /// The poses cannot be sent.
    #[error("invalid poses: {0}")]
    Poses(&'static str),
    /// The values of the Hello are invalid.
    #[error("invalid hello: {0}")]
    Hello(&'static str),
}

/// Bytes per second that a link budget reserves for messages other than frames.
///
/// A Status (26 bytes), ten Pongs (24 each) and thirty trigger edges (18 each) per second are 806 bytes;
/// the rest is for Markers that appear.
pub const RESERVE_BYTES_PER_S: u64 = 1024;

/// Computes the link budget of frames of `frame_bytes` on the wire at `rate_millihertz` beside sampled channels that
/// need `samples_bytes_per_s`, and the highest rate up to `rate_max_millihertz` that fits the line, in millihertz (0 when
/// none does).
///
/// A `line_bytes_per_s` of 0 means a line without a limit.
#[must_use]
pub fn link_budget(
    frame_bytes: usize,
    rate_millihertz: u32,
    rate_max_millihertz: u32,
    samples_bytes_per_s: u64,
    line_bytes_per_s: u64,
) -> LinkBudget {
    let frame_bytes = u128::from(frame_bytes.max(1) as u64);
    let needed = (frame_bytes * u128::from(rate_millihertz)).div_ceil(1000);
    let others = RESERVE_BYTES_PER_S.saturating_add(samples_bytes_per_s);
    let needed = u64::try_from(needed).unwrap_or(u64::MAX).saturating_add(others);
    let available = if line_bytes_per_s == 0 { u64::MAX } else { line_bytes_per_s };
    let for_frames = u128::from(available.saturating_sub(others));
    let fits_millihertz = u32::try_from(for_frames * 1000 / frame_bytes).unwrap_or(u32::MAX);
    LinkBudget {
        needed_bytes_per_s: needed,
        available_bytes_per_s: available,
        rate_fits_millihertz: fits_millihertz.min(rate_max_millihertz),
    }
}

/// Result of decoding a message whose checksum was correct.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum DecodeOutcome {
    /// Decoded and passed on.
    Decoded,
    /// Known type, invalid payload.
    Damaged,
    /// Type or version unknown to this end.
    Unknown,
}

impl From<Option<()>> for DecodeOutcome {
    fn from(decoded: Option<()>) -> Self {
        if decoded.is_some() { Self::Decoded } else { Self::Damaged }
    }
}

/// Encodes messages into envelopes. Reuses its memory from message to message.
#[derive(Debug, Default)]
struct Framer {
    message: Vec<u8>,
}

impl Framer {
    /// Starts a message and returns the buffer to append the payload to.
    fn open(&mut self, kind: u8) -> &mut Vec<u8> {
        self.message.clear();
        self.message.extend_from_slice(&[LINK_VERSION, kind]);
        &mut self.message
    }

    /// Ends the message: appends its checksum and writes it to `out` in COBS with a closing 0x00.
    fn close(&mut self, out: &mut Vec<u8>) {
        let crc = crc32fast::hash(&self.message);
        self.message.extend_from_slice(&crc.to_le_bytes());
        let start = out.len();
        out.resize(start + cobs::max_encoding_length(self.message.len()), 0);
        let n = cobs::encode(&self.message, &mut out[start..]);
        out.truncate(start + n);
        out.push(0);
    }

    /// Encodes a whole message.
    fn write(&mut self, kind: u8, payload: impl WireValue, out: &mut Vec<u8>) {
        payload.put(self.open(kind));
        self.close(out);
    }
}

/// Finds messages in a byte stream and counts the bytes that belong to none.
#[derive(Debug)]
struct Deframer {
    /// Bytes since the last 0x00.
    pending: Vec<u8>,
    pending_bytes_max: usize,
    /// Whether the bytes since the last 0x00 exceed the longest message, and are already counted as skipped.
    overlong: bool,
    counters: LinkCounters,
}

impl Deframer {
    /// Buffers at most `wire_bytes_max` bytes, the closing 0x00 included.
    fn new(wire_bytes_max: usize) -> Self {
        Self {
            pending: Vec::with_capacity(wire_bytes_max),
            pending_bytes_max: wire_bytes_max - 1,
            overlong: false,
            counters: LinkCounters::default(),
        }
    }

    /// Splits `bytes` at 0x00 and calls `on_message` with type and payload of every message with a correct checksum.
    fn push(&mut self, mut bytes: &[u8], mut on_message: impl FnMut(u8, &[u8]) -> DecodeOutcome) {
        self.counters.bytes += bytes.len() as u64;
        while let Some(end) = bytes.iter().position(|&byte| byte == 0) {
            let (piece, rest) = bytes.split_at(end);
            self.buffer(piece);
            self.end_of_segment(&mut on_message);
            bytes = rest.get(1..).unwrap_or_default();
        }
        self.buffer(bytes);
    }

    fn buffer(&mut self, piece: &[u8]) {
        if self.overlong {
            self.counters.bytes_skipped += piece.len() as u64;
        } else if self.pending.len() + piece.len() > self.pending_bytes_max {
            self.counters.bytes_skipped += (self.pending.len() + piece.len()) as u64;
            self.pending.clear();
            self.overlong = true;
        } else {
            self.pending.extend_from_slice(piece);
        }
    }

    /// Decodes the segment that a 0x00 ended.
    fn end_of_segment(&mut self, on_message: &mut impl FnMut(u8, &[u8]) -> DecodeOutcome) {
        let wire_bytes = self.pending.len() as u64 + 1;
        if std::mem::take(&mut self.overlong) {
            self.counters.messages_damaged += 1;
            self.counters.bytes_skipped += 1;
            return;
        }
        if self.pending.is_empty() {
            return;
        }
        let outcome = match decode_segment(&mut self.pending) {
            Some((LINK_VERSION, kind, payload)) => on_message(kind, payload),
            Some(_) => DecodeOutcome::Unknown,
            None => DecodeOutcome::Damaged,
        };
        self.pending.clear();
        match outcome {
            DecodeOutcome::Decoded => self.counters.messages += 1,
            DecodeOutcome::Unknown => self.counters.messages_unknown += 1,
            DecodeOutcome::Damaged => {
                self.counters.messages_damaged += 1;
                self.counters.bytes_skipped += wire_bytes;
            }
        }
    }
}

/// Returns version, type and payload when the COBS encoding and the checksum are valid.
fn decode_segment(segment: &mut [u8]) -> Option<(u8, u8, &[u8])> {
    let n = cobs::decode_in_place(segment).ok()?;
    let message = segment.get(..n).filter(|message| message.len() >= ENVELOPE_BYTES)?;
    let (body, crc) = message.split_last_chunk::<4>()?;
    if crc32fast::hash(body) != u32::from_le_bytes(*crc) {
        return None;
    }
    let (&[version, kind], payload) = body.split_first_chunk::<2>()?;
    Some((version, kind, payload))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_highest_fitting_rate_fits_and_the_next_does_not() {
        for line in [11_520u64, 92_160, 300_000, 1_200_000] {
            for (frame_bytes, samples) in [(64, 0), (559, 7_000), (2104, 9_000)] {
                let fits =
                    link_budget(frame_bytes, 1, u32::MAX, samples, line).rate_fits_millihertz;
                assert!(link_budget(frame_bytes, fits, u32::MAX, samples, line).fits());
                assert!(!link_budget(frame_bytes, fits + 1, u32::MAX, samples, line).fits());
            }
        }
    }

    #[test]
    fn the_document_states_the_budget_of_40_and_of_200_markers() {
        for (n_markers, frame_bytes, rate_fits_hz) in [(40, 436, 685), (200, 2063, 144)] {
            assert_eq!(frame_bytes_in_volume(FrameForm::Compact, n_markers), frame_bytes);
            let budget = link_budget(frame_bytes, 60_000, 1_000_000, 0, 300_000);
            assert_eq!(budget.rate_fits_millihertz / 1000, rate_fits_hz);
        }
    }

    #[test]
    fn an_unlimited_line_carries_the_highest_rate() {
        let budget = link_budget(160_657, 1_000_000, 1_000_000, 0, 0);
        assert!(budget.fits());
        assert_eq!(budget.available_bytes_per_s, u64::MAX);
        assert_eq!(budget.rate_fits_millihertz, 1_000_000);
    }

    #[test]
    fn a_line_below_the_reserve_fits_no_rate() {
        let budget = link_budget(100, 60_000, 1_000_000, 0, 960);
        assert!(!budget.fits());
        assert_eq!(budget.rate_fits_millihertz, 0);
    }
}

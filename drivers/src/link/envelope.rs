//! The envelope of every message: `{version, type, payload, CRC-32}` in COBS, ended by 0x00.

use super::{ENVELOPE_BYTES, LINK_VERSION};
use crate::{bytes::WireValue, device::LinkCounters};

/// Result of decoding a message whose checksum was correct.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum DecodeOutcome {
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
pub(super) struct Framer {
    message: Vec<u8>,
}

impl Framer {
    /// Starts a message and returns the buffer to append the payload to.
    pub(super) fn open(&mut self, kind: u8) -> &mut Vec<u8> {
        self.message.clear();
        self.message.extend_from_slice(&[LINK_VERSION, kind]);
        &mut self.message
    }

    /// Ends the message: appends its checksum and writes it to `out` in COBS with a closing 0x00.
    pub(super) fn close(&mut self, out: &mut Vec<u8>) {
        let crc = crc32fast::hash(&self.message);
        self.message.extend_from_slice(&crc.to_le_bytes());
        let start = out.len();
        out.resize(start + cobs::max_encoding_length(self.message.len()), 0);
        let n = cobs::encode(&self.message, &mut out[start..]);
        out.truncate(start + n);
        out.push(0);
    }

    /// Encodes a whole message.
    pub(super) fn write(&mut self, kind: u8, payload: impl WireValue, out: &mut Vec<u8>) {
        payload.put(self.open(kind));
        self.close(out);
    }
}

/// Finds messages in a byte stream and counts the bytes that belong to none.
#[derive(Debug)]
pub(super) struct Deframer {
    /// Bytes since the last 0x00.
    pending: Vec<u8>,
    pending_bytes_max: usize,
    /// Whether the bytes since the last 0x00 exceed the longest message, and are already counted as skipped.
    overlong: bool,
    pub(super) counters: LinkCounters,
}

impl Deframer {
    /// Buffers at most `wire_bytes_max` bytes, the closing 0x00 included.
    pub(super) fn new(wire_bytes_max: usize) -> Self {
        Self {
            pending: Vec::with_capacity(wire_bytes_max),
            pending_bytes_max: wire_bytes_max - 1,
            overlong: false,
            counters: LinkCounters::default(),
        }
    }

    /// Splits `bytes` at 0x00 and calls `on_message` with type and payload of every message with a correct checksum.
    pub(super) fn push(
        &mut self,
        mut bytes: &[u8],
        mut on_message: impl FnMut(u8, &[u8]) -> DecodeOutcome,
    ) {
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

//! The envelope of every message: `{version, type, payload, CRC-32}`, COBS, a closing 0x00.

use super::{ENVELOPE_BYTES, LINK_VERSION};
use crate::{bytes::Wire, device::LinkCounters};

/// What became of a message whose checksum was right.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Understood, and handed on.
    Decoded,
    /// A known type whose payload cannot be one.
    Damaged,
    /// A type that this side does not know.
    Unknown,
}

/// Writes messages. Keeps its memory from one to the next.
#[derive(Debug, Default)]
pub(super) struct Framer {
    message: Vec<u8>,
}

impl Framer {
    /// Starts a message; the payload is appended to what this gives.
    pub(super) fn open(&mut self, kind: u8) -> &mut Vec<u8> {
        self.message.clear();
        self.message.extend_from_slice(&[LINK_VERSION, kind]);
        &mut self.message
    }

    /// Closes the message, and appends it to `out` as it goes on the wire.
    pub(super) fn close(&mut self, out: &mut Vec<u8>) {
        let crc = crc32fast::hash(&self.message);
        self.message.extend_from_slice(&crc.to_le_bytes());
        let start = out.len();
        out.resize(start + cobs::max_encoding_length(self.message.len()), 0);
        let n = cobs::encode(&self.message, &mut out[start..]);
        out.truncate(start + n);
        out.push(0);
    }

    /// A whole message at once.
    pub(super) fn write(&mut self, kind: u8, payload: impl Wire, out: &mut Vec<u8>) {
        payload.put(self.open(kind));
        self.close(out);
    }
}

/// Finds messages in bytes that arrive in pieces of any size, and counts what is none.
#[derive(Debug)]
pub(super) struct Deframer {
    /// What arrived since the last 0x00.
    pending: Vec<u8>,
    pending_bytes_max: usize,
    /// What arrived since the last 0x00 was too long for a message, and is counted already.
    overlong: bool,
    pub(super) counters: LinkCounters,
}

impl Deframer {
    /// Keeps at most `wire_bytes_max` bytes, the closing 0x00 included.
    pub(super) fn new(wire_bytes_max: usize) -> Self {
        Self {
            pending: Vec::with_capacity(wire_bytes_max),
            pending_bytes_max: wire_bytes_max - 1,
            overlong: false,
            counters: LinkCounters::default(),
        }
    }

    /// `on_message` gets the type and the payload of every message whose checksum is right.
    pub(super) fn push(
        &mut self,
        mut bytes: &[u8],
        mut on_message: impl FnMut(u8, &[u8]) -> Verdict,
    ) {
        self.counters.bytes += bytes.len() as u64;
        while let Some(end) = bytes.iter().position(|&byte| byte == 0) {
            let (piece, rest) = bytes.split_at(end);
            self.keep(piece);
            self.end_of_segment(&mut on_message);
            bytes = rest.get(1..).unwrap_or_default();
        }
        self.keep(bytes);
    }

    fn keep(&mut self, piece: &[u8]) {
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

    /// Called at a 0x00.
    fn end_of_segment(&mut self, on_message: &mut impl FnMut(u8, &[u8]) -> Verdict) {
        let wire_bytes = self.pending.len() as u64 + 1;
        if std::mem::take(&mut self.overlong) {
            self.counters.messages_damaged += 1;
            self.counters.bytes_skipped += 1;
            return;
        }
        if self.pending.is_empty() {
            return;
        }
        let verdict = match open(&mut self.pending) {
            Some((LINK_VERSION, kind, payload)) => on_message(kind, payload),
            Some(_) => Verdict::Unknown,
            None => Verdict::Damaged,
        };
        self.pending.clear();
        match verdict {
            Verdict::Decoded => self.counters.messages += 1,
            Verdict::Unknown => self.counters.messages_unknown += 1,
            Verdict::Damaged => {
                self.counters.messages_damaged += 1;
                self.counters.bytes_skipped += wire_bytes;
            }
        }
    }
}

/// Version, type and payload, when the checksum is right.
fn open(segment: &mut [u8]) -> Option<(u8, u8, &[u8])> {
    let n = cobs::decode_in_place(segment).ok()?;
    let message = segment.get(..n).filter(|message| message.len() >= ENVELOPE_BYTES)?;
    let (body, crc) = message.split_last_chunk::<4>()?;
    if crc32fast::hash(body) != u32::from_le_bytes(*crc) {
        return None;
    }
    let (&[version, kind], payload) = body.split_first_chunk::<2>()?;
    Some((version, kind, payload))
}

//! Chunks: {type, varint length, payload, CRC-32}, and finding the next one after damage.

mod marks;

use self::marks::Marks;
use crate::{TakeError, varint};

/// `0x89 T A K CR LF 0x1A LF`: any transfer in text mode breaks it.
pub const MAGIC: [u8; 8] = *b"\x89TAK\r\n\x1a\n";

/// Longest payload. A stretch at the limits of docs/take-format.md, lossless, stays below it.
pub const PAYLOAD_BYTES_MAX: u64 = 1 << 30;

/// Longest candidate that [`resync`] hashes: about what the way over the marks costs.
const HASHED_BYTES: usize = 2048;

/// Bit 7 of the type: a reader that does not know the chunk may skip it.
pub const MAY_SKIP: u8 = 0x80;

/// The chunk types.
#[expect(missing_docs, reason = "docs/take-format.md has the table")]
pub mod types {
    pub const HEADER: u8 = 0x01;
    pub const CHANNELS: u8 = 0x02;
    pub const STRETCH: u8 = 0x03;
    pub const EVENT: u8 = 0x85;
    pub const LEDGER: u8 = 0x06;
    pub const SUBJECT: u8 = 0x87;
    pub const MODEL: u8 = 0x88;
    pub const FOREIGN: u8 = 0x89;
    pub const INDEX: u8 = 0x8a;
    pub const FOOTER: u8 = 0x8b;
    pub const CLOCK: u8 = 0x8c;
    pub const SUMMARY: u8 = 0x8d;
    /// Every type of version 1.
    pub const ALL: [u8; 12] = [
        HEADER, CHANNELS, STRETCH, EVENT, LEDGER, SUBJECT, MODEL, FOREIGN, INDEX, FOOTER, CLOCK,
        SUMMARY,
    ];
}

/// Appends one chunk to `out`.
///
/// # Errors
/// `InvalidArgument` when the payload is longer than [`PAYLOAD_BYTES_MAX`].
pub fn put(out: &mut Vec<u8>, kind: u8, payload: &[u8]) -> Result<(), TakeError> {
    if payload.len() as u64 > PAYLOAD_BYTES_MAX {
        return Err(TakeError::InvalidArgument(format!(
            "a chunk of {} bytes is longer than a take can hold ({PAYLOAD_BYTES_MAX})",
            payload.len()
        )));
    }
    let start = out.len();
    out.push(kind);
    varint::put(out, payload.len() as u64);
    out.extend_from_slice(payload);
    let crc = crc32fast::hash(&out[start..]);
    out.extend_from_slice(&crc.to_le_bytes());
    Ok(())
}

/// What stands at the front of some bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Front<'a> {
    /// A whole chunk with a matching CRC.
    Whole {
        /// Its type.
        kind: u8,
        /// Its payload.
        payload: &'a [u8],
        /// Bytes from its type to its CRC.
        len: usize,
    },
    /// Nothing wrong so far, but the bytes end first; at least this many are needed.
    Short(u64),
    /// No chunk of version 1 begins here.
    Damaged,
}

/// Looks at the front of `bytes`.
#[must_use]
pub fn front(bytes: &[u8]) -> Front<'_> {
    match split(bytes) {
        Front::Whole { len, .. } if !crc_matches(&bytes[..len]) => Front::Damaged,
        front => front,
    }
}

fn crc_matches(chunk: &[u8]) -> bool {
    chunk
        .split_last_chunk::<4>()
        .is_some_and(|(body, crc)| crc32fast::hash(body).to_le_bytes() == *crc)
}

/// The same without the CRC, for a chunk whose CRC was seen to match.
pub(crate) fn split(bytes: &[u8]) -> Front<'_> {
    let mut cursor = varint::Cursor::new(bytes);
    let Some(kind) = cursor.byte() else { return Front::Short(1) };
    let Some(payload_len) = cursor.varint() else {
        // A varint of this format's lengths ends within five bytes.
        return if bytes.len() < 6 { Front::Short(bytes.len() as u64 + 1) } else { Front::Damaged };
    };
    if payload_len > PAYLOAD_BYTES_MAX {
        return Front::Damaged;
    }
    let head_len = bytes.len() - cursor.rest().len();
    let Some(payload) = cursor.take(payload_len).filter(|_| cursor.take(4).is_some()) else {
        return Front::Short(head_len as u64 + payload_len + 4);
    };
    Front::Whole { kind, payload, len: head_len + payload.len() + 4 }
}

/// Offset of the next whole chunk of a known type at or after `from`, or `None` when there is none.
///
/// Every byte that may be a type is a candidate, and coded bytes are full of them, most with a length that
/// fits. So the CRC of a long candidate is not hashed but computed from CRCs at marks: the work grows with
/// the bytes, not with their product with the lengths. Bytes that hold nothing but long candidates are not
/// a damaged take, and are given up.
#[must_use]
pub fn resync(bytes: &[u8], from: usize) -> Option<usize> {
    let mut marks = Marks::new(bytes.get(from..)?);
    let mut long_candidates_left = bytes.len() / 8 + (1 << 20);
    for at in from..bytes.len() {
        if !types::ALL.contains(&bytes[at]) {
            continue;
        }
        let Front::Whole { len, .. } = split(&bytes[at..]) else { continue };
        let found = if len <= HASHED_BYTES {
            crc_matches(&bytes[at..at + len])
        } else {
            long_candidates_left = long_candidates_left.checked_sub(1)?;
            let crc_at = at + len - 4;
            let crc = marks.crc(at - from, crc_at - from);
            bytes[crc_at..].first_chunk::<4>().is_some_and(|stored| *stored == crc.to_le_bytes())
        };
        if found {
            return Some(at);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two() -> Vec<u8> {
        let mut out = Vec::new();
        put(&mut out, types::STRETCH, b"first").unwrap();
        put(&mut out, types::LEDGER, &[7; 300]).unwrap();
        out
    }

    #[test]
    fn whole_chunks_come_back() {
        let bytes = two();
        let Front::Whole { kind, payload, len } = front(&bytes) else { panic!() };
        assert_eq!((kind, payload), (types::STRETCH, &b"first"[..]));
        let Front::Whole { kind, payload, .. } = front(&bytes[len..]) else { panic!() };
        assert_eq!((kind, payload), (types::LEDGER, &[7; 300][..]));
    }

    #[test]
    fn every_truncation_is_short() {
        let bytes = two();
        let Front::Whole { len, .. } = front(&bytes) else { panic!() };
        for cut in 0..len {
            assert!(matches!(front(&bytes[..cut]), Front::Short(n) if n as usize > cut), "{cut}");
        }
    }

    #[test]
    fn every_mutation_is_seen_and_the_next_chunk_found() {
        let bytes = two();
        let Front::Whole { len, .. } = front(&bytes) else { panic!() };
        for at in 0..len {
            for flip in 1..=255_u8 {
                let mut damaged = bytes.clone();
                damaged[at] ^= flip;
                assert!(!matches!(front(&damaged), Front::Whole { .. }), "{at} {flip}");
                assert_eq!(resync(&damaged, 1), Some(len), "{at} {flip}");
            }
        }
    }

    /// Long chunks of bytes as random as coded ones are: every second candidate has a length that fits.
    #[test]
    fn the_next_chunk_is_found_behind_a_long_damaged_one() {
        let mut noise = 1_u32;
        let mut payload = |len: usize| {
            let byte = |_| {
                noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (noise >> 24) as u8
            };
            (0..len).map(byte).collect::<Vec<u8>>()
        };
        let mut bytes = Vec::new();
        put(&mut bytes, types::STRETCH, &payload(300_000)).unwrap();
        let next = bytes.len();
        for _ in 0..3 {
            put(&mut bytes, types::STRETCH, &payload(2_000_000)).unwrap();
        }
        bytes[150_000] ^= 1;
        assert_eq!(front(&bytes), Front::Damaged);
        assert_eq!(resync(&bytes, 1), Some(next));
    }
}

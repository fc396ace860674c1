//! Chunks {type, varint length, payload, CRC-32}, and the search for the next one after damage.

mod prefix_crcs;
mod search;

#[cfg(test)]
pub(crate) use self::prefix_crcs::HASHED_BYTES;
pub(crate) use self::{
    prefix_crcs::PrefixCrcs,
    search::{LongChunkScan, LongChunks, ResyncOutcome, parse_at, resync},
};
use crate::{TakeError, varint};

/// `0x89 T A K CR LF 0x1A LF`: any transfer in text mode alters it.
pub const MAGIC: [u8; 8] = *b"\x89TAK\r\n\x1a\n";

/// Longest payload. A lossless stretch at the limits of docs/take-format.md stays below it.
pub const PAYLOAD_BYTES_MAX: u64 = 1 << 30;

/// Longest chunk that a reader buffers before its CRC is known to match. Every record is shorter, and so is a SUBJECT:
/// eight documents of 1 MiB, which DEFLATE lengthens by at most five bytes per 16 KiB, and their names; SAMPLES have at
/// most 4 MiB. A longer chunk is a STRETCH, a FOREIGN, or of a type that this version does not know.
pub const CHUNK_HELD_MAX: u64 = (8 << 20) + (64 << 10);

/// Maximum number of bytes that a reader buffers while it searches for the next chunk after damage. Half of them hold
/// the end of any
/// chunk that begins in the other half.
pub const WINDOW_BYTES: usize = 16 << 20;

/// Maximum size of type and length, bytes.
pub(crate) const HEAD_BYTES_MAX: usize = 6;

/// Size of the CRC-32.
pub(crate) const CRC_BYTES: usize = 4;

/// Bit 7 of a chunk type: a reader that does not know the type may skip the chunk.
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
    pub const SAMPLED_GROUP: u8 = 0x8e;
    pub const SAMPLES: u8 = 0x8f;
    pub const ORDER: u8 = 0x92;
    pub const SAMPLE_TIMES: u8 = 0x93;
    pub const SAMPLE_LEDGER: u8 = 0x94;
    /// Every type of version 1.
    pub const ALL: [u8; 17] = [
        HEADER,
        CHANNELS,
        STRETCH,
        EVENT,
        LEDGER,
        SUBJECT,
        MODEL,
        FOREIGN,
        INDEX,
        FOOTER,
        CLOCK,
        SUMMARY,
        SAMPLED_GROUP,
        SAMPLES,
        ORDER,
        SAMPLE_TIMES,
        SAMPLE_LEDGER,
    ];
}

/// Appends one chunk to `out`.
///
/// # Errors
/// `InvalidArgument` when the payload is longer than [`PAYLOAD_BYTES_MAX`].
pub fn put(out: &mut Vec<u8>, kind: u8, payload: &[u8]) -> Result<(), TakeError> {
    let start = out.len();
    put_head(out, kind, payload.len() as u64)?;
    out.extend_from_slice(payload);
    let crc = crc32fast::hash(&out[start..]);
    out.extend_from_slice(&crc.to_le_bytes());
    Ok(())
}

/// Appends type and length of a chunk, whose payload and CRC follow.
pub(crate) fn put_head(out: &mut Vec<u8>, kind: u8, payload_bytes: u64) -> Result<(), TakeError> {
    if payload_bytes > PAYLOAD_BYTES_MAX {
        return Err(TakeError::InvalidArgument(format!(
            "a chunk of {payload_bytes} bytes is longer than a take can hold (at most {PAYLOAD_BYTES_MAX} bytes)"
        )));
    }
    out.push(kind);
    varint::put(out, payload_bytes);
    Ok(())
}

/// What the first bytes of a buffer are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChunkParse<'a> {
    /// A complete chunk with a matching CRC.
    Whole {
        /// Its type.
        kind: u8,
        /// Its payload.
        payload: &'a [u8],
        /// Size from its type to its CRC.
        len: usize,
    },
    /// An incomplete chunk without an error so far; parsing needs at least this many bytes.
    Short(u64),
    /// Not a chunk of version 1.
    Damaged,
}

/// Parses the chunk at the front of `bytes`.
#[must_use]
pub fn parse(bytes: &[u8]) -> ChunkParse<'_> {
    match split(bytes) {
        ChunkParse::Whole { len, .. } if !crc_matches(&bytes[..len]) => ChunkParse::Damaged,
        other => other,
    }
}

fn crc_matches(chunk: &[u8]) -> bool {
    let Some((body, crc)) = chunk.split_last_chunk::<CRC_BYTES>() else { return false };
    prefix_crcs::extend_crc(0, body).to_le_bytes() == *crc
}

/// Parses the chunk at the front of `bytes` without checking its CRC.
pub(crate) fn split(bytes: &[u8]) -> ChunkParse<'_> {
    match head(bytes) {
        ChunkHead::Short(needed) => ChunkParse::Short(needed),
        ChunkHead::Invalid => ChunkParse::Damaged,
        ChunkHead::Valid { kind, len, head_bytes } => {
            let chunk = usize::try_from(len).ok().and_then(|len| bytes.get(..len));
            let Some(chunk) = chunk else { return ChunkParse::Short(len) };
            let payload = &chunk[head_bytes..chunk.len() - CRC_BYTES];
            ChunkParse::Whole { kind, payload, len: chunk.len() }
        }
    }
}

/// Type and length of a chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ChunkHead {
    /// The bytes end within them; parsing needs at least this many.
    Short(u64),
    /// Not a chunk of version 1.
    Invalid,
    /// A chunk of `len` bytes from its type to its CRC, with `head_bytes` of type and length.
    Valid { kind: u8, len: u64, head_bytes: usize },
}

pub(crate) fn head(bytes: &[u8]) -> ChunkHead {
    let mut cursor = varint::Cursor::new(bytes);
    let Some(kind) = cursor.byte() else { return ChunkHead::Short(1) };
    match cursor.varint() {
        Some(payload_bytes) if payload_bytes > PAYLOAD_BYTES_MAX => ChunkHead::Invalid,
        Some(payload_bytes) => {
            let head_bytes = bytes.len() - cursor.rest().len();
            let len = head_bytes as u64 + payload_bytes + CRC_BYTES as u64;
            ChunkHead::Valid { kind, len, head_bytes }
        }
        // Every valid length has at most five bytes.
        None if bytes.len() < HEAD_BYTES_MAX => ChunkHead::Short(bytes.len() as u64 + 1),
        None => ChunkHead::Invalid,
    }
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
    fn whole_chunks_are_parsed() {
        let bytes = two();
        let ChunkParse::Whole { kind, payload, len } = parse(&bytes) else { panic!() };
        assert_eq!((kind, payload), (types::STRETCH, &b"first"[..]));
        let ChunkParse::Whole { kind, payload, .. } = parse(&bytes[len..]) else { panic!() };
        assert_eq!((kind, payload), (types::LEDGER, &[7; 300][..]));
    }

    #[test]
    fn every_truncation_is_short() {
        let bytes = two();
        let ChunkParse::Whole { len, .. } = parse(&bytes) else { panic!() };
        for cut in 0..len {
            assert!(
                matches!(parse(&bytes[..cut]), ChunkParse::Short(n) if n as usize > cut),
                "{cut}"
            );
        }
    }

    #[test]
    fn every_mutation_is_detected() {
        let bytes = two();
        let ChunkParse::Whole { len, .. } = parse(&bytes) else { panic!() };
        for at in 0..len {
            for flip in 1..=255_u8 {
                let mut damaged = bytes.clone();
                damaged[at] ^= flip;
                assert!(!matches!(parse(&damaged), ChunkParse::Whole { .. }), "{at} {flip}");
            }
        }
    }
}

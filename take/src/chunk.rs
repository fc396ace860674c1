//! Chunks {type, varint length, payload, CRC-32}, the CRC-32 of any part of a buffer without hashing all of the part,
//! and the search for the next chunk after damage.

mod search;

use crc32fast::Hasher;

pub(crate) use self::search::{LongChunkScan, LongChunks, ResyncOutcome, parse_at, resync};
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
    extend_crc(0, body).to_le_bytes() == *crc
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

/// Distance of prefix CRCs in bytes. They take 1/64 of the buffer's size, and at most this many bytes are hashed at
/// either end of a part.
const STEP: usize = 256;

/// CRCs of the prefixes of a buffer, at every [`STEP`] bytes, computed on demand. They are kept for as long as the
/// bytes are, so each byte is hashed once, however many candidate chunks begin before it.
#[derive(Debug)]
pub(crate) struct PrefixCrcs {
    /// Position in the buffer of the first prefix's end.
    first: usize,
    /// `crcs[i]` is the CRC from a fixed position at or before `first` up to `first + i * STEP`; never empty.
    crcs: Vec<u32>,
}

impl Default for PrefixCrcs {
    fn default() -> Self {
        Self { first: 0, crcs: vec![0] }
    }
}

impl PrefixCrcs {
    /// Removes the first `n` bytes from the front of the buffer.
    pub(crate) fn drain(&mut self, n: usize) {
        self.discard_before(n);
        self.first -= n;
    }

    /// Discards the CRCs of bytes before `at`, which have changed or will.
    pub(crate) fn discard_before(&mut self, at: usize) {
        let n = at.saturating_sub(self.first).div_ceil(STEP);
        if n < self.crcs.len() {
            self.crcs.drain(..n);
            self.first += n * STEP;
        } else {
            // No CRC was computed after it.
            *self = Self { first: at, ..Self::default() };
        }
    }

    /// The CRC of `bytes[start..end]`, where `bytes` is the whole buffer; 0, the CRC of no bytes, for an empty or
    /// invalid range. Bytes before the first prefix's end are hashed.
    fn crc(&mut self, bytes: &[u8], start: usize, end: usize) -> u32 {
        if start > end || end > bytes.len() {
            return 0;
        }
        let split = self.first.clamp(start, end);
        let before = extend_crc(0, &bytes[start..split]);
        if split == end {
            return before;
        }
        let crc =
            self.crc_to(bytes, end) ^ shifted_crc(self.crc_to(bytes, split), (end - split) as u64);
        if split == start { crc } else { crc ^ shifted_crc(before, (end - split) as u64) }
    }

    /// The CRC up to `end`, which is not before `first`.
    fn crc_to(&mut self, bytes: &[u8], end: usize) -> u32 {
        let mark = (end - self.first) / STEP;
        while self.crcs.len() <= mark {
            let last = self.crcs.len() - 1;
            let at = self.first + last * STEP;
            let crc = extend_crc(self.crcs[last], &bytes[at..at + STEP]);
            self.crcs.push(crc);
        }
        extend_crc(self.crcs[mark], &bytes[self.first + mark * STEP..end])
    }
}

#[cfg(test)]
thread_local! {
    /// Bytes hashed by this thread.
    pub(crate) static HASHED_BYTES: std::cell::Cell<u64> = const { std::cell::Cell::new(0) };
}

/// The CRC of bytes with CRC `crc`, followed by `bytes`.
fn extend_crc(crc: u32, bytes: &[u8]) -> u32 {
    #[cfg(test)]
    HASHED_BYTES.set(HASHED_BYTES.get() + bytes.len() as u64);
    let mut hasher = Hasher::new_with_initial(crc);
    hasher.update(bytes);
    hasher.finalize()
}

/// The contribution of a prefix with CRC `crc` to the CRC of the prefix and `len` more bytes. The CRC of two parts is
/// this contribution of the first part XOR the CRC of the second.
fn shifted_crc(crc: u32, len: u64) -> u32 {
    let mut hasher = Hasher::new_with_initial(crc);
    hasher.combine(&Hasher::new_with_initial_len(0, len));
    hasher.finalize()
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

    fn bytes() -> Vec<u8> {
        (0..3000_u32).map(|i| (i * i / 7) as u8).collect()
    }

    const POSITIONS: [usize; 13] = [0, 1, 99, 100, 255, 256, 257, 511, 512, 1000, 2047, 2999, 3000];

    fn check(prefixes: &mut PrefixCrcs, bytes: &[u8]) {
        for start in POSITIONS.into_iter().filter(|&start| start <= bytes.len()) {
            for end in POSITIONS.into_iter().filter(|&end| (start..=bytes.len()).contains(&end)) {
                let hashed = crc32fast::hash(&bytes[start..end]);
                assert_eq!(prefixes.crc(bytes, start, end), hashed, "{start}..{end}");
            }
        }
    }

    #[test]
    fn every_part_has_the_crc_that_hashing_gives() {
        let bytes = bytes();
        let mut prefixes = PrefixCrcs::default();
        check(&mut prefixes, &bytes);
        assert_eq!(prefixes.crc(&bytes, 5, 3001), 0);
        assert_eq!(prefixes.crc(&bytes, 6, 5), 0);
    }

    #[test]
    fn prefixes_move_with_the_bytes_and_changed_ones_are_discarded() {
        for first in POSITIONS {
            for second in POSITIONS.into_iter().filter(|second| first + second <= 3000) {
                for asked in POSITIONS {
                    let mut bytes = bytes();
                    let mut prefixes = PrefixCrcs::default();
                    prefixes.crc(&bytes, 0, asked);
                    bytes.drain(..first);
                    prefixes.drain(first);
                    prefixes.crc(&bytes, 0, asked.min(bytes.len()));
                    bytes[..second].fill(9);
                    prefixes.discard_before(second);
                    check(&mut prefixes, &bytes);
                }
            }
        }
    }

    #[test]
    fn no_byte_is_hashed_twice() {
        let bytes = bytes();
        let mut prefixes = PrefixCrcs::default();
        prefixes.crc(&bytes, 0, 3000);
        prefixes.drain(700);
        let before = HASHED_BYTES.get();
        prefixes.crc(&bytes[700..], 100, 2300);
        assert!(HASHED_BYTES.get() - before < 2 * STEP as u64);
    }
}

//! The search for the next valid chunk after damage, both in the buffer and among chunks that are longer than the
//! buffer.
//!
//! A chunk ends with its CRC, possibly a gigabyte after its head, and encoded bytes are full of apparent heads. For
//! long chunks the file is therefore scanned once to its end, with a running CRC: the CRCs of two prefixes give the CRC
//! of the bytes between them, so each candidate needs only three numbers. The reader then goes back and reads with the
//! list of valid long chunks, without trial and error.

use std::{cmp::Reverse, collections::BinaryHeap};

use super::{
    CHUNK_HELD_MAX, CRC_BYTES, ChunkHead, ChunkParse, HEAD_BYTES_MAX, PrefixCrcs, crc_matches,
    extend_crc, head, shifted_crc, split, types,
};
use crate::{foreign, stretch};

/// Longest candidate whose CRC is hashed directly; computing it from prefix CRCs costs about as much.
const HASHED_BYTES: usize = 2048;

/// A block of zeros, to compare many bytes at once.
const ZEROS: [u8; 64] = [0; 64];

/// The outcome of a search in the buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ResyncOutcome {
    /// A valid chunk of a known type begins here.
    Found(usize),
    /// No chunk begins before this position; one that may begin here is incomplete.
    NotBefore(usize),
    /// No chunk begins before this position; one that may begin here is too long for the window, so the file must be
    /// [scanned](LongChunkScan).
    NeedsScan(usize),
}

/// Searches `bytes` for a valid chunk that begins at or after `from`. `complete`: the file ends with `bytes`.
/// `is_long_whole`: whether the long chunk at a position is valid, if that is known.
///
/// Every byte with the value of a chunk type is a candidate, and encoded bytes are full of them, most with a plausible
/// length. The CRC of a long candidate is therefore computed from prefix CRCs, not hashed: the work grows with the
/// number of bytes, not with its product with the lengths. The next search, after a small chunk, meets the same bytes
/// and reuses `prefixes`.
pub(crate) fn resync(
    bytes: &[u8],
    prefixes: &mut PrefixCrcs,
    from: usize,
    complete: bool,
    is_long_whole: impl Fn(usize) -> Option<bool>,
) -> ResyncOutcome {
    let mut at = from;
    while let Some(&kind) = bytes.get(at) {
        if kind == 0 {
            at += zeros(&bytes[at..]);
            continue;
        }
        if types::ALL.contains(&kind) {
            match parse_at(bytes, at, prefixes) {
                ChunkParse::Whole { .. } => return ResyncOutcome::Found(at),
                ChunkParse::Short(len) if !complete && len <= CHUNK_HELD_MAX => {
                    return ResyncOutcome::NotBefore(at);
                }
                // The chunk is longer than the buffer.
                ChunkParse::Short(_) if !complete => match is_long_whole(at) {
                    Some(true) => return ResyncOutcome::Found(at),
                    None if may_be_long(&bytes[at..]) => return ResyncOutcome::NeedsScan(at),
                    _ => {}
                },
                _ => {}
            }
        }
        at += 1;
    }
    ResyncOutcome::NotBefore(bytes.len())
}

/// Parses the chunk at `bytes[at..]` like [`parse`](super::parse), with the help of the prefix CRCs of `bytes`.
pub(crate) fn parse_at<'a>(bytes: &'a [u8], at: usize, crcs: &mut PrefixCrcs) -> ChunkParse<'a> {
    let parsed = split(&bytes[at..]);
    let ChunkParse::Whole { len, .. } = parsed else { return parsed };
    if is_whole(bytes, at, at + len, crcs) { parsed } else { ChunkParse::Damaged }
}

/// Whether the CRC of the chunk `bytes[at..end]` matches.
fn is_whole(bytes: &[u8], at: usize, end: usize, prefixes: &mut PrefixCrcs) -> bool {
    if end - at <= HASHED_BYTES {
        return crc_matches(&bytes[at..end]);
    }
    let crc_at = end - CRC_BYTES;
    let crc = prefixes.crc(bytes, at, crc_at);
    bytes[crc_at..].first_chunk::<CRC_BYTES>() == Some(&crc.to_le_bytes())
}

/// Number of leading zeros. No chunk type is zero, and sparse files have gigabytes of zeros.
fn zeros(bytes: &[u8]) -> usize {
    let blocks = bytes.chunks_exact(ZEROS.len()).take_while(|block| **block == ZEROS).count();
    let at = blocks * ZEROS.len();
    at + bytes[at..].iter().take_while(|&&byte| byte == 0).count()
}

/// Maximum number of candidates tracked at the same time. In bytes as random as encoded ones, one in 8000 looks like
/// the head of a long chunk, of 128 MiB on average, which makes 16 000; eight times as many take 4 MiB. Only a crafted
/// file has more, and a long chunk in it may count as damaged.
const CANDIDATES_MAX: usize = 1 << 17;

/// Maximum number of long chunks remembered: half a terabyte of them, in 1 MiB.
const FOUND_MAX: usize = 1 << 16;

/// Bytes needed to validate a candidate: its head, and the start of its payload.
const FRONT_BYTES: usize = HEAD_BYTES_MAX + foreign::FRONT_BYTES;

/// The result of a scan: which of the long chunks that begin in `from..to` are valid.
#[derive(Debug, Default)]
pub(crate) struct LongChunks {
    from: u64,
    to: u64,
    /// Offsets of the valid ones, in order.
    whole: Vec<u64>,
    /// Size of the file, if the scan reached its end.
    end: Option<u64>,
}

impl LongChunks {
    /// Whether the file is known to end before byte `end`.
    pub(crate) fn is_cut(&self, end: u64) -> bool {
        self.end.is_some_and(|file_end| file_end < end)
    }

    /// Whether the long chunk at `offset` is valid, if that is known.
    pub(crate) fn is_whole(&self, offset: u64) -> Option<bool> {
        let known = (self.from..self.to).contains(&offset);
        known.then(|| self.whole.binary_search(&offset).is_ok())
    }
}

/// Whether bytes after damage look like the beginning of a long chunk that this version writes. A long chunk of another
/// type is recognised only after a valid chunk.
fn may_be_long(bytes: &[u8]) -> bool {
    let ChunkHead::Valid { kind, len, head_bytes } = head(bytes) else { return false };
    let payload = &bytes[head_bytes..];
    len > CHUNK_HELD_MAX
        && match kind {
            types::STRETCH => stretch::may_begin_with(payload),
            types::FOREIGN => foreign::may_begin_with(payload),
            _ => false,
        }
}

/// A position at which the scan must act; ordered by position.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct ScanEvent {
    at: u64,
    kind: ScanEventKind,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum ScanEventKind {
    /// The CRC of a candidate is stored here.
    Crc {
        /// Where the candidate begins.
        start: u64,
        /// The CRC of all scanned bytes before it.
        crc_before: u32,
        /// Whether the candidate follows a valid chunk.
        in_sync: bool,
    },
    /// A chunk begins here, because the one before it is valid.
    ChunkStart,
}

/// Scans a file for long chunks. Bytes are pushed in order, and are not kept.
#[derive(Debug)]
pub(crate) struct LongChunkScan {
    from: u64,
    /// Offset of the next byte.
    at: u64,
    /// CRC of the bytes from `from` to `at`.
    crc: u32,
    events: BinaryHeap<Reverse<ScanEvent>>,
    whole: Vec<u64>,
    /// Whether the scan began at a long chunk that proved valid, and has nothing else to find.
    is_done: bool,
}

impl LongChunkScan {
    /// Starts at byte `from`. `in_sync`: a chunk begins there, because the bytes before it are valid.
    pub(crate) fn new(from: u64, in_sync: bool) -> Self {
        let mut events = BinaryHeap::new();
        if in_sync {
            events.push(Reverse(ScanEvent { at: from, kind: ScanEventKind::ChunkStart }));
        }
        Self { from, at: from, crc: 0, events, whole: Vec::new(), is_done: false }
    }

    /// The offset at which the scan began; the reader then seeks back to it.
    pub(crate) fn from(&self) -> u64 {
        self.from
    }

    /// Whether the scan needs no more bytes.
    pub(crate) fn is_done(&self) -> bool {
        self.is_done
    }

    /// Ends the scan.
    pub(crate) fn finish(mut self) -> LongChunks {
        // Chunks were found in the order of their ends, and one may begin within another.
        self.whole.sort_unstable();
        let (to, end) =
            if self.is_done { (self.from + 1, None) } else { (u64::MAX, Some(self.at)) };
        LongChunks { from: self.from, to, whole: self.whole, end }
    }

    /// Scans the next bytes; `complete` if they end the file. Returns how many were processed. The others must be
    /// pushed again, with those after them.
    pub(crate) fn push(&mut self, bytes: &[u8], complete: bool) -> usize {
        let start = self.at;
        let end = if complete { bytes.len() } else { bytes.len().saturating_sub(FRONT_BYTES) };
        let mut from = 0;
        while from < end && !self.is_done {
            let next = next_candidate(&bytes[..end], from);
            self.handle_events(start + next as u64, start, bytes);
            if next < end && may_be_long(&bytes[next..]) && self.events.len() < CANDIDATES_MAX {
                self.update_crc(start + next as u64, start, bytes);
                self.track(start + next as u64, false, &bytes[next..]);
            }
            from = next + 1;
        }
        if !self.is_done {
            self.handle_events(start + end as u64, start, bytes);
            self.update_crc(start + end as u64, start, bytes);
        }
        end
    }

    /// Handles all events before byte `to`.
    fn handle_events(&mut self, to: u64, start: u64, bytes: &[u8]) {
        while let Some(&Reverse(ScanEvent { at, kind })) = self.events.peek() {
            if at >= to || self.is_done {
                return;
            }
            self.events.pop();
            self.update_crc(at, start, bytes);
            let Some(rest) = at.checked_sub(start).and_then(|by| bytes.get(by as usize..)) else {
                continue;
            };
            match kind {
                ScanEventKind::ChunkStart => {
                    // A chunk that was tracked several times ends here as often; track the next one once.
                    while self.events.peek() == Some(&Reverse(ScanEvent { at, kind })) {
                        self.events.pop();
                    }
                    self.track(at, true, rest);
                }
                ScanEventKind::Crc { start: chunk, crc_before, in_sync } => {
                    let crc = self.crc ^ shifted_crc(crc_before, at - chunk);
                    if rest.first_chunk::<CRC_BYTES>() == Some(&crc.to_le_bytes()) {
                        self.add_whole(chunk, at + CRC_BYTES as u64, in_sync);
                    }
                }
            }
        }
    }

    /// Records a valid chunk. The same chunk may be found as a candidate and as the successor of a valid one; the two
    /// events are adjacent.
    fn add_whole(&mut self, chunk: u64, end: u64, in_sync: bool) {
        let is_known = self.whole.last() == Some(&chunk);
        if end - chunk > CHUNK_HELD_MAX && !is_known && self.whole.len() < FOUND_MAX {
            self.whole.push(chunk);
        }
        self.is_done = in_sync && chunk == self.from;
        self.events.push(Reverse(ScanEvent { at: end, kind: ScanEventKind::ChunkStart }));
    }

    /// Tracks the chunk that may begin at `at`, up to its CRC.
    fn track(&mut self, at: u64, in_sync: bool, bytes: &[u8]) {
        if let ChunkHead::Valid { len, .. } = head(bytes) {
            let kind = ScanEventKind::Crc { start: at, crc_before: self.crc, in_sync };
            self.events.push(Reverse(ScanEvent { at: at + len - CRC_BYTES as u64, kind }));
        }
    }

    /// Updates the running CRC up to byte `to`.
    fn update_crc(&mut self, to: u64, start: u64, bytes: &[u8]) {
        let part = |at: u64| at.checked_sub(start).and_then(|by| usize::try_from(by).ok());
        if let (Some(from), Some(end)) = (part(self.at), part(to))
            && let Some(passed) = bytes.get(from..end)
        {
            self.crc = extend_crc(self.crc, passed);
            self.at = to;
        }
    }
}

/// The first position at or after `from` with the type of a long chunk, or the end.
fn next_candidate(bytes: &[u8], from: usize) -> usize {
    let mut at = from;
    while let Some(&byte) = bytes.get(at) {
        match byte {
            0 => at += zeros(&bytes[at..]),
            types::STRETCH | types::FOREIGN => return at,
            _ => at += 1,
        }
    }
    bytes.len()
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use mocapd_testkit::random::Random;

    use super::*;
    use crate::chunk::{parse, put};

    fn next(bytes: &[u8]) -> ResyncOutcome {
        resync(bytes, &mut PrefixCrcs::default(), 1, true, |_| None)
    }

    #[test]
    fn the_next_chunk_is_found_after_every_mutation() {
        let mut bytes = Vec::new();
        put(&mut bytes, types::STRETCH, b"first").unwrap();
        let len = bytes.len();
        put(&mut bytes, types::LEDGER, &[7; 300]).unwrap();
        for at in 0..len {
            for flip in 1..=255_u8 {
                let mut damaged = bytes.clone();
                damaged[at] ^= flip;
                assert_eq!(next(&damaged), ResyncOutcome::Found(len), "{at} {flip}");
            }
        }
    }

    /// Long chunks of bytes as random as encoded ones: every second candidate has a plausible length.
    #[test]
    fn the_next_chunk_is_found_after_a_long_damaged_one() {
        let mut random = Random::new(1);
        let mut payload = |len: usize| random.bytes(len);
        let mut bytes = Vec::new();
        put(&mut bytes, types::STRETCH, &payload(300_000)).unwrap();
        let found = bytes.len();
        for _ in 0..3 {
            put(&mut bytes, types::STRETCH, &payload(2_000_000)).unwrap();
        }
        bytes[150_000] ^= 1;
        assert_eq!(parse(&bytes), ChunkParse::Damaged);
        assert_eq!(next(&bytes), ResyncOutcome::Found(found));
        // Without the end of the next chunk, nothing after its beginning is judged.
        let prefixes = &mut PrefixCrcs::default();
        let found_part = resync(&bytes[..found + 1000], prefixes, 1, false, |_| Some(false));
        let ResyncOutcome::NotBefore(at) = found_part else {
            panic!("the end of the next chunk is not there")
        };
        assert!(at <= found);
    }

    #[test]
    fn zeros_are_skipped_and_counted() {
        for n in [0, 1, 63, 64, 65, 1000] {
            let mut bytes = vec![0; n];
            assert_eq!(zeros(&bytes), n);
            bytes.extend([7, 0, 0]);
            assert_eq!(zeros(&bytes), n);
        }
    }

    /// A FOREIGN chunk of zeros, just too long to be buffered.
    fn long_chunk() -> Vec<u8> {
        let mut payload = vec![1, b'a', 0];
        payload.resize(CHUNK_HELD_MAX as usize, 0);
        let mut chunk = Vec::new();
        put(&mut chunk, types::FOREIGN, &payload).unwrap();
        chunk
    }

    /// If each match were counted as often as it is found, each chunk would be tracked once for every one before it:
    /// after 362 chunks, 65 703 matches would fill the list.
    #[test]
    fn each_of_many_long_chunks_after_damage_is_found_once() {
        const CHUNKS: usize = 400;
        let chunk = long_chunk();
        let mut scan = LongChunkScan::new(0, false);
        let mut waiting = VecDeque::from([0_u8; 100]);
        let (mut offsets, mut at, mut events_max) = (Vec::new(), waiting.len() as u64, 0);
        for number in 0..CHUNKS {
            offsets.push(at);
            at += chunk.len() as u64;
            waiting.extend(&chunk);
            let done = scan.push(waiting.make_contiguous(), number + 1 == CHUNKS);
            waiting.drain(..done);
            events_max = events_max.max(scan.events.len());
        }
        let found = scan.whole.len();
        let long = scan.finish();
        let missed = offsets.iter().position(|&offset| long.is_whole(offset) != Some(true));
        assert_eq!((missed, found), (None, CHUNKS));
        // The chunk is tracked as a candidate and as the successor of a valid chunk.
        assert!(events_max <= 2, "{events_max}");
        assert_eq!(long.is_whole(offsets[1] + 1), Some(false));
    }
}

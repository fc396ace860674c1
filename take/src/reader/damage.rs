//! Damaged regions, and the search for the next valid chunk. A chunk of which only the head is damaged is
//! repaired: the position of the next chunk gives its length, and its CRC gives its type.

use crc32fast::Hasher;

use super::{TakeEvent, TakeReader};
use crate::{
    chunk::{
        self, CHUNK_HELD_MAX, CRC_BYTES, ChunkHead, HEAD_BYTES_MAX, LongChunkScan,
        PAYLOAD_BYTES_MAX, ResyncOutcome, WINDOW_BYTES, types,
    },
    varint,
};

/// A damaged region, from `offset` to the reader's position.
#[derive(Debug)]
pub(super) struct Damage {
    pub(super) offset: u64,
    /// Its first bytes.
    head: Vec<u8>,
    message: &'static str,
    /// Whether the region is so long that its beginning is no longer buffered.
    pub(super) start_dropped: bool,
    /// Whether the region is the take's header, and the file ends within it.
    header_cut: bool,
}

impl Damage {
    /// The region that begins with `bytes` at file offset `offset`.
    pub(super) fn new(offset: u64, bytes: &[u8], message: &'static str, header_cut: bool) -> Self {
        let head = bytes[..bytes.len().min(HEAD_BYTES_MAX)].to_vec();
        Self { offset, head, message, start_dropped: false, header_cut }
    }

    /// The chunk type in its first byte, if it is a valid one.
    fn kind(&self) -> Option<u8> {
        self.head.first().copied().filter(|kind| types::ALL.contains(kind))
    }

    /// Whether the region is exactly one chunk according to its own head, and not a stretch: then no stretch was
    /// lost in it. Where bytes are missing, the region consists of pieces of two chunks, and no head fits its
    /// length.
    fn is_single_non_stretch(&self, damaged_bytes: u64) -> bool {
        let ChunkHead::Valid { kind, len, .. } = chunk::head(&self.head) else { return false };
        len == damaged_bytes && kind != types::STRETCH && types::ALL.contains(&kind)
    }
}

impl TakeReader {
    /// Searches for the next valid chunk; `None` when more of the file is needed.
    pub(super) fn find_next(&mut self) -> Option<TakeEvent<'static>> {
        // No chunk begins at the region's own first byte.
        let (offset, start_dropped) = self.damage.as_ref().map(|d| (d.offset, d.start_dropped))?;
        if !self.complete && self.buffer.len() - self.used < WINDOW_BYTES {
            self.needed = WINDOW_BYTES as u64;
            return None;
        }
        let from = self.used + usize::from(self.offset() == offset);
        let is_whole = |at: usize| self.long_chunks.is_whole(self.base + at as u64);
        match chunk::resync(&self.buffer, &mut self.prefixes, from, self.complete, is_whole) {
            ResyncOutcome::Found(at) => return self.end_damage(at),
            ResyncOutcome::NotBefore(at) if self.complete => return self.end_damage(at),
            ResyncOutcome::NotBefore(at) => {
                self.used = at;
                if let Some(damage) = &mut self.damage {
                    damage.start_dropped = true;
                }
            }
            ResyncOutcome::NeedsScan(at) => {
                let start = if start_dropped { self.base + at as u64 } else { offset };
                self.used = (start - self.base) as usize;
                self.scan = Some(LongChunkScan::new(start, false));
            }
        }
        None
    }

    /// Ends the region at `at` in the buffer, where the next chunk begins or the file ends. A region that is one chunk
    /// with a damaged head is repaired and read next.
    fn end_damage(&mut self, at: usize) -> Option<TakeEvent<'static>> {
        let damage = self.damage.take()?;
        self.had_damage = true;
        let offset = damage.offset;
        self.used = at;
        self.needed = 1;
        let len = self.offset() - offset;
        if !damage.start_dropped && len <= CHUNK_HELD_MAX {
            let start = (offset - self.base) as usize;
            if repair_head(&mut self.buffer[start..at]) {
                self.prefixes.discard_before(at);
                self.used = start;
                return Some(TakeEvent::Repaired { offset });
            }
        }
        self.bytes.other += len;
        if damage.header_cut {
            self.header_cut_until = self.offset();
        }
        let may_be_stretch = !damage.is_single_non_stretch(len);
        if may_be_stretch && let Some(chain) = &mut self.chain {
            chain.break_off();
        }
        let (kind, message) = (damage.kind(), damage.message.to_owned());
        Some(TakeEvent::Damaged { offset, len, kind, message })
    }
}

/// Restores the head of the single chunk in `region`, if its CRC matches with one of the chunk types. Returns
/// whether it did. By chance, one of the fourteen types matches in one of 3.1 * 10^8 damaged regions.
pub(crate) fn repair_head(region: &mut [u8]) -> bool {
    let Some(payload_len) = payload_len(region.len() as u64) else { return false };
    let mut head = vec![0];
    varint::put(&mut head, payload_len);
    let Some((body, crc)) = region.split_last_chunk::<CRC_BYTES>() else { return false };
    let mut payload = Hasher::new();
    payload.update(&body[head.len()..]);
    let fits = |kind: &u8| {
        head[0] = *kind;
        let mut hasher = Hasher::new();
        hasher.update(&head);
        hasher.combine(&payload);
        hasher.finalize().to_le_bytes() == *crc
    };
    let Some(kind) = types::ALL.into_iter().find(fits) else { return false };
    head[0] = kind;
    region[..head.len()].copy_from_slice(&head);
    true
}

/// The payload length of a chunk of `chunk_len` bytes.
fn payload_len(chunk_len: u64) -> Option<u64> {
    let varint_len = |value: u64| u64::from(64 - (value | 1).leading_zeros()).div_ceil(7);
    let mut lens = (2..=HEAD_BYTES_MAX as u64).filter_map(|head| {
        let payload = chunk_len.checked_sub(head + CRC_BYTES as u64)?;
        (varint_len(payload) == head - 1).then_some(payload)
    });
    lens.rfind(|&len| len <= PAYLOAD_BYTES_MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chunk;

    #[test]
    fn type_and_length_are_repaired_and_nothing_else() {
        for n in [0, 1, 100, 126, 127, 128, 129, 16_383, 16_384, 20_000] {
            let payload: Vec<u8> = (0..n).map(|i| (i * 7) as u8).collect();
            let mut good = Vec::new();
            chunk::put(&mut good, types::STRETCH, &payload).unwrap();
            let head_len = good.len() - n - CRC_BYTES;
            for at in 0..good.len().min(300) {
                let mut damaged = good.clone();
                damaged[at] ^= 0x41;
                assert_eq!(repair_head(&mut damaged), at < head_len, "byte {at} of {n}");
                assert_eq!(damaged == good, at < head_len, "byte {at} of {n}");
            }
            let mut zeroed = good.clone();
            zeroed[..head_len].fill(0);
            assert!(repair_head(&mut zeroed) && zeroed == good, "{n}");
            assert!(!repair_head(&mut good[1..].to_vec()));
        }
        assert!(!repair_head(&mut []));
        assert!(!repair_head(&mut [0; 5]));
    }
}

//! CRC-32 of any part of a buffer, without hashing all of the part.

use crc32fast::Hasher;

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
    pub(super) fn crc(&mut self, bytes: &[u8], start: usize, end: usize) -> u32 {
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
pub(super) fn extend_crc(crc: u32, bytes: &[u8]) -> u32 {
    #[cfg(test)]
    HASHED_BYTES.set(HASHED_BYTES.get() + bytes.len() as u64);
    let mut hasher = Hasher::new_with_initial(crc);
    hasher.update(bytes);
    hasher.finalize()
}

/// The contribution of a prefix with CRC `crc` to the CRC of the prefix and `len` more bytes. The CRC of two parts is
/// this contribution of the first part XOR the CRC of the second.
pub(super) fn shifted_crc(crc: u32, len: u64) -> u32 {
    let mut hasher = Hasher::new_with_initial(crc);
    hasher.combine(&Hasher::new_with_initial_len(0, len));
    hasher.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

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

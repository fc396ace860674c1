//! CRC-32 of any part of some bytes, without hashing all of it.

use crc32fast::Hasher;

/// Bytes from mark to mark: 1/64 of the bytes in memory, and at most as many hashed at either end.
const STEP: usize = 256;

/// CRCs of the bytes up to every mark, as far as they were asked for.
pub(super) struct Marks<'a> {
    bytes: &'a [u8],
    /// `crcs[i]` is the CRC of the first `i * STEP` bytes.
    crcs: Vec<u32>,
}

impl<'a> Marks<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, crcs: vec![0] }
    }

    /// The CRC of `bytes[start..end]`. An empty or impossible part has the CRC of nothing, 0.
    pub(super) fn crc(&mut self, start: usize, end: usize) -> u32 {
        let Some(len) = end.checked_sub(start).filter(|_| end <= self.bytes.len()) else {
            return 0;
        };
        self.crc_to(end) ^ moved(self.crc_to(start), len as u64)
    }

    fn crc_to(&mut self, end: usize) -> u32 {
        let mark = end / STEP;
        while self.crcs.len() <= mark {
            let last = self.crcs.len() - 1;
            let crc = append(self.crcs[last], &self.bytes[last * STEP..(last + 1) * STEP]);
            self.crcs.push(crc);
        }
        append(self.crcs[mark], &self.bytes[mark * STEP..end])
    }
}

/// The CRC of some bytes and these behind them.
pub(super) fn append(crc: u32, bytes: &[u8]) -> u32 {
    let mut hasher = Hasher::new_with_initial(crc);
    hasher.update(bytes);
    hasher.finalize()
}

/// What the CRC of some bytes adds to that of these and `len` more: the CRC of two parts is the first one's, moved, xor
/// the second's.
pub(super) fn moved(crc: u32, len: u64) -> u32 {
    let mut hasher = Hasher::new_with_initial(crc);
    hasher.combine(&Hasher::new_with_initial_len(0, len));
    hasher.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_has_the_crc_that_hashing_gives() {
        let bytes: Vec<u8> = (0..3000_u32).map(|i| (i * i / 7) as u8).collect();
        let mut marks = Marks::new(&bytes);
        let places = [0, 1, 255, 256, 257, 511, 512, 1000, 2047, 2048, 2999, 3000];
        for start in places {
            for end in places.into_iter().filter(|&end| end >= start) {
                let hashed = crc32fast::hash(&bytes[start..end]);
                assert_eq!(marks.crc(start, end), hashed, "{start}..{end}");
            }
        }
        assert_eq!(marks.crc(5, 3001), 0);
    }
}

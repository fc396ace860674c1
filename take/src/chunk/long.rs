//! Chunks that are longer than the window: which of them are whole is found out before any of it is held.
//!
//! A CRC stands at the end of its chunk, which may be a gigabyte behind its head, and heads that mean nothing are
//! everywhere in coded bytes. So the file is read ahead once, to its end: the CRC of all bytes up to each place is known
//! on the way, and two of these give the CRC of what lies between. What is known of each candidate is three numbers.
//! Then the reader goes back and reads with this knowledge, and never has to try.

use std::{cmp::Reverse, collections::BinaryHeap};

use super::{
    CHUNK_HELD_MAX, CRC_BYTES, HEAD_BYTES_MAX, Head, head,
    marks::{append, moved},
    resync::zeros,
    types,
};
use crate::{foreign, stretch};

/// Candidates that are followed at once: in bytes as random as coded ones, one in 8000 looks like a long chunk, of 128 MiB
/// on average, which makes 16 000; eight times as many take 4 MiB. Where there are more, the file was made so, and a long
/// chunk among them may count as damaged.
const CANDIDATES_MAX: usize = 1 << 17;

/// Long chunks that are remembered: those of half a terabyte, in 1 MiB.
const FOUND_MAX: usize = 1 << 16;

/// What has to be there of a candidate to be judged: head, and the front of its payload.
const FRONT_BYTES: usize = HEAD_BYTES_MAX + foreign::FRONT_BYTES;

/// What is known of the long chunks of a file: of those that begin in `from..to`, which are whole.
#[derive(Debug, Default)]
pub(crate) struct LongChunks {
    from: u64,
    to: u64,
    /// In order.
    whole: Vec<u64>,
    /// Where the file ends, if it was read to there.
    end: Option<u64>,
}

impl LongChunks {
    /// Whether the file is known to end before byte `end`.
    pub(crate) fn is_cut(&self, end: u64) -> bool {
        self.end.is_some_and(|file_end| file_end < end)
    }

    /// Whether the long chunk that begins at `offset` is whole, if that is known.
    pub(crate) fn is_whole(&self, offset: u64) -> Option<bool> {
        let known = (self.from..self.to).contains(&offset);
        known.then(|| self.whole.binary_search(&offset).is_ok())
    }
}

/// Whether the bytes behind damage look like the beginning of a long chunk: those that this version writes. The others
/// are known only where they follow a whole chunk.
pub(super) fn may_be_one(bytes: &[u8]) -> bool {
    let Head::Of { kind, len, head_bytes } = head(bytes) else { return false };
    let payload = &bytes[head_bytes..];
    len > CHUNK_HELD_MAX
        && match kind {
            types::STRETCH => stretch::may_begin_with(payload),
            types::FOREIGN => foreign::may_begin_with(payload),
            _ => false,
        }
}

/// Where something is to be done, in order of places.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Stop {
    at: u64,
    what: What,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum What {
    /// The CRC of a candidate is stored here.
    Crc {
        /// Where it begins.
        start: u64,
        /// The CRC of all bytes up to there.
        crc_before: u32,
        /// It follows a whole chunk.
        in_step: bool,
    },
    /// A chunk begins here, as the one before it is whole.
    Front,
}

/// The way through a file that finds its long chunks. Bytes are pushed in, in order, and are not kept.
#[derive(Debug)]
pub(crate) struct Search {
    from: u64,
    /// The next byte.
    at: u64,
    /// Of the bytes from `from` to `at`.
    crc: u32,
    stops: BinaryHeap<Reverse<Stop>>,
    whole: Vec<u64>,
    /// It began at a long chunk, which turned out to be whole: nothing else was asked for.
    is_answered: bool,
}

impl Search {
    /// From byte `from` on. `in_step`: a chunk begins there, as what lies before it is whole.
    pub(crate) fn new(from: u64, in_step: bool) -> Self {
        let mut stops = BinaryHeap::new();
        if in_step {
            stops.push(Reverse(Stop { at: from, what: What::Front }));
        }
        Self { from, at: from, crc: 0, stops, whole: Vec::new(), is_answered: false }
    }

    /// Where it began: the reader goes back there.
    pub(crate) fn from(&self) -> u64 {
        self.from
    }

    /// No more bytes are needed.
    pub(crate) fn is_answered(&self) -> bool {
        self.is_answered
    }

    /// What was found.
    pub(crate) fn finish(mut self) -> LongChunks {
        // They were found in the order of their ends, and one may begin within another.
        self.whole.sort_unstable();
        let (to, end) =
            if self.is_answered { (self.from + 1, None) } else { (u64::MAX, Some(self.at)) };
        LongChunks { from: self.from, to, whole: self.whole, end }
    }

    /// The bytes that come next, and whether they are the last; says how many it is done with. The others have to come
    /// again, with what follows.
    pub(crate) fn push(&mut self, bytes: &[u8], complete: bool) -> usize {
        let start = self.at;
        let end = if complete { bytes.len() } else { bytes.len().saturating_sub(FRONT_BYTES) };
        let mut from = 0;
        while from < end && !self.is_answered {
            let next = next_candidate(&bytes[..end], from);
            self.settle(start + next as u64, start, bytes);
            if next < end && may_be_one(&bytes[next..]) && self.stops.len() < CANDIDATES_MAX {
                self.advance(start + next as u64, start, bytes);
                self.follow(start + next as u64, false, &bytes[next..]);
            }
            from = next + 1;
        }
        if !self.is_answered {
            self.settle(start + end as u64, start, bytes);
            self.advance(start + end as u64, start, bytes);
        }
        end
    }

    /// Does what is to be done before byte `to`.
    fn settle(&mut self, to: u64, start: u64, bytes: &[u8]) {
        while let Some(&Reverse(Stop { at, what })) = self.stops.peek() {
            if at >= to || self.is_answered {
                return;
            }
            self.stops.pop();
            self.advance(at, start, bytes);
            let Some(rest) = at.checked_sub(start).and_then(|by| bytes.get(by as usize..)) else {
                continue;
            };
            match what {
                What::Front => {
                    // A chunk that was followed more than once ends here as often; the next one is followed once.
                    while self.stops.peek() == Some(&Reverse(Stop { at, what })) {
                        self.stops.pop();
                    }
                    self.follow(at, true, rest);
                }
                What::Crc { start: chunk, crc_before, in_step } => {
                    let crc = self.crc ^ moved(crc_before, at - chunk);
                    if rest.first_chunk::<CRC_BYTES>() == Some(&crc.to_le_bytes()) {
                        self.found(chunk, at + CRC_BYTES as u64, in_step);
                    }
                }
            }
        }
    }

    /// A whole chunk: it is found once as a candidate, and once as what follows a whole one. The two stops are next to
    /// each other.
    fn found(&mut self, chunk: u64, end: u64, in_step: bool) {
        let is_known = self.whole.last() == Some(&chunk);
        if end - chunk > CHUNK_HELD_MAX && !is_known && self.whole.len() < FOUND_MAX {
            self.whole.push(chunk);
        }
        self.is_answered = in_step && chunk == self.from;
        self.stops.push(Reverse(Stop { at: end, what: What::Front }));
    }

    /// Follows what begins here to its CRC.
    fn follow(&mut self, at: u64, in_step: bool, bytes: &[u8]) {
        if let Head::Of { len, .. } = head(bytes) {
            let what = What::Crc { start: at, crc_before: self.crc, in_step };
            self.stops.push(Reverse(Stop { at: at + len - CRC_BYTES as u64, what }));
        }
    }

    /// The CRC up to byte `to`.
    fn advance(&mut self, to: u64, start: u64, bytes: &[u8]) {
        let part = |at: u64| at.checked_sub(start).and_then(|by| usize::try_from(by).ok());
        if let (Some(from), Some(end)) = (part(self.at), part(to))
            && let Some(passed) = bytes.get(from..end)
        {
            self.crc = append(self.crc, passed);
            self.at = to;
        }
    }
}

/// The first place at or after `from` whose byte is a type that a long chunk may have, or the end.
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

    use super::*;
    use crate::chunk;

    /// A FOREIGN of zeros that is just too long to be held.
    fn long_chunk() -> Vec<u8> {
        let mut payload = vec![1, b'a', 0];
        payload.resize(CHUNK_HELD_MAX as usize, 0);
        let mut chunk = Vec::new();
        chunk::put(&mut chunk, types::FOREIGN, &payload).unwrap();
        chunk
    }

    /// Each of them would be followed once for every one before it, if a match were counted as often as it is found:
    /// after 362 chunks 65 703 matches would have filled the list.
    #[test]
    fn each_of_many_long_chunks_behind_damage_is_found_once() {
        const CHUNKS: usize = 400;
        let chunk = long_chunk();
        let mut search = Search::new(0, false);
        let mut waiting = VecDeque::from([0_u8; 100]);
        let (mut offsets, mut at, mut stops_max) = (Vec::new(), waiting.len() as u64, 0);
        for number in 0..CHUNKS {
            offsets.push(at);
            at += chunk.len() as u64;
            waiting.extend(&chunk);
            let done = search.push(waiting.make_contiguous(), number + 1 == CHUNKS);
            waiting.drain(..done);
            stops_max = stops_max.max(search.stops.len());
        }
        let found = search.whole.len();
        let long = search.finish();
        let missed = offsets.iter().position(|&offset| long.is_whole(offset) != Some(true));
        assert_eq!((missed, found), (None, CHUNKS));
        // The chunk that is followed as a candidate and as what follows a whole one.
        assert!(stops_max <= 2, "{stops_max}");
        assert_eq!(long.is_whole(offsets[1] + 1), Some(false));
    }
}

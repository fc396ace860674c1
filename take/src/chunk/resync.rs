//! The next chunk behind damage, in the part of a file that is in memory.

use super::{CRC_BYTES, Front, Head, crc_matches, head, long, marks::Marks, split, types};

/// Longest candidate that is hashed: about what the way over the marks costs.
const HASHED_BYTES: usize = 2048;

/// Bytes compared with zero at once.
const ZEROS: [u8; 64] = [0; 64];

/// What a look at some bytes found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Next {
    /// A whole chunk of a known type begins here.
    At(usize),
    /// None begins before here. What may begin here ends behind the bytes.
    Until(usize),
    /// None begins before here. What may begin here is too long for the window, and the file has to be searched for
    /// [long chunks](super::Search).
    Unknown(usize),
}

/// Looks for a whole chunk at or after `from`. `complete`: the file ends where the bytes do. `is_long_whole` says of a
/// place whether a long chunk that begins there is whole, if that is known.
///
/// Every byte that may be a type is a candidate, and coded bytes are full of them, most with a length that fits. So the
/// CRC of a long candidate is not hashed but computed from CRCs at marks: the work grows with the bytes, not with their
/// product with the lengths. `marks` are those of the bytes, and outlive the search: the next one, behind a small chunk,
/// meets the same bytes.
pub(crate) fn resync(
    bytes: &[u8],
    marks: &mut Marks,
    from: usize,
    complete: bool,
    is_long_whole: impl Fn(usize) -> Option<bool>,
) -> Next {
    let mut at = from;
    while let Some(&kind) = bytes.get(at) {
        if kind == 0 {
            at += zeros(&bytes[at..]);
            continue;
        }
        if types::ALL.contains(&kind) {
            match look(bytes, at, marks) {
                Candidate::Whole => return Next::At(at),
                Candidate::No => {}
                Candidate::Short if complete => {}
                Candidate::Short => return Next::Until(at),
                Candidate::Long if complete => {}
                Candidate::Long => match is_long_whole(at) {
                    Some(true) => return Next::At(at),
                    Some(false) => {}
                    None if long::may_be_one(&bytes[at..]) => return Next::Unknown(at),
                    None => {}
                },
            }
        }
        at += 1;
    }
    Next::Until(bytes.len())
}

/// What may begin somewhere.
enum Candidate {
    Whole,
    No,
    /// Its end is not in memory.
    Short,
    /// Nor will it be before it is known to be whole.
    Long,
}

fn look(bytes: &[u8], at: usize, marks: &mut Marks) -> Candidate {
    let len = match head(&bytes[at..]) {
        Head::Bad => return Candidate::No,
        Head::Short(_) => return Candidate::Short,
        Head::Of { len, .. } => len,
    };
    let end = usize::try_from(len).ok().and_then(|len| at.checked_add(len));
    let Some(end) = end.filter(|&end| end <= bytes.len()) else {
        let is_long = len > super::CHUNK_HELD_MAX;
        return if is_long { Candidate::Long } else { Candidate::Short };
    };
    if is_whole(bytes, at, end, marks) { Candidate::Whole } else { Candidate::No }
}

/// The same as [`front`](super::front) of `bytes[at..]`, with the marks of `bytes`.
pub(crate) fn front_by_marks<'a>(bytes: &'a [u8], at: usize, marks: &mut Marks) -> Front<'a> {
    match split(&bytes[at..]) {
        Front::Whole { len, .. } if !is_whole(bytes, at, at + len, marks) => Front::Damaged,
        front => front,
    }
}

/// Whether the CRC of the chunk that is `bytes[at..end]` matches.
fn is_whole(bytes: &[u8], at: usize, end: usize, marks: &mut Marks) -> bool {
    if end - at <= HASHED_BYTES {
        return crc_matches(&bytes[at..end]);
    }
    let crc_at = end - CRC_BYTES;
    let crc = marks.crc(bytes, at, crc_at);
    bytes[crc_at..].first_chunk::<CRC_BYTES>() == Some(&crc.to_le_bytes())
}

/// How many zeros these bytes begin with: no type is zero, and files with holes have gigabytes of them.
pub(super) fn zeros(bytes: &[u8]) -> usize {
    let blocks = bytes.chunks_exact(ZEROS.len()).take_while(|block| **block == ZEROS).count();
    let at = blocks * ZEROS.len();
    at + bytes[at..].iter().take_while(|&&byte| byte == 0).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chunk::{Front, front, put};

    fn next(bytes: &[u8]) -> Next {
        resync(bytes, &mut Marks::default(), 1, true, |_| None)
    }

    #[test]
    fn behind_every_mutation_the_next_chunk_is_found() {
        let mut bytes = Vec::new();
        put(&mut bytes, types::STRETCH, b"first").unwrap();
        let len = bytes.len();
        put(&mut bytes, types::LEDGER, &[7; 300]).unwrap();
        for at in 0..len {
            for flip in 1..=255_u8 {
                let mut damaged = bytes.clone();
                damaged[at] ^= flip;
                assert_eq!(next(&damaged), Next::At(len), "{at} {flip}");
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
        let found = bytes.len();
        for _ in 0..3 {
            put(&mut bytes, types::STRETCH, &payload(2_000_000)).unwrap();
        }
        bytes[150_000] ^= 1;
        assert_eq!(front(&bytes), Front::Damaged);
        assert_eq!(next(&bytes), Next::At(found));
        // With its end not there yet, nothing behind its beginning is judged.
        let marks = &mut Marks::default();
        let found_part = resync(&bytes[..found + 1000], marks, 1, false, |_| Some(false));
        let Next::Until(at) = found_part else { panic!("the end of the next chunk is not there") };
        assert!(at <= found);
    }

    #[test]
    fn zeros_are_passed_over_and_counted() {
        for n in [0, 1, 63, 64, 65, 1000] {
            let mut bytes = vec![0; n];
            assert_eq!(zeros(&bytes), n);
            bytes.extend([7, 0, 0]);
            assert_eq!(zeros(&bytes), n);
        }
    }
}

//! A chunk whose head alone is damaged: where the next chunk begins tells its length, and its CRC its type.

use crc32fast::Hasher;

use crate::{
    chunk::{PAYLOAD_BYTES_MAX, types},
    varint,
};

/// Type and length of a chunk are at most so long.
const HEAD_BYTES_MAX: u64 = 6;

/// CRC-32.
const CRC_BYTES: usize = 4;

/// Puts the head of the one chunk that `region` is right, if there is a type with which its CRC matches; says
/// whether it did. Of twelve types one fits by chance in one of 3.6 * 10^8 damaged regions.
pub(crate) fn head(region: &mut [u8]) -> bool {
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

/// How long the payload of a chunk of so many bytes is.
fn payload_len(chunk_len: u64) -> Option<u64> {
    let varint_len = |value: u64| u64::from(64 - (value | 1).leading_zeros()).div_ceil(7);
    let mut lens = (2..=HEAD_BYTES_MAX).filter_map(|head| {
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
    fn type_and_length_come_back_and_nothing_else_does() {
        for n in [0, 1, 100, 126, 127, 128, 129, 16_383, 16_384, 20_000] {
            let payload: Vec<u8> = (0..n).map(|i| (i * 7) as u8).collect();
            let mut good = Vec::new();
            chunk::put(&mut good, types::STRETCH, &payload).unwrap();
            let head_len = good.len() - n - CRC_BYTES;
            for at in 0..good.len().min(300) {
                let mut damaged = good.clone();
                damaged[at] ^= 0x41;
                assert_eq!(head(&mut damaged), at < head_len, "byte {at} of {n}");
                assert_eq!(damaged == good, at < head_len, "byte {at} of {n}");
            }
            let mut gone = good.clone();
            gone[..head_len].fill(0);
            assert!(head(&mut gone) && gone == good, "{n}");
            assert!(!head(&mut good[1..].to_vec()));
        }
        assert!(!head(&mut []));
        assert!(!head(&mut [0; 5]));
    }
}

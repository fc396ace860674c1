//! Bytes that no encoder wrote, damage in the middle of a stream, and valid blocks in the wrong place give an error or
//! samples, never a panic, and never unbounded work or memory; decoding recovers at the next key.

use std::time::{Duration, Instant};

use mocapd_codec::{BlockDecoder, CodecError, DecodedRows, Settings};
use proptest::prelude::*;

use super::{Block, Channel, KINDS, Stretch, check, cut, encode, motions::Random, settings};

/// Decodes the only block of a group, checks that the result is well formed, and returns whether decoding succeeded.
fn survive(kind: &str, block: &[u8], shared: &[u8], n_rows: usize) -> bool {
    let settings = settings(kind, 0.5);
    let mut decoded = Vec::new();
    let fine = settings.decoder().decode(block, shared, n_rows, true, &mut decoded).is_ok();
    assert!(fine || decoded.is_empty());
    for rows in &decoded {
        assert_eq!(rows.positions.len(), n_rows);
        assert_eq!(rows.present.len(), n_rows);
        assert_eq!(rows.kept.len(), n_rows);
        assert!(rows.positions.iter().flatten().all(|v| v.is_finite()));
        assert!((0.0..=0.5).contains(&rows.max_error_mm));
    }
    fine
}

#[test]
fn every_truncation_and_every_changed_byte() {
    for kind in KINDS {
        let has_range_coder = matches!(kind, "dense" | "lossless:predictive");
        for group in [
            &[("smooth", "all")][..],
            &[("walk", "gaps"), ("extreme", "singles"), ("steps", "all")],
        ] {
            let channels: Vec<_> =
                group.iter().map(|(motion, gaps)| Channel::new(motion, gaps, 21, 75)).collect();
            let block = encode(settings(kind, 0.5), &cut(&channels, &[75], 0)).remove(0);
            assert!(survive(kind, &block.bytes, &block.shared, 75));
            for len in 1..block.bytes.len() {
                // The range coder drops trailing zeros, so its kinds do not detect every truncation.
                let fine = survive(kind, &block.bytes[..len], &block.shared, 75);
                assert!(!fine || has_range_coder, "{kind}: cut at {len}");
            }
            for at in 0..block.bytes.len() {
                for flip in [0x01, 0x80, 0xff, 0x10] {
                    let mut bytes = block.bytes.clone();
                    bytes[at] ^= flip;
                    survive(kind, &bytes, &block.shared, 75);
                }
            }
            for at in 0..block.shared.len() {
                for flip in [0x01, 0x80, 0xff] {
                    let mut shared = block.shared.clone();
                    shared[at] ^= flip;
                    survive(kind, &block.bytes, &shared, 75);
                }
            }
            let mut longer = block.bytes.clone();
            longer.extend([1, 1]);
            let is_read = survive(kind, &longer, &block.shared, 75);
            assert!(!is_read || has_range_coder, "{kind}: extra bytes");
            survive(kind, &block.bytes, &block.shared, 0);
            survive(kind, &block.bytes, &block.shared, 74);
            survive(kind, &block.bytes, &block.shared, 76);
        }
    }
}

/// Heads and presence sections that no encoder writes.
#[test]
fn invalid_heads_and_presence_sections() {
    for (bytes, what) in [
        (&[0x00, 0][..], "no number of channels after a key"),
        (&[0x40, 0], "no channels"),
        (&[0x40, 65], "more channels than a group has"),
        (&[0x40, 0x81, 0x00], "a number that is not in its shortest form"),
        (&[0xc0, 1, 5, 0], "a section that is cut short"),
        (&[0xc0, 1, 0], "a section that states that all rows are present"),
        (&[0xc0, 1, 1, 0xff], "one channel, and it has no sample"),
        (&[0x41, 1], "a lossless block that states an error"),
    ] {
        assert!(!survive("lossless", bytes, &[], 20), "{what}");
    }
    // One more channel, without any sample.
    let channels = [Channel::new("walk", "all", 1, 20), Channel::new("walk", "none", 1, 20)];
    let block = encode(settings("lossless", 0.5), &cut(&channels, &[20], 0)).remove(0);
    assert_eq!(block.bytes[..2], [0x40, 1]);
    let mut more = block.bytes.clone();
    more[1] = 2;
    assert!(!survive("lossless", &more, &[], 20));
}

/// Decoding time grows with the rows and channels, not with numbers in the bytes. The limit detects hangs: such
/// a block takes less than a hundredth of it.
#[test]
fn decoding_time_is_bounded() {
    for kind in KINDS {
        let mut random = Random(1);
        let noise: Vec<u8> = (0..4000).map(|_| random.below(256) as u8).collect();
        for filling in [vec![0; 4000], vec![0xff; 4000], noise] {
            for gaps in [0, 0x80] {
                let head = 0x40 | gaps | if kind.starts_with("lossless") { 0 } else { 63 };
                let block = [&[head, 64][..], &filling].concat();
                let since = Instant::now();
                survive(kind, &block, &[0; 1000], 1000);
                assert!(since.elapsed() < Duration::from_secs(20), "{kind}: {:?}", since.elapsed());
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn random_bytes(
        kind in proptest::sample::select(KINDS.to_vec()),
        block in proptest::collection::vec(any::<u8>(), 0..200),
        shared in proptest::collection::vec(any::<u8>(), 0..20),
        n_rows in 0_usize..200,
    ) {
        survive(kind, &block, &shared, n_rows);
    }

    /// Random bytes after a well-formed head, with and without a presence section.
    #[test]
    fn random_payloads(
        kind in proptest::sample::select(KINDS.to_vec()),
        mut block in proptest::collection::vec(any::<u8>(), 4..300),
        n_channels in 1_u8..65,
        gaps in any::<bool>(),
        n_rows in 1_usize..100,
    ) {
        block[0] = 0x40 | if kind.starts_with("lossless") { 0 } else { 31 } | if gaps { 0x80 } else { 0 };
        block[1] = n_channels;
        block[2] %= 64;
        survive(kind, &block, &[], n_rows);
    }
}

pub(crate) const ROWS: usize = 24;
const BLOCKS: usize = 6;
/// Block 4 is the next key.
pub(crate) const NEXT_KEY: usize = 4;

pub(crate) fn group(kind: &str) -> (Settings, Vec<Stretch>, Vec<Block>) {
    let settings = settings(kind, 0.5);
    let channels = [("smooth", "all"), ("walk", "gaps"), ("steps", "singles"), ("far", "late")];
    let channel = |(motion, gaps)| Channel::new(motion, gaps, 33, ROWS * BLOCKS);
    let stretches = cut(&channels.map(channel), &[ROWS; BLOCKS], 1 << NEXT_KEY);
    let blocks = encode(settings, &stretches);
    (settings, stretches, blocks)
}

pub(crate) fn well_formed(n_rows: usize, decoded: &[DecodedRows]) {
    for rows in decoded {
        assert_eq!(
            (rows.positions.len(), rows.present.len(), rows.kept.len()),
            (n_rows, n_rows, n_rows)
        );
        assert!(rows.positions.iter().flatten().all(|v| v.is_finite()));
        assert!((0.0..=0.5).contains(&rows.max_error_mm));
    }
}

/// A decoder that has decoded the first `n` blocks without damage.
fn after(
    settings: Settings,
    stretches: &[Stretch],
    blocks: &[Block],
    n: usize,
) -> (Box<dyn BlockDecoder>, Vec<DecodedRows>) {
    let (mut decoder, mut decoded) = (settings.decoder(), Vec::new());
    for (stretch, Block { bytes, shared, .. }) in stretches.iter().zip(blocks).take(n) {
        decoder.decode(bytes, shared, ROWS, stretch.key, &mut decoded).unwrap();
    }
    (decoder, decoded)
}

/// Decodes a stream in which `change` damages block `at`, and checks recovery.
fn recovers_after(kind: &str, at: usize, change: impl Fn(&mut Vec<u8>, &mut usize)) {
    let (settings, stretches, blocks) = group(kind);
    recovers_among((settings, &stretches, &blocks), at, change);
}

fn recovers_among(
    (settings, stretches, blocks): (Settings, &[Stretch], &[Block]),
    at: usize,
    change: impl Fn(&mut Vec<u8>, &mut usize),
) {
    let (mut decoder, mut decoded) = after(settings, stretches, blocks, at);
    let (mut bytes, mut n_rows) = (blocks[at].bytes.clone(), ROWS);
    change(&mut bytes, &mut n_rows);
    let mut lost = decoder
        .decode(&bytes, &blocks[at].shared, n_rows, stretches[at].key, &mut decoded)
        .is_err();
    assert!(!lost || decoded.is_empty(), "a failed block returns rows");
    well_formed(n_rows, &decoded);
    for (stretch, block) in stretches.iter().zip(blocks).skip(at + 1) {
        let Block { bytes, shared, .. } = block;
        let outcome = decoder.decode(bytes, shared, ROWS, stretch.key, &mut decoded);
        if stretch.key {
            assert_eq!(outcome, Ok(()));
        } else if lost {
            assert_eq!(outcome, Err(CodecError::OutOfStep));
        }
        lost = outcome.is_err();
        well_formed(ROWS, &decoded);
        if std::ptr::eq(stretch, &raw const stretches[NEXT_KEY]) {
            check(settings, stretch, block, &decoded);
        }
    }
    // The block after the key decodes correctly.
    check(settings, &stretches[BLOCKS - 1], &blocks[BLOCKS - 1], &decoded);
}

#[test]
fn every_truncation_in_a_stream() {
    for kind in KINDS {
        let (settings, stretches, blocks) = group(kind);
        for at in [0, 2] {
            for len in 0..blocks[at].bytes.len() {
                recovers_among((settings, &stretches, &blocks), at, |bytes, _| bytes.truncate(len));
            }
        }
    }
}

#[test]
fn every_changed_byte_in_a_stream() {
    for kind in KINDS {
        let (settings, stretches, blocks) = group(kind);
        for at in [0, 2] {
            for i in 0..blocks[at].bytes.len() {
                for flip in [0x01, 0x10, 0x80, 0xff] {
                    recovers_among((settings, &stretches, &blocks), at, |bytes, _| {
                        bytes[i] ^= flip;
                    });
                }
            }
        }
    }
}

#[test]
fn other_numbers_of_rows_than_were_encoded() {
    for kind in KINDS {
        for n_rows in [0, 1, ROWS - 1, ROWS + 1, 1000] {
            recovers_after(kind, 2, |_, rows| *rows = n_rows);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn any_bytes_in_a_stream(
        kind in proptest::sample::select(KINDS.to_vec()),
        at in 0..NEXT_KEY,
        new in proptest::collection::vec(any::<u8>(), 0..150),
        n_rows in 0..80_usize,
    ) {
        recovers_after(kind, at, |bytes, rows| {
            bytes.clone_from(&new);
            *rows = n_rows;
        });
    }

    /// Several changed, removed and inserted bytes anywhere in a block.
    #[test]
    fn any_changes_in_a_stream(
        kind in proptest::sample::select(KINDS.to_vec()),
        at in 0..NEXT_KEY,
        changes in proptest::collection::vec(
            (any::<proptest::sample::Index>(), any::<u8>(), 0..3_u8),
            1..6,
        ),
    ) {
        recovers_after(kind, at, |bytes, _| {
            for (index, value, what) in &changes {
                let i = index.index(bytes.len() + 1);
                match what {
                    0 if i < bytes.len() => bytes[i] ^= value,
                    1 if i < bytes.len() => drop(bytes.remove(i)),
                    _ => bytes.insert(i, *value),
                }
            }
        });
    }
}

/// Missing, repeated and swapped blocks.
#[test]
fn blocks_out_of_order() {
    for kind in KINDS {
        let (settings, stretches, blocks) = group(kind);
        for order in [&[0, 2, 3, 4, 5][..], &[0, 1, 1, 2, 4, 5], &[0, 3, 2, 1, 4, 5], &[1, 2, 4, 5]]
        {
            let (mut decoder, mut decoded) = (settings.decoder(), Vec::new());
            for &i in order {
                let Block { bytes, shared, .. } = &blocks[i];
                let outcome = decoder.decode(bytes, shared, ROWS, stretches[i].key, &mut decoded);
                assert!(outcome.is_ok() || !stretches[i].key);
                well_formed(ROWS, &decoded);
                if i >= NEXT_KEY {
                    check(settings, &stretches[i], &blocks[i], &decoded);
                }
            }
        }
    }
}

/// The blocks of one resampler, decoded by another one with another tolerance.
#[test]
fn blocks_of_another_take() {
    for kind in KINDS {
        for other in KINDS {
            let (_, stretches, blocks) = group(other);
            let (mut decoder, mut decoded) = (settings(kind, 0.4).decoder(), Vec::new());
            for (stretch, Block { bytes, shared, .. }) in stretches.iter().zip(&blocks) {
                let outcome = decoder.decode(bytes, shared, ROWS, stretch.key, &mut decoded);
                assert!(outcome.is_ok() || decoded.is_empty());
                well_formed(ROWS, &decoded);
            }
        }
    }
}

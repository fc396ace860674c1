//! Damage in the middle of a stream gives an error or samples, and decoding recovers at the next key.

use mocapd_codec::{BlockDecoder, CodecError, DecodedRows, Settings};
use proptest::prelude::*;

use super::{Block, Channel, KINDS, Stretch, check, cut, encode, settings};

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
fn survive(kind: &str, at: usize, change: impl Fn(&mut Vec<u8>, &mut usize)) {
    let (settings, stretches, blocks) = group(kind);
    survive_in((settings, &stretches, &blocks), at, change);
}

fn survive_in(
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
                survive_in((settings, &stretches, &blocks), at, |bytes, _| bytes.truncate(len));
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
                    survive_in((settings, &stretches, &blocks), at, |bytes, _| bytes[i] ^= flip);
                }
            }
        }
    }
}

#[test]
fn other_numbers_of_rows_than_were_encoded() {
    for kind in KINDS {
        for n_rows in [0, 1, ROWS - 1, ROWS + 1, 1000] {
            survive(kind, 2, |_, rows| *rows = n_rows);
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
        survive(kind, at, |bytes, rows| {
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
        survive(kind, at, |bytes, _| {
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

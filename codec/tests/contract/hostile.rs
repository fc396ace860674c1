//! Bytes that no encoder wrote: an error or samples, never a panic, never unbounded work or memory.

use mocapd_codec::DecodedRows;
use proptest::prelude::*;

use super::{
    KINDS, Stretch, encode,
    motions::{positions, presence},
    settings,
};

/// Decodes as the only block of a channel and checks that whatever comes out is well formed.
fn survive(kind: &str, block: &[u8], shared: &[u8], n_rows: usize) -> bool {
    let settings = settings(kind, 0.5);
    let mut decoded = DecodedRows::default();
    let fine = settings.decoder().decode(block, shared, n_rows, true, &mut decoded).is_ok();
    assert_eq!(decoded.positions.len(), n_rows);
    assert_eq!(decoded.present.len(), n_rows);
    assert_eq!(decoded.kept.len(), n_rows);
    assert!(decoded.positions.iter().flatten().all(|v| v.is_finite()));
    assert!((0.0..=0.5).contains(&decoded.max_error_mm));
    fine
}

fn samples(motion: &str, gaps: &str) -> Stretch {
    Stretch { positions: positions(motion, 21, 75), present: presence(gaps, 21, 75), key: true }
}

#[test]
fn every_truncation_and_every_changed_byte() {
    for kind in KINDS {
        for (motion, gaps) in [("smooth", "all"), ("walk", "gaps"), ("extreme", "all")] {
            let block = encode(settings(kind, 0.5), &[samples(motion, gaps)]).remove(0);
            assert!(survive(kind, &block.bytes, &block.shared, 75));
            for len in 1..block.bytes.len() {
                // Trailing zeros are not stored by the range coder: dense cannot tell every cut.
                let fine = survive(kind, &block.bytes[..len], &block.shared, 75);
                assert!(!fine || kind == "dense", "{kind}: cut at {len}");
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
            longer.push(1);
            longer.push(1);
            let dense = kind == "dense";
            assert!(!survive(kind, &longer, &block.shared, 75) || dense, "{kind}: bytes too many");
            survive(kind, &block.bytes, &block.shared, 0);
            survive(kind, &block.bytes, &block.shared, 74);
            survive(kind, &block.bytes, &block.shared, 76);
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

    /// Behind a head byte that is well formed.
    #[test]
    fn random_payloads(
        kind in proptest::sample::select(KINDS.to_vec()),
        mut block in proptest::collection::vec(any::<u8>(), 1..200),
        n_rows in 1_usize..100,
    ) {
        block[0] = if kind == "lossless" { 0 } else { 64 };
        survive(kind, &block, &[], n_rows);
    }
}

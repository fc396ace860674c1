//! Bytes that no encoder wrote give an error or samples, never a panic, and never unbounded work or memory.

use std::time::{Duration, Instant};

use proptest::prelude::*;

use super::{Channel, KINDS, cut, encode, motions::Random, settings};

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

//! State across blocks: what it saves, that a key block forgets it, and that it is never lost in step.

use mocapd_codec::{CodecError, DecodedRows};

use super::{
    Stretch, check, encode,
    motions::{positions, presence},
    settings,
};

const LIVE: [&str; 3] = ["dense", "fast", "lossless"];

fn channel(gaps: &str, key_every: usize) -> Vec<Stretch> {
    let (positions, present) = (positions("smooth", 9, 600), presence(gaps, 9, 600));
    let pairs = positions.chunks(60).zip(present.chunks(60));
    pairs
        .enumerate()
        .map(|(i, (positions, present))| Stretch {
            positions: positions.to_vec(),
            present: present.to_vec(),
            key: i % key_every == 0,
        })
        .collect()
}

#[test]
fn a_decoder_may_start_at_any_key_block() {
    for kind in LIVE {
        for gaps in ["all", "gaps"] {
            let settings = settings(kind, 0.5);
            let stretches = channel(gaps, 4);
            let blocks = encode(settings, &stretches);
            assert_eq!(blocks[4..], encode(settings, &stretches[4..]), "{kind}: a key remembers");
            let mut decoder = settings.decoder();
            let mut decoded = DecodedRows::default();
            for (stretch, block) in stretches.iter().zip(&blocks).skip(4) {
                decoder.decode(&block.bytes, &[], 60, stretch.key, &mut decoded).unwrap();
                check(settings, stretch, block, &decoded);
            }
        }
    }
}

#[test]
fn state_saves_bytes() {
    for kind in LIVE {
        let settings = settings(kind, 0.5);
        let bytes = |key_every| -> usize {
            encode(settings, &channel("all", key_every)).iter().map(|b| b.bytes.len()).sum()
        };
        assert!(bytes(100) < bytes(1), "{kind}: {} and {}", bytes(100), bytes(1));
    }
}

#[test]
fn after_an_error_only_a_key_block_is_taken() {
    for kind in LIVE {
        let settings = settings(kind, 0.5);
        let stretches = channel("all", 5);
        let blocks = encode(settings, &stretches);
        let mut decoder = settings.decoder();
        let mut decoded = DecodedRows::default();
        decoder.decode(&blocks[0].bytes, &[], 60, true, &mut decoded).unwrap();
        // Presence runs that cover nothing.
        assert!(decoder.decode(&[0x81, 0], &[], 60, false, &mut decoded).is_err());
        assert!(decoded.present.iter().all(|&p| !p), "a failed block leaves rows behind");
        let next = decoder.decode(&blocks[1].bytes, &[], 60, false, &mut decoded);
        assert!(matches!(next, Err(CodecError::Corrupt(m)) if m.contains("key block")));
        decoder.decode(&blocks[5].bytes, &[], 60, true, &mut decoded).unwrap();
        check(settings, &stretches[5], &blocks[5], &decoded);
    }
}

#[test]
fn a_raw_block_in_between_does_not_break_step() {
    for kind in ["dense", "fast"] {
        let settings = settings(kind, 1e-3);
        let mut stretches = channel("all", 100);
        // Beyond every lattice: this block can only be stored raw.
        stretches[3].positions[20] = [f32::MAX; 3];
        stretches[6].present.fill(false);
        let blocks = encode(settings, &stretches);
        assert_eq!(blocks[3].report.recoded, 1);
        assert_eq!(blocks[3].report.max_error_mm, 0.0);
        assert_eq!(blocks[4].report.recoded, 0);
        let mut decoder = settings.decoder();
        let mut decoded = DecodedRows::default();
        for (stretch, block) in stretches.iter().zip(&blocks) {
            decoder.decode(&block.bytes, &[], 60, stretch.key, &mut decoded).unwrap();
            check(settings, stretch, block, &decoded);
        }
    }
}

#[test]
fn a_marker_at_rest_costs_next_to_nothing() {
    let settings = settings("dense", 0.5);
    let at_rest: Vec<Stretch> = (0..20)
        .map(|i| Stretch {
            positions: positions("constant", 1, 30),
            present: vec![true; 30],
            key: i == 0,
        })
        .collect();
    let blocks = encode(settings, &at_rest);
    assert!(blocks.iter().skip(3).all(|b| b.bytes.len() == 1), "only the head byte is left");
}

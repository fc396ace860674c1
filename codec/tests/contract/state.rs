//! State across blocks: it saves bytes, a key block resets it, and encoder and decoder stay synchronised.

use mocapd_codec::{BlockReport, CodecError};

use super::{Channel, Stretch, check, cut, decode_and_check, encode, settings};

const LIVE: [&str; 4] = ["dense", "fast", "lossless", "lossless:predictive"];

fn group(gaps: &str, key_every: usize) -> Vec<Stretch> {
    let channels: Vec<_> = (9..12).map(|seed| Channel::new("smooth", gaps, seed, 600)).collect();
    let keys = (0..10).filter(|i| i % key_every == 0).fold(0, |keys, i| keys | 1 << i);
    cut(&channels, &[60; 10], keys)
}

#[test]
fn a_decoder_may_start_at_any_key_block() {
    for kind in LIVE {
        for gaps in ["all", "gaps"] {
            let settings = settings(kind, 0.5);
            let stretches = group(gaps, 4);
            let blocks = encode(settings, &stretches);
            assert_eq!(blocks[4..], encode(settings, &stretches[4..]), "{kind}: keys keep state");
            decode_and_check(settings, &stretches[4..], &blocks[4..]);
        }
    }
}

#[test]
fn state_saves_bytes() {
    for kind in LIVE {
        let settings = settings(kind, 0.5);
        let bytes = |key_every| -> usize {
            encode(settings, &group("all", key_every)).iter().map(|b| b.bytes.len()).sum()
        };
        assert!(bytes(100) < bytes(1), "{kind}: {} and {}", bytes(100), bytes(1));
    }
}

#[test]
fn after_an_error_only_a_key_block_is_decoded() {
    for kind in LIVE {
        let settings = settings(kind, 0.5);
        let stretches = group("all", 5);
        let blocks = encode(settings, &stretches);
        let mut decoder = settings.decoder();
        let mut decoded = Vec::new();
        decoder.decode(&blocks[0].bytes, &[], 60, true, &mut decoded).unwrap();
        // A truncated presence section.
        assert!(decoder.decode(&[0x81, 9], &[], 60, false, &mut decoded).is_err());
        assert!(decoded.is_empty(), "a failed block returns rows");
        let next = decoder.decode(&blocks[1].bytes, &[], 60, false, &mut decoded);
        assert_eq!(next, Err(CodecError::OutOfStep));
        decoder.decode(&blocks[5].bytes, &[], 60, true, &mut decoded).unwrap();
        check(settings, &stretches[5], &blocks[5], &decoded);
    }
}

#[test]
fn stretches_without_samples_keep_encoder_and_decoder_synchronised() {
    for kind in LIVE {
        let settings = settings(kind, 1e-3);
        let mut stretches = group("all", 100);
        for channel in &mut stretches[6].channels {
            channel.present.fill(false);
        }
        stretches[3].channels[1].present.fill(false);
        let blocks = encode(settings, &stretches);
        assert!(blocks[6].bytes.is_empty());
        let mut decoder = settings.decoder();
        let mut decoded = Vec::new();
        for (i, (stretch, block)) in stretches.iter().zip(&blocks).enumerate() {
            if i == 6 {
                decoder.skip(false);
                continue;
            }
            decoder.decode(&block.bytes, &[], 60, stretch.key, &mut decoded).unwrap();
            check(settings, stretch, block, &decoded);
        }
    }
}

#[test]
fn markers_at_rest_cost_next_to_nothing() {
    for kind in ["dense", "fast"] {
        let channels =
            [Channel::new("constant", "all", 1, 600), Channel::new("constant", "all", 2, 600)];
        let blocks = encode(settings(kind, 0.5), &cut(&channels, &[30; 20], 0));
        assert!(blocks.iter().skip(3).all(|b| b.bytes.len() <= 5), "{kind}");
    }
}

#[test]
fn prepared_memory_does_not_change_the_bytes() {
    for kind in LIVE {
        let settings = settings(kind, 0.5);
        let stretches = group("gaps", 4);
        let mut encoder = settings.encoder();
        encoder.prepare(64, 240);
        for (stretch, block) in stretches.iter().zip(encode(settings, &stretches)) {
            let (mut out, mut reports) = (Vec::new(), [BlockReport::default(); 3]);
            encoder.encode(&stretch.rows(), &[], stretch.key, &mut out, &mut reports).unwrap();
            assert_eq!((out, &reports[..]), (block.bytes, &block.reports[..]));
        }
    }
}

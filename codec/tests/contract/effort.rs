//! The efforts of `dense`: each decodes within the bound, and more effort never needs more bytes.

use mocapd_codec::{BlockReport, Effort};

use super::{
    Block, Channel, cut, decode_and_check, encode, encode_with,
    motions::{MOTIONS, PRESENCES},
    settings,
};

fn n_bytes(blocks: &[Block]) -> usize {
    blocks.iter().map(|block| block.bytes.len()).sum()
}

/// Markers that move together, each in its own way, with these gaps.
fn body(gaps: &str, n_rows: usize) -> Vec<Channel> {
    (0..10)
        .map(|marker| {
            let phase = marker as f32 * 0.3;
            let mut channel = Channel::new("constant", gaps, marker, n_rows);
            for (row, at) in channel.positions.iter_mut().enumerate() {
                let t = row as f32 / 100.0;
                let swing = (4.0 * t + phase).sin() * (1.0 + (0.7 * t).cos());
                at[0] = 300.0 * (1.3 * t).sin() + 80.0 * phase + 90.0 * swing;
                at[1] = 900.0 + 120.0 * (2.1 * t).cos() + 40.0 * swing;
                at[2] = 400.0 * t + 60.0 * swing * swing;
            }
            channel
        })
        .collect()
}

#[test]
fn every_effort_decodes_within_the_tolerance() {
    for (i, motion) in MOTIONS.into_iter().enumerate() {
        for (k, gaps) in PRESENCES.into_iter().enumerate() {
            // Channels differ in their gaps, and the last one is not seen in every stretch.
            let mut channels: Vec<_> =
                (0..4).map(|seed| Channel::new(motion, gaps, seed, 150)).collect();
            channels.push(Channel::new("smooth", "late", 9, 150));
            let stretches = cut(&channels, &[70, 64, 16], 0b100);
            let settings = settings("dense", [0.1, 1.0, 20.0][(i + k) % 3]);
            // Each level, for every eighth of the mixtures.
            for level in [2 + (3 * i + k) as u8 % 8, 5] {
                let effort = Effort::new(level).unwrap();
                let blocks = encode_with(settings, effort, &stretches);
                decode_and_check(settings, &stretches, &blocks);
            }
        }
    }
}

#[test]
fn the_least_effort_is_that_of_a_recording() {
    for gaps in ["all", "gaps"] {
        let stretches = cut(&body(gaps, 300), &[60; 5], 0b1000);
        for tolerance_mm in [0.1, 1.0, 10.0] {
            let settings = settings("dense", tolerance_mm);
            let mut encoder = settings.encoder();
            for (stretch, block) in
                stretches.iter().zip(encode_with(settings, Effort::MIN, &stretches))
            {
                let mut reports = vec![BlockReport::default(); stretch.channels.len()];
                let mut bytes = Vec::new();
                encoder
                    .encode(&stretch.rows(), &[], stretch.key, &mut bytes, &mut reports)
                    .unwrap();
                assert_eq!((bytes, reports), (block.bytes, block.reports));
            }
        }
    }
}

#[test]
fn more_effort_makes_smaller_blocks() {
    for gaps in ["all", "gaps", "late"] {
        let stretches = cut(&body(gaps, 500), &[500], 0);
        let bytes_at = |tolerance_mm: f64, effort: Effort| {
            n_bytes(&encode_with(settings("dense", tolerance_mm), effort, &stretches)) as f64
        };
        for tolerance_mm in [0.1, 1.0, 10.0] {
            let least = bytes_at(tolerance_mm, Effort::MIN);
            for effort in [2, 3, 5, 7].map(|level| Effort::new(level).unwrap()) {
                let share = bytes_at(tolerance_mm, effort) / least;
                // Probabilities that learnt from other points may cost a little at any effort.
                assert!(share < 1.02, "{gaps} at {tolerance_mm} mm, effort {effort}: {share}");
            }
        }
        // Runs of a quarter of a second, between gaps, leave little to plan.
        let most = if gaps == "gaps" { 1.0 } else { 0.97 };
        let (least, effort) = (bytes_at(1.0, Effort::MIN), Effort::new(5).unwrap());
        let share = bytes_at(1.0, effort) / least;
        assert!(share < most, "{gaps}: {share}");
        if gaps == "all" {
            let most = bytes_at(1.0, Effort::MAX) / least;
            assert!(most < share, "{most} at the greatest effort, {share} before");
        }
    }
}

#[test]
fn an_encoder_is_deterministic() {
    let stretches = cut(&body("gaps", 400), &[100; 4], 0b1111);
    let effort = Effort::new(5).unwrap();
    let settings = settings("dense", 1.0);
    let together = encode_with(settings, effort, &stretches);
    // Key blocks depend on nothing before them: not on the plans of other blocks, either.
    for (stretch, block) in stretches.iter().zip(&together) {
        let alone = encode_with(settings, effort, std::slice::from_ref(stretch));
        assert_eq!(alone[0], *block);
    }
    for kind in ["fast", "lossless", "lossless:predictive"] {
        let settings = super::settings(kind, 1.0);
        assert_eq!(encode_with(settings, effort, &stretches), encode(settings, &stretches));
    }
}

#[test]
fn efforts_are_one_to_nine() {
    for level in 1..=9 {
        let effort: Effort = level.to_string().parse().unwrap();
        assert_eq!((effort.level(), effort.to_string()), (level, level.to_string()));
    }
    for text in ["0", "10", "-1", "", "x"] {
        let error = text.parse::<Effort>().unwrap_err().to_string();
        assert!(error.contains("1 to 9"), "{error}");
    }
}

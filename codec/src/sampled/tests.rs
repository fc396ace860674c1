//! Blocks of generated channels of every kind.

use mocapd_testkit::random::Random;

use super::{SampledDecoder, SampledEncoder, max_block_bytes};
use crate::{CodecError, GROUP_CHANNELS, coding::isa::Isa};

/// Kinds of generated channels.
const KINDS: usize = 13;

/// A nearly normal number.
fn normal(random: &mut Random) -> f64 {
    (0..6).map(|_| random.between(-1.0, 1.0)).sum()
}

/// A channel of a kind.
fn channel(kind: usize, seed: u64, n_rows: usize) -> Vec<f32> {
    let mut random = Random::new(seed ^ (kind as u64) << 32);
    let mut walk = 0.0;
    let mut level = 0.0;
    let mut samples: Vec<f32> = (0..n_rows)
        .map(|row| {
            walk += normal(&mut random);
            level += (walk - level) * 0.05;
            let phase = row % 200;
            match kind {
                // An electrode: noise on a lattice, in bursts.
                0 => {
                    (normal(&mut random) * if phase < 60 { 90.0 } else { 4.0 }).round() as f32
                        * 0.000_305_175_8
                }
                // A force plate: exact zeros between steps.
                1 if phase < 150 => 0.0,
                1 => (phase as f64 - 150.0 + walk).round() as f32 * 0.173,
                // A filtered signal, whose floats use every bit.
                2 => level as f32,
                // Text with three decimals.
                3 => ((level * 1000.0).round() / 1000.0) as f32,
                // White noise.
                4 => normal(&mut random) as f32,
                5 => 4.25,
                6 => [-1.5, 0.25, 7.0, 7.1, 9.0][random.below(5)],
                // Gaps, as NaN of several bit patterns.
                7 if phase > 160 => f32::from_bits(0x7fc0_0000 + (row as u32 / 400)),
                7 => walk as f32,
                8 => f32::from_bits(random.next_u64() as u32),
                9 => [0.0, -0.0, f32::INFINITY, f32::NEG_INFINITY, f32::MIN_POSITIVE / 8.0]
                    [random.below(5)],
                10 => walk.round() as f32 * 1e30,
                11 => (walk * 3.0).round() as f32 * 1e-44,
                _ => walk.round() as f32 * 0.5 + 1013.25,
            }
        })
        .collect();
    // Held twice, or on a line between every second.
    if seed % 3 == 1 {
        (1..n_rows).step_by(2).for_each(|row| samples[row] = samples[row - 1]);
    }
    if seed % 3 == 2 {
        (1..n_rows.saturating_sub(1))
            .step_by(2)
            .for_each(|row| samples[row] = f32::midpoint(samples[row - 1], samples[row + 1]));
    }
    samples
}

fn group(seed: u64, n_channels: usize, n_rows: usize) -> Vec<Vec<f32>> {
    let mut random = Random::new(seed);
    (0..n_channels)
        .map(|i| channel((i + random.below(2)) % KINDS, random.next_u64(), n_rows))
        .collect()
}

/// Encodes in blocks of `rows` rows; every `key_every`th is a key.
fn encode(channels: &[Vec<f32>], rows: usize, key_every: usize) -> Vec<Vec<u8>> {
    let n_rows = channels[0].len();
    let mut encoder = SampledEncoder::new();
    (0..n_rows)
        .step_by(rows)
        .enumerate()
        .map(|(i, start)| {
            let end = (start + rows).min(n_rows);
            let slices: Vec<&[f32]> = channels.iter().map(|samples| &samples[start..end]).collect();
            let mut block = Vec::new();
            encoder.encode(&slices, i % key_every == 0, &mut block).unwrap();
            assert!(block.len() <= max_block_bytes(channels.len(), end - start));
            block
        })
        .collect()
}

/// Decodes blocks of `rows` rows from block `from` on, and compares every bit.
fn check(channels: &[Vec<f32>], blocks: &[Vec<u8>], rows: usize, key_every: usize, from: usize) {
    let n_rows = channels[0].len();
    let mut decoder = SampledDecoder::new();
    for (i, block) in blocks.iter().enumerate().skip(from) {
        let (start, end) = (i * rows, ((i + 1) * rows).min(n_rows));
        let samples = decoder.decode(block, end - start, i % key_every == 0).unwrap();
        for (channel, decoded) in channels.iter().zip(samples.chunks(end - start)) {
            let bits = |samples: &[f32]| samples.iter().map(|s| s.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(decoded), bits(&channel[start..end]), "block {i}");
        }
    }
}

#[test]
fn every_bit_round_trips() {
    for seed in 0..24 {
        let n_rows = [1, 2, 3, 17, 400, 1500][seed as usize % 6];
        let channels = group(seed, [1, 2, 13, 20][seed as usize % 4], n_rows);
        for (rows, key_every) in [(n_rows, 1), (200, 3), (64, 1)] {
            let blocks = encode(&channels, rows, key_every);
            check(&channels, &blocks, rows, key_every, 0);
            if blocks.len() > key_every {
                check(&channels, &blocks, rows, key_every, key_every);
            }
        }
    }
}

#[test]
fn every_kind_round_trips_alone() {
    for kind in 0..KINDS {
        for seed in 0..3 {
            let channels = [channel(kind, seed, 700)];
            check(&channels, &encode(&channels, 250, 2), 250, 2, 0);
        }
    }
}

/// Zeros with a sign among the numbers of a converter, which have none.
#[test]
fn negative_zeros_among_integers_round_trip_in_every_block() {
    for seed in 0..400 {
        let mut random = Random::new(seed);
        let (range, rare) = ([1, 3, 40, 20_000][random.below(4)], 1 + random.below(30));
        let first = random.below(3);
        let mut samples = |block: usize| -> Vec<f32> {
            let of = |_| match random.below(rare) {
                0 if block >= first => -0.0,
                _ => random.between(-f64::from(range), f64::from(range)).round() as i16 as f32,
            };
            (0..40).map(of).collect()
        };
        let channels = [(0..3).flat_map(&mut samples).collect::<Vec<f32>>()];
        check(&channels, &encode(&channels, 40, 2), 40, 2, 0);
    }
    let channels = [vec![-0.0; 120], vec![0.0; 120]];
    check(&channels, &encode(&channels, 40, 2), 40, 2, 0);
}

/// Bytes of a channel of a kind over 4000 rows, per sample.
fn bits_per_sample(kind: usize, seed: u64) -> f64 {
    let channels = [channel(kind, seed, 4000)];
    encode(&channels, 4000, 1)[0].len() as f64 * 8.0 / 4000.0
}

#[test]
fn the_structure_of_channels_is_detected() {
    // Noise of a few steps, between bursts of ninety; a lattice of 16 bits needs no more.
    assert!(bits_per_sample(0, 0) < 6.8, "{}", bits_per_sample(0, 0));
    assert!(bits_per_sample(1, 0) < 1.6, "{}", bits_per_sample(1, 0));
    assert!(bits_per_sample(5, 0) < 0.05, "{}", bits_per_sample(5, 0));
    assert!(bits_per_sample(6, 0) < 3.0, "{}", bits_per_sample(6, 0));
    assert!(bits_per_sample(12, 0) < 2.8, "{}", bits_per_sample(12, 0));
    // Held twice, or on lines that floats hold exactly: the second sample costs nothing.
    for (kind, seed) in [(0, 1), (4, 1), (12, 1), (12, 2)] {
        let (once, twice) = (bits_per_sample(kind, 0), bits_per_sample(kind, seed));
        assert!(twice < 0.65 * once, "kind {kind}, seed {seed}: {twice} of {once}");
    }
}

#[test]
fn both_instruction_sets_give_the_same_bytes() {
    let channels = group(7, 13, 400);
    let slices: Vec<&[f32]> = channels.iter().map(Vec::as_slice).collect();
    let mut encoder = SampledEncoder::new();
    encoder.group.isa = Isa::plain();
    let mut block = Vec::new();
    encoder.encode(&slices, true, &mut block).unwrap();
    assert_eq!([block], *encode(&channels, 400, 1));
}

#[test]
fn no_block_is_larger_than_its_samples() {
    let channels = [channel(8, 0, 1000)];
    assert_eq!(encode(&channels, 1000, 1)[0].len(), max_block_bytes(1, 1000));
    // State continues after samples that are stored as they are.
    let mut mixed = channel(8, 0, 100);
    mixed.extend(channel(2, 0, 300));
    let channels = [mixed];
    check(&channels, &encode(&channels, 100, 4), 100, 4, 0);
}

#[test]
fn truncated_blocks_are_errors_or_samples() {
    let channels = group(5, 7, 48);
    let blocks = encode(&channels, 24, 2);
    for (i, block) in blocks.iter().enumerate() {
        for n in 0..block.len() {
            let mut decoder = SampledDecoder::new();
            if i > 0 {
                decoder.decode(&blocks[0], 24, true).unwrap();
            }
            if decoder.decode(&block[..n], 24, i == 0).is_err() {
                assert_eq!(decoder.decode(&blocks[1], 24, false), Err(CodecError::OutOfStep));
            }
        }
    }
    let mut block = Vec::new();
    let noise = channel(8, 0, 50);
    SampledEncoder::new().encode(&[&noise], true, &mut block).unwrap();
    for n in 0..block.len() {
        let result = SampledDecoder::new().decode(&block[..n], 50, true).map(<[f32]>::len);
        assert!(result.is_err(), "{n}");
    }
}

#[test]
fn changed_bytes_are_errors_or_samples() {
    let mut random = Random::new(1);
    for seed in 0..6 {
        let channels = group(seed, 5, 32);
        let blocks = encode(&channels, 16, 2);
        for at in 0..blocks[0].len() {
            let mut block = blocks[0].clone();
            block[at] ^= 1 << random.below(8);
            let mut decoder = SampledDecoder::new();
            if let Ok(samples) = decoder.decode(&block, 16, true) {
                assert_eq!(samples.len() % 16, 0);
            }
            drop(decoder.decode(&blocks[1], 16, false));
            assert!(decoder.decode(&blocks[0], 16, true).is_ok(), "a key block makes all well");
        }
    }
    for seed in 0..500 {
        let mut random = Random::new(seed);
        let n = random.below(200);
        let mut bytes = random.bytes(n);
        if let Some(first) = bytes.first_mut() {
            *first &= 0x0f;
        }
        drop(SampledDecoder::new().decode(&bytes, 40, true));
    }
}

#[test]
fn invalid_arguments_are_refused() {
    let mut encoder = SampledEncoder::new();
    let mut out = vec![7];
    let samples = [1.0; 4];
    let many = vec![&samples[..]; GROUP_CHANNELS + 1];
    for channels in [&[][..], &many, &[&samples, &samples[1..]]] {
        let result = encoder.encode(channels, true, &mut out);
        assert!(matches!(result, Err(CodecError::InvalidArgument(_))));
    }
    assert_eq!(encoder.encode(&[&samples], false, &mut out), Err(CodecError::OutOfStep));
    assert_eq!(out, [7]);
    encoder.encode(&[&samples], true, &mut out).unwrap();
    let result = encoder.encode(&[&samples, &samples], false, &mut out);
    assert!(matches!(result, Err(CodecError::InvalidArgument(_))));
    encoder.encode(&[&samples], false, &mut out).unwrap();
    let n = out.len();
    encoder.encode(&[&[]], false, &mut out).unwrap();
    assert_eq!(out.len(), n, "no rows, no block");
}

/// Blocks of every kind of channel, as they were first written: for each its number of rows in two bytes, its length
/// in four, and its bytes. The first is a key block. `tests/reference/sampled.py` decodes them, too.
const GOLDEN: &[u8] = include_bytes!("../../tests/golden/sampled.blocks");

/// The digest of what they decode to.
const DIGEST: &str = include_str!("../../tests/golden/sampled.digest");

#[test]
fn the_bytes_are_the_same_on_every_machine() {
    let channels = group(2, 13, 130);
    let blocks = encode(&channels, 100, 2);
    let mut written = Vec::new();
    for (block, n_rows) in blocks.iter().zip([100_u16, 30]) {
        written.extend(n_rows.to_le_bytes());
        written.extend((block.len() as u32).to_le_bytes());
        written.extend(block);
    }
    assert!(written == GOLDEN, "the format of blocks has changed");
    // FNV-1a of the decoded bits.
    let mut digest = 0xcbf2_9ce4_8422_2325_u64;
    for (block, n_rows) in [(0, 0..100), (1, 100..130)] {
        assert!(!blocks[block].is_empty());
        let samples = channels.iter().flat_map(|channel| &channel[n_rows.clone()]);
        for byte in samples.flat_map(|sample| sample.to_bits().to_le_bytes()) {
            digest = (digest ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
    assert_eq!(format!("{digest:016x}"), DIGEST.trim());
}

//! A decoder's memory is bounded by the rows that its caller asks for times the channels that the block states (64 at
//! most), and by the bytes of its input. A test program of its own, because it replaces the allocator.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]
#![expect(unsafe_code, reason = "an allocator that counts is one by contract")]

mod counting;

use mocapd_codec::{
    BlockReport, DecodedRows, GROUP_CHANNELS, Position, Rows, Settings, Tolerance,
    sampled::{SampledDecoder, SampledEncoder, max_block_bytes},
    stated_channels,
};

use mocapd_testkit::random::Random;

use self::counting::peak_bytes;

const KINDS: [&str; 6] = ["dense", "fast", "lossless", "lossless:predictive", "spline", "sync"];

fn settings(kind: &str) -> Settings {
    Settings { kind: kind.parse().unwrap(), tolerance: Tolerance::from_mm(0.5).unwrap() }
}

/// Bytes that claim to be a key block of `n_channels` channels with samples.
fn claim(kind: &str, n_channels: u8, filling: &[u8]) -> Vec<u8> {
    let stated = if kind.starts_with("lossless") { 0 } else { 63 };
    [&[0x40 | stated, n_channels][..], filling].concat()
}

/// A block that an encoder wrote, and its shared bytes.
fn encoded(kind: &str, n_channels: usize, n_rows: usize) -> (Vec<u8>, Vec<u8>) {
    let path: Vec<Position> = (0..n_rows)
        .map(|row| [(row as f32 / 9.0).sin() * 300.0, row as f32, (row * row % 71) as f32])
        .collect();
    let present: Vec<bool> = (0..n_rows).map(|row| row % 13 != 4).collect();
    let rows = vec![Rows::new(&path, &present).unwrap(); n_channels];
    let settings = settings(kind);
    let shared = settings.plan(&rows).unwrap();
    let (mut block, mut reports) = (Vec::new(), vec![BlockReport::default(); n_channels]);
    settings.encoder().encode(&rows, &shared, true, &mut block, &mut reports).unwrap();
    (block, shared)
}

/// The maximum of bytes that a decoder may hold. Each factor is about three times the largest need of any resampler for
/// valid blocks: 46 bytes per sample in `dense`, positions and flags included.
fn memory_limit(kind: &str, n_channels: usize, n_rows: usize, n_bytes: usize) -> usize {
    // `dense` has its tables of contexts before the first byte.
    let tables = if kind == "dense" { 2 << 20 } else { 64 << 10 };
    tables + 8192 * n_channels + 150 * n_rows * n_channels + 4 * n_bytes
}

/// Decodes a first block, and returns the peak of the bytes held.
fn decode(kind: &str, block: &[u8], shared: &[u8], n_rows: usize) -> usize {
    peak_bytes(|| {
        let mut out = Vec::new();
        let outcome = settings(kind).decoder().decode(block, shared, n_rows, true, &mut out);
        assert!(outcome.is_ok() || out.is_empty());
    })
}

#[track_caller]
fn assert_within_limit(kind: &str, block: &[u8], shared: &[u8], n_rows: usize) {
    let held = decode(kind, block, shared, n_rows);
    let n_channels = stated_channels(block).unwrap_or(0);
    let limit = memory_limit(kind, n_channels, n_rows, block.len() + shared.len());
    assert!(
        held <= limit,
        "{kind}: {held} bytes of {limit} for {n_channels} channels of {n_rows} rows in {} bytes",
        block.len()
    );
}

#[test]
fn blocks_of_an_encoder() {
    for kind in KINDS {
        for n_channels in [1, 8, GROUP_CHANNELS] {
            for n_rows in [1, 60, 2000] {
                let (block, shared) = encoded(kind, n_channels, n_rows);
                assert_eq!(stated_channels(&block), Some(n_channels));
                assert_within_limit(kind, &block, &shared, n_rows);
            }
        }
    }
}

/// Few bytes that claim much: memory grows with the caller's rows, not with these claims.
#[test]
fn claims_of_few_bytes() {
    for kind in KINDS {
        for n_channels in [0, 1, 2, 64, 65, 255] {
            for n_rows in [0, 1, 60, 4000] {
                for len in [0, 1, 7, 300] {
                    for filling in
                        [vec![0; len], vec![0xff; len], Random::new(len as u64).bytes(len)]
                    {
                        let mut block = claim(kind, n_channels, &filling);
                        assert_within_limit(kind, &block, &[], n_rows);
                        // With a presence section, and key times that are far apart.
                        block[0] |= 0x80;
                        assert_within_limit(kind, &block, &filling, n_rows);
                    }
                }
            }
        }
    }
}

/// The largest numbers after every byte that may select how a channel is stored.
#[test]
fn large_numbers() {
    for kind in KINDS {
        for first in 0..=8 {
            for n_digits in 0..9 {
                let number = [vec![0xff; n_digits], vec![0x7f]].concat();
                let filling = [&[first][..], &number, &[1, 0, 5], &number, &number].concat();
                assert_within_limit(kind, &claim(kind, 2, &filling), &[], 100);
                // In the key times, and in the presence section.
                assert_within_limit(kind, &claim(kind, 2, &[first; 40]), &number, 100);
                let mut block = claim(kind, 2, &[&number[..], &[first; 40]].concat());
                block[0] |= 0x80;
                assert_within_limit(kind, &block, &[], 100);
            }
        }
    }
}

/// An invalid head costs next to nothing, however many rows are asked for.
#[test]
fn invalid_heads() {
    for kind in KINDS {
        let nothing = decode(kind, &[], &[], 0);
        let claims: [&[u8]; 5] =
            [&[0x00, 1], &[0x40, 0], &[0x40, 65], &[0x40], &[0x40, 0xff, 0xff, 0xff, 0xff, 0x0f]];
        for block in claims {
            let held = decode(kind, block, &[], 1 << 22);
            assert!(held <= nothing + 1024, "{kind}: {held} bytes for {block:?}");
        }
    }
}

#[test]
fn damaged_blocks() {
    for kind in KINDS {
        let n_rows = 90;
        let (block, shared) = encoded(kind, 3, n_rows);
        for at in (0..block.len()).step_by(1 + block.len() / 200) {
            assert_within_limit(kind, &block[..at], &shared, n_rows);
            for flip in [0x01, 0x80, 0xff] {
                let mut damaged = block.clone();
                damaged[at] ^= flip;
                assert_within_limit(kind, &damaged, &shared, n_rows);
            }
        }
    }
}

/// Memory is reused: a stream of arbitrary bytes holds no more than its largest block.
#[test]
fn streams_of_any_bytes() {
    for kind in KINDS {
        let (n_channels, n_rows, len) = (16, 100, 400);
        let held = peak_bytes(|| {
            let mut decoder = settings(kind).decoder();
            let mut out: Vec<DecodedRows> = Vec::new();
            for i in 0..400 {
                let claimed = i as usize % n_channels + 1;
                let block = claim(kind, claimed as u8, &Random::new(i).bytes(i as usize % len));
                let rows = if i % 7 == 6 { i as usize % n_rows } else { n_rows };
                // As a key block, then as a continuation, which states no number of channels.
                let key = decoder.decode(&block, &[], rows, true, &mut out);
                assert!(key.is_ok() || out.is_empty());
                let next = Random::new(i + 1).bytes(i as usize % len);
                let next = [&[block[0] & 0x3f][..], &next].concat();
                let next = decoder.decode(&next, &[], rows, false, &mut out);
                assert!(next.is_ok() || out.is_empty());
            }
        });
        let limit = memory_limit(kind, n_channels, n_rows, 3 * len);
        assert!(held <= limit, "{kind}: {held} bytes of {limit}");
    }
}

/// Channels of noise, of few values, and of random bits.
fn sampled(seed: u64, n_rows: usize) -> Vec<Vec<f32>> {
    let mut random = Random::new(seed);
    let mut channel = |kind: usize| -> Vec<f32> {
        let sample = |_| match kind {
            0 => random.unit() as f32,
            1 => random.below(900) as f32 * 0.173,
            2 => [-1.0, 5.5, 7.0][random.below(3)],
            _ => f32::from_bits(random.next_u64() as u32),
        };
        (0..n_rows).map(sample).collect()
    };
    (0..8).map(|i| channel(i % 4)).collect()
}

#[test]
fn prepared_coders_of_sampled_channels_do_not_allocate() {
    const N_ROWS: usize = 500;
    let (mut encoder, mut decoder) = (SampledEncoder::new(), SampledDecoder::new());
    encoder.prepare(8, N_ROWS);
    decoder.prepare(8, N_ROWS);
    let mut block = Vec::with_capacity(max_block_bytes(8, N_ROWS));
    for seed in 0..6 {
        let channels = sampled(seed, N_ROWS);
        let slices: Vec<&[f32]> = channels.iter().map(Vec::as_slice).collect();
        block.clear();
        let is_key = seed % 3 == 0;
        assert_eq!(peak_bytes(|| encoder.encode(&slices, is_key, &mut block).unwrap()), 0);
        assert_eq!(peak_bytes(|| assert!(decoder.decode(&block, N_ROWS, is_key).is_ok())), 0);
    }
}

#[test]
fn a_decoder_of_sampled_channels_allocates_for_its_rows() {
    for seed in 0..40 {
        let mut random = Random::new(seed);
        let mut block = random.bytes(200);
        block[0] = 1 + random.below(GROUP_CHANNELS) as u8;
        let held = peak_bytes(|| drop(SampledDecoder::new().decode(&block, 50, true)));
        // Per channel the inverse of its predictor (3.2 KiB), its state, and a palette of up to 4096 values.
        let limit =
            (64 << 10) + usize::from(block[0]) * (24 << 10) + 4 * 50 * usize::from(block[0]);
        assert!(held <= limit, "{held} of {limit}");
    }
}

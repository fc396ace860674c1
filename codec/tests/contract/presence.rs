//! The presence of samples, and its cost in bytes.

use super::{Channel, Stretch, cut, decode_and_check, encode, motions::Random, settings};

/// Bytes of all blocks of `lossless`, 60 rows each, after checking that they decode.
fn bytes(channels: &[Channel], n_rows: usize) -> usize {
    let stretches = cut(channels, &vec![60; n_rows / 60], 0);
    let blocks = encode(settings("lossless", 1.0), &stretches);
    decode_and_check(settings("lossless", 1.0), &stretches, &blocks);
    blocks.iter().map(|block| block.bytes.len()).sum()
}

fn at_rest(n: usize, present: impl Fn(usize, usize) -> bool) -> Vec<Channel> {
    (0..n)
        .map(|i| Channel {
            positions: vec![[1.0; 3]; 600],
            present: (0..600).map(|row| present(i, row)).collect(),
        })
        .collect()
}

#[test]
fn channels_that_never_change_cost_next_to_nothing() {
    // Every sampled channel of `lossless` takes bytes of its own, so only one of 64 has samples.
    let alone = bytes(&at_rest(1, |_, _| true), 600);
    let last = bytes(&at_rest(64, |i, _| i == 63), 600);
    assert!(last < alone + 40 + 20, "{alone} and {last} bytes");
}

#[test]
fn gaps_that_channels_share_cost_less() {
    let together = at_rest(32, |_, row| row / 20 % 2 == 0);
    let apart = at_rest(32, |i, row| (row + 37 * i) / 20 % 2 == 0);
    let (together, apart) = (bytes(&together, 600), bytes(&apart, 600));
    assert!(together < apart, "{together} and {apart} bytes");
}

#[test]
fn random_presence_costs_hardly_more_than_a_bit_per_row() {
    let mut random = Random(5);
    let noise: Vec<Vec<bool>> =
        (0..16).map(|_| (0..600).map(|_| random.below(2) == 0).collect()).collect();
    let blocks = |present: &dyn Fn(usize, usize) -> bool| bytes(&at_rest(16, present), 600);
    let more = blocks(&|i, row| noise[i][row]) - blocks(&|_, row| row % 2 == 0);
    assert!(more < 16 * 600 / 8 * 12 / 10, "{more} bytes");
}

#[test]
fn single_rows_and_single_channels() {
    for pattern in 1..1 << 9_u32 {
        let present = |i: usize, row: usize| pattern >> (3 * i + row) & 1 == 1;
        let channels: Vec<Channel> = (0..3)
            .map(|i| Channel {
                positions: vec![[2.0, 3.0, 4.0]; 3],
                present: (0..3).map(|row| present(i, row)).collect(),
            })
            .collect();
        let stretch = Stretch { channels, key: true };
        let again = Stretch { key: false, ..stretch.clone() };
        let stretches = [stretch, again.clone(), again];
        let blocks = encode(settings("fast", 1.0), &stretches);
        decode_and_check(settings("fast", 1.0), &stretches, &blocks);
    }
}

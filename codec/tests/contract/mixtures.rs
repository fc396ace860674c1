//! Mixtures: different kinds of motion one after another in the same channel.

use proptest::prelude::*;

use super::{
    Channel,
    hard::{KINDS, moved, stream, swing},
    motions::Random,
};

/// A part of a channel: kind of motion, whether it has gaps, seed, and number of rows.
fn part() -> impl Strategy<Value = (u8, bool, u64, usize)> {
    (0..8_u8, any::<bool>(), any::<u64>(), 1..40_usize)
}

fn anything(parts: &[(u8, bool, u64, usize)]) -> Channel {
    let mut channel = Channel { positions: Vec::new(), present: Vec::new() };
    let mut origin = [0.0, 1000.0, 0.0];
    for &(what, gaps, seed, len) in parts {
        let mut random = Random(seed);
        for _ in 0..len {
            let row = channel.positions.len();
            channel.positions.push(match what {
                0 => origin,
                1 => moved(origin, swing(row)),
                2 if random.below(5) == 0 => moved(random.vector(8000.0), origin),
                2 => origin,
                3 => random.vector(1e7),
                4 => moved([1e7; 3], swing(row)),
                5 => [0; 3].map(|_| f32::from_bits(random.below(1 << 23) as u32)),
                6 => [0; 3].map(|_| f32::from_bits(random.below(0x7f80_0000) as u32)),
                _ => {
                    origin = moved(origin, random.vector(4.0));
                    origin
                }
            });
            channel.present.push(!gaps || random.below(3) > 0);
        }
    }
    channel
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Any sequence of parts, at any tolerance, with any stretches and keys.
    #[test]
    fn anything_after_anything(
        kind in proptest::sample::select(KINDS.to_vec()),
        channels in proptest::collection::vec(proptest::collection::vec(part(), 1..6), 1..7),
        mut lengths in proptest::collection::vec(0..50_usize, 1..8),
        keys in any::<u32>(),
        exponent in -4.0..6.0_f64,
    ) {
        let mut channels: Vec<_> = channels.iter().map(|parts| anything(parts)).collect();
        let n_rows = channels.iter().map(|channel| channel.present.len()).max().unwrap();
        for channel in &mut channels {
            channel.positions.resize(n_rows, [f32::NAN; 3]);
            channel.present.resize(n_rows, false);
        }
        let mut left = n_rows;
        for len in &mut lengths {
            *len = left.min(*len);
            left -= *len;
        }
        lengths.push(left);
        stream(kind, 10_f64.powf(exponent), &channels, &lengths, keys);
    }
}

//! The initial probabilities of the model: those with which the first bits of key blocks cost least.

use mocapd_codec::training;

/// Upper limit of the weight of a group in the mean of a mixer, in bits.
const MIXED_BITS_MAX: f64 = 2000.0;

/// Candidates for a context: the weight of its initial probability in bits, and offsets from the logit of the mean
/// probability.
const SEEN: [u8; 15] = [0, 1, 2, 3, 4, 6, 8, 12, 16, 20, 24, 32, 40, 48, 63];
const OFFSETS: [f64; 9] = [0.0, -0.1, 0.1, -0.3, 0.3, -0.6, 0.6, -1.0, 1.0];

/// Penalty in bits for a probability that differs from the mean, per unit of logit, and for a weight that differs from
/// twelve bits, per unit of its logarithm: a regularisation, because the files are few.
const PENALTY: (f64, f64) = (0.2, 0.3);

/// The first bits of one context after one key, and their statistical weight.
struct FirstBits<'a> {
    bits: &'a [bool],
    weight: f64,
}

/// The table, in the layout of `codec/src/dense/model.rs`.
pub(crate) fn table(cells: &[Vec<training::Tally>]) -> Vec<u8> {
    let n_contexts = cells.first().and_then(|cell| cell.first()).map_or(0, |t| t.firsts.len());
    let mut table = Vec::new();
    for context in 0..n_contexts {
        let firsts: Vec<_> = cells.iter().flat_map(|cell| first_bits(cell, context)).collect();
        let (probability, seen) = best(&firsts);
        table.extend(probability.to_le_bytes());
        table.push(seen);
    }
    table.extend(mixers(cells));
    table
}

/// The first bits of a cell in a context. They are weighted by the inverse square root of the number of keys, so that
/// long takes do not dominate.
fn first_bits(cell: &[training::Tally], context: usize) -> impl Iterator<Item = FirstBits<'_>> {
    let lists = cell.iter().map(move |tally| &tally.firsts[context]);
    let keys = lists.clone().map(Vec::len).sum::<usize>();
    let weight = 1.0 / (keys as f64).sqrt();
    lists.flatten().map(move |bits| FirstBits { bits, weight })
}

/// The initial probability in units of 2^-16 with which the bits cost least, and its weight in bits.
fn best(firsts: &[FirstBits<'_>]) -> (u16, u8) {
    if firsts.is_empty() {
        return (1 << 15, 0);
    }
    let (mut set, mut all) = (0.4, 0.8);
    for FirstBits { bits, weight } in firsts {
        let bits = &bits[..bits.len().min(60)];
        set += weight * bits.iter().filter(|&&bit| bit).count() as f64;
        all += weight * bits.len() as f64;
    }
    let mean = (set / (all - set)).ln();
    let mut best = (f64::INFINITY, (1 << 15, 0));
    for offset in OFFSETS {
        let logit: f64 = (mean + offset).clamp(-7.5, 7.5);
        let probability = (65536.0 / (1.0 + (-logit).exp())).clamp(24.0, 65512.0) as u16;
        for seen in SEEN {
            let bits: f64 = firsts.iter().map(|first| cost(first, probability, seen)).sum();
            let penalty = PENALTY.1 * ((f64::from(seen) + 1.0) / 13.0).ln().abs();
            let bits = bits + PENALTY.0 * offset.abs() + penalty;
            if bits < best.0 {
                best = (bits, (probability, seen));
            }
        }
    }
    best.1
}

/// The weighted cost of the bits with this context alone, with the adaptation rule of the codec.
fn cost(first: &FirstBits<'_>, probability: u16, seen: u8) -> f64 {
    let (mut of_one, mut bits) = (i64::from(probability), 0.0);
    for (n, &bit) in (i64::from(seen)..).zip(first.bits) {
        let of_bit = if bit { of_one } else { 65536 - of_one };
        bits -= (of_bit as f64 / 65536.0).log2();
        let rate = (327_680 / (5 * n.min(63) + 8)).max(1311);
        of_one += ((if bit { 65535 } else { 0 } - of_one) * rate) >> 16;
    }
    bits * first.weight
}

/// The mean mixing weights.
fn mixers(cells: &[Vec<training::Tally>]) -> Vec<u8> {
    let mut sums: Vec<([f64; 3], f64)> = Vec::new();
    for tally in cells.iter().flatten() {
        sums.resize(tally.mixers.len(), Default::default());
        for ((sum, n), (weights, bits)) in sums.iter_mut().zip(&tally.mixers) {
            let share = (*bits as f64).min(MIXED_BITS_MAX) / (*bits as f64).max(1.0);
            for (sum, weight) in sum.iter_mut().zip(weights) {
                *sum += *weight as f64 * share;
            }
            *n += *bits as f64 * share;
        }
    }
    let mut table = Vec::new();
    for (sum, n) in sums {
        for sum in sum {
            // A weight of 1 is 2^16 in the codec and 1024 in the table; 0.35 is the default of unused mixers.
            let weight = if n > 0.0 { sum / n / 64.0 } else { 358.0 };
            table.extend((weight.round().clamp(-32000.0, 32000.0) as i16).to_le_bytes());
        }
    }
    table
}

//! The first odds: those that the first bits of key blocks would have cost least with.

use mocapd_codec::training;

/// Most that a cell's group counts for in one mixer.
const MIXED_BITS_MAX: f64 = 2000.0;

/// What is tried of a context: how many bits its odds weigh, and logits around that of the mean odds.
const SEEN: [u8; 15] = [0, 1, 2, 3, 4, 6, 8, 12, 16, 20, 24, 32, 40, 48, 63];
const OFFSETS: [f64; 9] = [0.0, -0.1, 0.1, -0.3, 0.3, -0.6, 0.6, -1.0, 1.0];

/// Bits that odds cost which differ from the mean, or weigh other than a dozen bits: few files prove little.
const DOUBT: (f64, f64) = (0.2, 0.3);

/// The bits of one context behind one key, and what they count.
struct First<'a> {
    bits: &'a [bool],
    weight: f64,
}

/// The table, in the layout that `codec/src/dense/model.rs` states.
pub(crate) fn table(cells: &[Vec<training::Tally>]) -> Vec<u8> {
    let n_contexts = cells.first().and_then(|cell| cell.first()).map_or(0, |t| t.firsts.len());
    let mut table = Vec::new();
    for context in 0..n_contexts {
        let firsts: Vec<First<'_>> = cells.iter().flat_map(|cell| of(cell, context)).collect();
        let (odds, seen) = best(&firsts);
        table.extend(odds.to_le_bytes());
        table.push(seen);
    }
    table.extend(mixers(cells));
    table
}

/// What a cell saw in a context, weighted so that long takes do not decide alone.
fn of(cell: &[training::Tally], context: usize) -> impl Iterator<Item = First<'_>> {
    let lists = cell.iter().map(move |tally| &tally.firsts[context]);
    let keys = lists.clone().map(Vec::len).sum::<usize>();
    let weight = 1.0 / (keys as f64).sqrt();
    lists.flatten().map(move |bits| First { bits, weight })
}

/// The odds in 2^-16 that the bits cost least with, and the weight of these odds in bits.
fn best(firsts: &[First<'_>]) -> (u16, u8) {
    if firsts.is_empty() {
        return (1 << 15, 0);
    }
    let (mut set, mut all) = (0.4, 0.8);
    for First { bits, weight } in firsts {
        let bits = &bits[..bits.len().min(60)];
        set += weight * bits.iter().filter(|&&bit| bit).count() as f64;
        all += weight * bits.len() as f64;
    }
    let mean = (set / (all - set)).ln();
    let mut best = (f64::INFINITY, (1 << 15, 0));
    for offset in OFFSETS {
        let logit: f64 = (mean + offset).clamp(-7.5, 7.5);
        let odds = (65536.0 / (1.0 + (-logit).exp())).clamp(24.0, 65512.0) as u16;
        for seen in SEEN {
            let bits: f64 = firsts.iter().map(|first| cost(first, odds, seen)).sum();
            let doubt = DOUBT.1 * ((f64::from(seen) + 1.0) / 13.0).ln().abs();
            let bits = bits + DOUBT.0 * offset.abs() + doubt;
            if bits < best.0 {
                best = (bits, (odds, seen));
            }
        }
    }
    best.1
}

/// What the bits would cost with one context alone, as the codec follows it.
fn cost(first: &First<'_>, odds: u16, seen: u8) -> f64 {
    let (mut odds, mut bits) = (i64::from(odds), 0.0);
    for (n, &bit) in (i64::from(seen)..).zip(first.bits) {
        let chance = if bit { odds } else { 65536 - odds };
        bits -= (chance as f64 / 65536.0).log2();
        let rate = (327_680 / (5 * n.min(63) + 8)).max(1311);
        odds += ((if bit { 65535 } else { 0 } - odds) * rate) >> 16;
    }
    bits * first.weight
}

/// The mean weights.
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
            // 1 is 2^16 in the codec and 1024 in the table; 0.35 is where unseen mixers start.
            let weight = if n > 0.0 { sum / n / 64.0 } else { 358.0 };
            table.extend((weight.round().clamp(-32000.0, 32000.0) as i16).to_le_bytes());
        }
    }
    table
}

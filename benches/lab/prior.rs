//! The first odds: means over all cells, weighted so that long takes do not decide alone.

use mocapd_codec::training;

/// Most that a cell's group counts for in one context, and in one mixer.
const BITS_MAX: (f64, f64) = (300.0, 2000.0);

/// Weighted sums of tallies.
#[derive(Default)]
pub(crate) struct Sums {
    contexts: Vec<[f64; 2]>,
    mixers: Vec<([f64; 3], f64)>,
}

impl Sums {
    pub(crate) fn add(&mut self, tally: &training::Tally) {
        self.contexts.resize(tally.contexts.len(), [0.0; 2]);
        self.mixers.resize(tally.mixers.len(), Default::default());
        for (sum, counts) in self.contexts.iter_mut().zip(&tally.contexts) {
            let bits = (counts[0] + counts[1]) as f64;
            let share = bits.min(BITS_MAX.0) / bits.max(1.0);
            sum[0] += counts[0] as f64 * share;
            sum[1] += counts[1] as f64 * share;
        }
        for ((sum, n), (weights, bits)) in self.mixers.iter_mut().zip(&tally.mixers) {
            let share = (*bits as f64).min(BITS_MAX.1) / (*bits as f64).max(1.0);
            for (sum, weight) in sum.iter_mut().zip(weights) {
                *sum += *weight as f64 * share;
            }
            *n += *bits as f64 * share;
        }
    }

    /// The layout that `codec/src/dense/prior.rs` states.
    pub(crate) fn table(&self) -> Vec<u8> {
        let odds = self.contexts.iter().map(|[unset, set]| {
            let bits = unset + set;
            let odds = (set + 0.4) / (bits + 0.8) * 256.0;
            if bits < 0.5 { 0 } else { odds.clamp(1.0, 255.0) as u8 }
        });
        let mut table: Vec<u8> = odds.collect();
        for (sum, n) in &self.mixers {
            for sum in sum {
                // 1 is 2^16 in the codec and 1024 in the table; 0.35 is where unseen mixers start.
                let weight = if *n > 0.0 { sum / n / 64.0 } else { 358.0 };
                table.extend((weight.round().clamp(-32000.0, 32000.0) as i16).to_le_bytes());
            }
        }
        table
    }
}

//! Statistics of contexts and code lengths for `benches/lab`, compiled with the feature `training` only.

use super::contexts::{
    KINDS, MIX_EXPONENT, MIX_LONGER, MIX_MOVING, MIX_NONZERO, MIX_SIGN, N_CONTEXTS, N_MIXERS,
};

/// Names of the kinds of rows.
const KIND_NAMES: [&str; KINDS] = [
    "first row",
    "anchor, 17 rows and more",
    "anchor, 5 rows and more",
    "anchor",
    "stride 1",
    "stride 2",
    "stride 4",
    "stride 8",
    "stride 16",
    "stride 32",
];

/// Number of bits per key block and context that are recorded: later bits hardly depend on the initial probability.
const FIRST_BITS: usize = 200;

/// The first bits of contexts, the sums of mixers' weights, and code lengths.
#[derive(Debug, Clone)]
pub struct Tally {
    /// Per context: its first bits in every key block in which it has any.
    pub firsts: Vec<Vec<Vec<bool>>>,
    /// Whether the next bit of a context is the first one of a key block.
    fresh: Vec<bool>,
    /// Per mixer: the sums of its three weights in 2^-16, and their number.
    pub mixers: Vec<([i64; 3], u64)>,
    /// Ideal code lengths in bits of mixed decisions, per mixer.
    pub mixed_bits: Vec<f64>,
    /// Ideal code lengths in bits of unmixed decisions, per context.
    pub single_bits: Vec<f64>,
    /// Number of payload bytes.
    pub bytes: usize,
}

impl Tally {
    pub(super) fn new() -> Self {
        Self {
            firsts: vec![Vec::new(); N_CONTEXTS],
            fresh: vec![true; N_CONTEXTS],
            mixers: vec![([0; 3], 0); N_MIXERS],
            mixed_bits: vec![0.0; N_MIXERS],
            single_bits: vec![0.0; N_CONTEXTS],
            bytes: 0,
        }
    }

    /// Ideal code lengths in bits by decision and kind of row; the kind is `None` where all kinds share contexts.
    #[must_use]
    pub fn lengths(&self) -> Vec<(&'static str, Option<&'static str>, f64)> {
        let by_kind = |name, first: usize| {
            (0..KINDS)
                .map(move |kind| (name, Some(KIND_NAMES[kind]), self.mixed_bits[first + kind]))
        };
        let sum = |from: usize, to: usize| self.mixed_bits[from..to].iter().sum();
        let mut lengths: Vec<_> = by_kind("moved", MIX_MOVING)
            .chain(by_kind("not zero", MIX_NONZERO))
            .chain(by_kind("sign", MIX_SIGN))
            .collect();
        lengths.push(("length", None, sum(MIX_LONGER, MIX_EXPONENT)));
        lengths.push(("exponent", None, sum(MIX_EXPONENT, N_MIXERS)));
        let single = self.single_bits.iter().sum::<f64>();
        lengths.push(("parity, mantissa, first rows", None, single));
        let modelled = lengths.iter().map(|(.., bits)| bits).sum::<f64>();
        lengths.push(("bits without a model", None, self.bytes as f64 * 8.0 - modelled));
        lengths
    }

    pub(super) fn mixed(&mut self, mixer: usize, probability: i32, bit: bool) {
        self.mixed_bits[mixer] += cost(probability, bit);
    }

    pub(super) fn single(&mut self, context: usize, probability: i32, bit: bool) {
        self.single_bits[context] += cost(probability, bit);
    }

    pub(super) fn context(&mut self, index: usize, bit: bool) {
        let firsts = &mut self.firsts[index];
        if std::mem::take(&mut self.fresh[index]) {
            firsts.push(Vec::new());
        }
        if let Some(bits) = firsts.last_mut().filter(|bits| bits.len() < FIRST_BITS) {
            bits.push(bit);
        }
    }

    /// Begins a key block.
    pub(super) fn key(&mut self) {
        self.fresh.fill(true);
    }

    pub(super) fn mixer(&mut self, index: usize, weights: [i32; 3]) {
        let (sums, n) = &mut self.mixers[index];
        for (sum, weight) in sums.iter_mut().zip(weights) {
            *sum += i64::from(weight);
        }
        *n += 1;
    }
}

/// The cost in bits of a decision whose probability of being set is in 2^-16.
fn cost(probability: i32, bit: bool) -> f64 {
    let p = f64::from(if bit { probability } else { 65536 - probability });
    16.0 - p.log2()
}

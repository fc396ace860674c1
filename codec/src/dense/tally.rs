//! What the contexts saw and what each decision cost, for `benches/lab`. Only with the feature `training`: a codec that embeds this crate does not pay for it.

use super::contexts::{
    KINDS, MIX_EXPONENT, MIX_LONGER, MIX_MOVING, MIX_NONZERO, MIX_SIGN, N_CONTEXTS, N_MIXERS,
};

/// The kinds of rows.
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

/// Bits of a key block that are kept of a context: its odds follow what it saw long before.
const FIRST_BITS: usize = 200;

/// First bits, sums of weights, and code lengths.
#[derive(Debug, Clone)]
pub struct Tally {
    /// Per context: of every key block that has some, the first bits.
    pub firsts: Vec<Vec<Vec<bool>>>,
    /// Whether the next bit of a context is the first one of a key block.
    fresh: Vec<bool>,
    /// Per mixer: sums of its three weights (1 being 2^16), and their number.
    pub mixers: Vec<([i64; 3], u64)>,
    /// Ideal code lengths in bits: per mixer, and per context of decisions that are not mixed.
    pub mixed_bits: Vec<f64>,
    /// See `mixed_bits`.
    pub single_bits: Vec<f64>,
    /// Payload bytes.
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

    /// Ideal code lengths in bits by what is said and of which kind of row; `None` where all kinds share
    /// their decisions.
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

    /// A key block begins.
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

/// The bits that a decision costs whose odds of being set are in 2^-16.
fn cost(probability: i32, bit: bool) -> f64 {
    let p = f64::from(if bit { probability } else { 65536 - probability });
    16.0 - p.log2()
}

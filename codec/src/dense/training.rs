//! What the contexts saw and what each decision cost, for `benches/lab`. Only with the feature `training`: a codec that embeds this crate does not pay for it.

use super::{
    DenseEncoder,
    layout::{self as is, KINDS, N_CONTEXTS, N_MIXERS},
};
use crate::{
    BlockReport, CodecError, Rows, Tolerance,
    frame::{Payload, PayloadEncoder, count_finite},
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
        let mut lengths: Vec<_> = by_kind("moved", is::MIX_MOVING)
            .chain(by_kind("not zero", is::MIX_NONZERO))
            .chain(by_kind("sign", is::MIX_SIGN))
            .collect();
        lengths.push(("length", None, sum(is::MIX_LONGER, is::MIX_EXPONENT)));
        lengths.push(("exponent", None, sum(is::MIX_EXPONENT, N_MIXERS)));
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

/// Codes a group's channels in key blocks of `stretch_rows` rows and gives what the contexts saw.
///
/// # Errors
/// `InvalidArgument` as [`BlockEncoder::encode`](crate::BlockEncoder::encode).
pub fn tally(
    tolerance: Tolerance,
    channels: &[Rows<'_>],
    stretch_rows: usize,
) -> Result<Tally, CodecError> {
    let mut encoder = DenseEncoder::new(tolerance);
    let mut bytes = 0;
    let n_rows = channels.first().map_or(0, Rows::len);
    for first in (0..n_rows).step_by(stretch_rows.max(1)) {
        let last = (first + stretch_rows).min(n_rows);
        let part = |rows: &Rows<'_>| -> Result<_, CodecError> {
            Ok((rows.positions()[first..last].to_vec(), rows.present()[first..last].to_vec()))
        };
        let parts = channels.iter().map(part).collect::<Result<Vec<_>, _>>()?;
        let rows = parts.iter().map(|(positions, present)| Rows::new(positions, present));
        let rows = rows.collect::<Result<Vec<_>, _>>()?;
        let report = |rows: &Rows<'_>| -> Result<_, CodecError> {
            Ok(BlockReport { samples: count_finite(*rows)? as u32, ..BlockReport::default() })
        };
        let mut reports = rows.iter().map(report).collect::<Result<Vec<_>, _>>()?;
        encoder.reset();
        let mut out = Vec::new();
        encoder.encode(&rows, &[], &mut out, &mut reports)?;
        bytes += out.len();
    }
    Ok(Tally { bytes, ..encoder.tally().clone() })
}

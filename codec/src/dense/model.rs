//! The probability model of a group: contexts, logistic mixing of their estimates, and the cost of decisions, under a
//! model that adapts to them or does not.
//!
//! One to three contexts estimate the probability of every binary decision. Each context holds a probability that
//! adapts to its bits, quickly at first. A mixer adds the logits of these probabilities with weights that adapt as
//! well (Mahoney, Adaptive weighing of context models for lossless data compression, 2005; `squash` and `stretch` are
//! his names of the logistic function and its inverse). Mixing gains 4.5 % over a single context. All arithmetic is in
//! integers: probabilities in 2^-16, logits ln(p / (1 - p)) in 1/256.

use super::contexts::{N_CONTEXTS, N_MIXERS};
#[cfg(feature = "training")]
use super::tally::Tally;
use crate::coding::range::{BinaryCoder, RangeDecoder, RangeEncoder};

/// Initial probabilities and weights, counted on recorded takes by `benches/lab`. Per context three bytes: its
/// probability in 2^-16 as a little-endian u16, and the number of bits it counts for. Then per mixer three
/// little-endian i16: its weights in 1/1024. Counts chosen context by context gain 0.4 % over 12 everywhere.
static PRIOR: &[u8; 3 * N_CONTEXTS + 6 * N_MIXERS] = include_bytes!("prior.bin");

/// The initial probability of a context in 2^-16, and its count of bits.
const fn prior_context(index: usize) -> (u16, u8) {
    let at = 3 * index;
    (u16::from_le_bytes([PRIOR[at], PRIOR[at + 1]]), PRIOR[at + 2])
}

/// The initial weights of a mixer, in 2^-16.
fn prior_weights(index: usize) -> [i32; 3] {
    std::array::from_fn(|i| {
        let at = 3 * N_CONTEXTS + 6 * index + 2 * i;
        i32::from(i16::from_le_bytes([PRIOR[at], PRIOR[at + 1]])) << 6
    })
}

/// Logits are clamped to plus and minus this: just below 8 in units of 1/256.
const MAX_LOGIT: i32 = 2047;

/// The logistic function 65536 / (1 + exp(-x)) at x = -8, -7.875 ... 8.
const SQUASH_NODES: [i32; 129] = [
    22, 25, 28, 32, 36, 41, 47, 53, 60, 68, 77, 87, 98, 111, 126, 143, 162, 184, 208, 236, 267,
    302, 342, 387, 439, 497, 562, 636, 720, 815, 922, 1042, 1179, 1333, 1506, 1701, 1921, 2168,
    2446, 2758, 3108, 3500, 3938, 4427, 4971, 5577, 6249, 6992, 7812, 8714, 9702, 10782, 11955,
    13226, 14595, 16062, 17625, 19282, 21025, 22849, 24743, 26695, 28693, 30723, 32768, 34813,
    36843, 38841, 40793, 42687, 44511, 46254, 47911, 49474, 50941, 52310, 53581, 54754, 55834,
    56822, 57724, 58544, 59287, 59959, 60565, 61109, 61598, 62036, 62428, 62778, 63090, 63368,
    63615, 63835, 64030, 64203, 64357, 64494, 64614, 64721, 64816, 64900, 64974, 65039, 65097,
    65149, 65194, 65234, 65269, 65300, 65328, 65352, 65374, 65393, 65410, 65425, 65438, 65449,
    65459, 65468, 65476, 65483, 65489, 65495, 65500, 65504, 65508, 65511, 65514,
];

/// Smallest probability of either value of a mixed bit, in 2^-16.
const MIN_P: i32 = 24;

/// The probability of a logit, linear between the nodes.
const fn squash(logit: i32) -> i32 {
    let at = logit + 2048;
    let (node, rest) = ((at >> 5) as usize, at & 31);
    (SQUASH_NODES[node] * (32 - rest) + SQUASH_NODES[node + 1] * rest + 16) >> 5
}

/// The probability of a zero bit, in 2^-16, for every logit of a one bit.
static P_ZERO: [u16; 2 * MAX_LOGIT as usize + 1] = {
    let mut table = [0; 2 * MAX_LOGIT as usize + 1];
    let mut logit = -MAX_LOGIT;
    while logit <= MAX_LOGIT {
        let p_zero = (1 << 16) - squash(logit);
        let least = if p_zero < MIN_P { MIN_P } else { p_zero };
        let most = (1 << 16) - MIN_P;
        table[(logit + MAX_LOGIT) as usize] = if least > most { most } else { least } as u16;
        logit += 1;
    }
    table
};

/// For each of 4096 intervals of probability, the smallest logit whose probability is at least the interval's middle.
static LOGITS: [i16; 4096] = {
    let mut table = [0; 4096];
    let mut logit = -MAX_LOGIT;
    let mut i = 0;
    while i < table.len() {
        while logit < MAX_LOGIT && squash(logit) < i as i32 * 16 + 8 {
            logit += 1;
        }
        table[i] = logit as i16;
        i += 1;
    }
    table
};

/// The probability of a zero bit in 2^-16 for any logit of a one bit; never 0 or 2^16.
#[inline(always)]
fn p_zero_of(logit: i64) -> u32 {
    let logit = logit.clamp(-i64::from(MAX_LOGIT), i64::from(MAX_LOGIT));
    u32::from(P_ZERO[(logit + i64::from(MAX_LOGIT)) as usize])
}

/// The logit of a probability in 2^-16.
#[inline(always)]
const fn logit(probability: u16) -> i32 {
    LOGITS[(probability >> 4) as usize] as i32
}

/// The adaptive probabilities of all contexts.
#[derive(Debug, Clone)]
struct Contexts {
    /// Upper 16 bits: the probability of a one bit. Lower 16 bits: how many bits were coded in the context.
    states: [u32; N_CONTEXTS],
    /// The logits of the probabilities, computed after each bit, so that the next decision does not wait for them.
    logits: [i16; N_CONTEXTS],
}

/// The initial state, from [`PRIOR`].
static INITIAL: Contexts = {
    let mut first = Contexts { states: [0; N_CONTEXTS], logits: [0; N_CONTEXTS] };
    let mut index = 0;
    while index < N_CONTEXTS {
        let (probability, n_bits) = prior_context(index);
        first.states[index] = (probability as u32) << 16 | n_bits as u32;
        first.logits[index] = logit(probability) as i16;
        index += 1;
    }
    first
};

impl Contexts {
    #[inline(always)]
    fn set(&mut self, index: usize, state: u32) {
        self.states[index] = state;
        self.logits[index] = logit((state >> 16) as u16) as i16;
    }

    /// Adapts a context, whose state is `state`, to a bit.
    #[inline(always)]
    fn update(&mut self, index: usize, state: u32, bit: bool) {
        let (probability, n_bits) = (state >> 16, (state & 0xffff) as usize);
        // 65535 or 0, without a branch, which would be unpredictable.
        let target = 0_u32.wrapping_sub(u32::from(bit)) >> 16;
        // The upper half of the product is the step, rounded down, also where it is negative; the sum is in range.
        let rate = CONTEXT_RATES[n_bits % CONTEXT_RATES.len()];
        let step = target.wrapping_sub(probability).wrapping_mul(rate);
        let older = u32::from(n_bits < CONTEXT_RATES.len() - 1);
        self.set(index, state.wrapping_add(step & !0xffff).wrapping_add(older));
    }
}

/// A mixer: the weights of up to three contexts in 2^-16, and the number of bits that trained it.
#[derive(Debug, Clone, Copy)]
struct Mixer {
    weights: [i32; 3],
    n_bits: u32,
}

/// The share of its error by which a context moves at its n-th bit, in 2^-16: 1/(n + 1.6), at least 2 %.
const CONTEXT_RATES: [u32; 64] = {
    let mut rates = [0; 64];
    let mut n = 0;
    while n < 64 {
        let share = 65536 * 5 / (5 * n as u32 + 8);
        rates[n] = if share < 1311 { 1311 } else { share };
        n += 1;
    }
    rates
};

/// The learning rate of a mixer at its first bit, 2 %, and the smallest, 0.6 %, in 2^-16.
const INITIAL_RATE: i32 = 1311;
const MIN_RATE: i32 = 393;

/// The learning rate of a mixer by the number of bits that trained it, in 2^-16.
const MIXER_RATES: [i32; 64] = {
    let mut rates = [0; 64];
    let mut n = 0;
    while n < 64 {
        let rate = INITIAL_RATE * 16 / (16 + n as i32);
        rates[n] = if rate < MIN_RATE { MIN_RATE } else { rate };
        n += 1;
    }
    rates
};
// The rate stays at its minimum from index 38 on, so counts may stop at 63.
const _: () = assert!(MIXER_RATES[63] == MIN_RATE);

/// A coder of modelled decisions.
pub(super) trait ModelCoder: BinaryCoder {
    /// Whether the model learns from the decisions. It does not while points are tried.
    const LEARNS: bool = true;
}

impl ModelCoder for RangeEncoder<'_> {}
impl ModelCoder for RangeDecoder<'_> {}

/// All contexts and mixers of a group.
#[derive(Debug, Clone)]
pub(super) struct Model {
    contexts: Box<Contexts>,
    mixers: Box<[Mixer; N_MIXERS]>,
    #[cfg(feature = "training")]
    pub(super) tally: Tally,
}

impl Model {
    pub(super) fn new() -> Self {
        let mut model = Self {
            contexts: Box::new(INITIAL.clone()),
            mixers: Box::new([Mixer { weights: [0; 3], n_bits: 0 }; N_MIXERS]),
            #[cfg(feature = "training")]
            tally: Tally::new(),
        };
        model.reset();
        model
    }

    /// Returns to the initial state.
    pub(super) fn reset(&mut self) {
        (*self.contexts).clone_from(&INITIAL);
        for (index, mixer) in self.mixers.iter_mut().enumerate() {
            *mixer = Mixer { weights: prior_weights(index), n_bits: 0 };
        }
        #[cfg(feature = "training")]
        self.tally.key();
    }

    /// Copies the probabilities and weights of another model.
    pub(super) fn follow(&mut self, other: &Self) {
        self.contexts.states.copy_from_slice(&other.contexts.states);
        self.contexts.logits.copy_from_slice(&other.contexts.logits);
        *self.mixers = *other.mixers;
    }

    /// Codes a bit with the mixed estimate of `N` different contexts.
    #[inline(always)]
    pub(super) fn mixed<C: ModelCoder, const N: usize>(
        &mut self,
        coder: &mut C,
        contexts: [usize; N],
        mixer: usize,
        bit: bool,
    ) -> bool {
        let states = contexts.map(|index| self.contexts.states[index]);
        // 64 bits, which compilers do not vectorise: each bit waits for the one before, so scalars encode 1.15 times
        // as fast as vectors of two or three.
        let logits = contexts.map(|index| i64::from(self.contexts.logits[index]));
        let state = &mut self.mixers[mixer];
        let mut sum = 0;
        for (&logit, weight) in logits.iter().zip(state.weights) {
            sum += logit * i64::from(weight);
        }
        let p_zero = p_zero_of(sum >> 16);
        let bit = coder.split(p_zero, bit);
        if !C::LEARNS {
            return bit;
        }
        #[cfg(feature = "training")]
        self.tally.mixed(mixer, 65536 - p_zero as i32, bit);
        let error = i64::from(p_zero) - (i64::from(!bit) << 16);
        let age = state.n_bits as usize % MIXER_RATES.len();
        let rate = i64::from(MIXER_RATES[age]);
        for (weight, logit) in state.weights.iter_mut().zip(logits) {
            let step = ((((error * logit) >> 8) * rate) + (1 << 15)) >> 16;
            // Wraps only after about 2^31 bits that all push one way; key blocks come sooner.
            *weight = weight.wrapping_add(step as i32);
        }
        state.n_bits = age as u32 + u32::from(age < MIXER_RATES.len() - 1);
        for (index, state) in contexts.into_iter().zip(states) {
            self.contexts.update(index, state, bit);
            #[cfg(feature = "training")]
            self.tally.context(index, bit);
        }
        #[cfg(feature = "training")]
        self.tally.mixer(mixer, self.mixers[mixer].weights);
        bit
    }

    /// Codes a bit with the estimate of one context.
    #[inline(always)]
    pub(super) fn single<C: ModelCoder>(&mut self, coder: &mut C, index: usize, bit: bool) -> bool {
        let state = self.contexts.states[index];
        let probability = (state >> 16).clamp(32, 65504);
        let bit = coder.split(65536 - probability, bit);
        if !C::LEARNS {
            return bit;
        }
        self.contexts.update(index, state, bit);
        #[cfg(feature = "training")]
        {
            self.tally.single(index, probability as i32, bit);
            self.tally.context(index, bit);
        }
        bit
    }
}

/// Fraction bits of a cost: it is in 2^-10 bits.
const COST_FRACTION_BITS: u32 = 10;

/// Cost of a decision by its probability in 2^-12, at the middle of each interval. Integers, so that every machine
/// makes the same plans: the binary digits of a logarithm come from repeated squaring.
static COSTS: [u16; 4096] = {
    let mut costs = [0; 4096];
    let mut i = 0;
    while i < costs.len() {
        // The mantissa of (2 i + 1) / 2^13, from 1 up to 2 in 2^-31.
        let odd = 2 * i as u64 + 1;
        let exponent = odd.ilog2();
        let mut mantissa = odd << (31 - exponent);
        let mut log = exponent as u16;
        let mut digit = 0;
        while digit < COST_FRACTION_BITS {
            mantissa = (mantissa * mantissa) >> 31;
            let above = mantissa >> 32;
            log = log << 1 | above as u16;
            mantissa >>= above;
            digit += 1;
        }
        costs[i] = (13 << COST_FRACTION_BITS) - log;
        i += 1;
    }
    costs
};

/// Counts the cost of decisions in 2^-10 bits; whether the model learns from them depends on what they are counted for.
#[derive(Debug, Default)]
pub(super) struct CostCounter<const LEARNS: bool = false> {
    pub(super) cost: u64,
}

impl<const LEARNS: bool> BinaryCoder for CostCounter<LEARNS> {
    #[inline(always)]
    fn split(&mut self, probability: u32, bit: bool) -> bool {
        let probability = if bit { 65536 - probability } else { probability };
        self.cost += u64::from(COSTS[(probability >> 4) as usize % COSTS.len()]);
        bit
    }

    #[inline(always)]
    fn plain(&mut self, value: u64, n: u32) -> u64 {
        self.cost += u64::from(n) << COST_FRACTION_BITS;
        value & ((1 << n) - 1)
    }
}

impl<const LEARNS: bool> ModelCoder for CostCounter<LEARNS> {
    const LEARNS: bool = LEARNS;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_agree_with_the_logistic_function() {
        let probability = |logit: i32| 65536 - p_zero_of(logit.into()) as i32;
        for logit in -MAX_LOGIT..=MAX_LOGIT {
            let truth = 65536.0 / (1.0 + (-f64::from(logit) / 256.0).exp());
            assert!((f64::from(probability(logit)) - truth).abs() < 20.0, "{logit}");
        }
        for p in (0..=u16::MAX).step_by(7) {
            let back = probability(logit(p));
            // A step of the logit is up to 64 wide, an interval of probabilities 16.
            assert!((back - i32::from(p)).abs() <= 80, "{p} {back}");
        }
        assert!(LOGITS.is_sorted());
    }

    #[test]
    fn costs_agree_with_the_logarithm() {
        for (i, &cost) in COSTS.iter().enumerate() {
            let bits = 13.0 - (2.0 * i as f64 + 1.0).log2();
            assert!((f64::from(cost) / 1024.0 - bits).abs() < 0.001_5, "{i}: {cost} for {bits}");
        }
        let mut counter = CostCounter::<false>::default();
        assert!(counter.split(1 << 15, true));
        assert_eq!(counter.plain(0b110_1010, 4), 0b1010);
        assert!(counter.cost.abs_diff(5 << COST_FRACTION_BITS) <= 2, "{}", counter.cost);
    }
}

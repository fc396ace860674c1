//! The odds of a group: contexts, and the mixing of what they say.
//!
//! Every decision is expected by one to three contexts at once. Each context holds a probability that
//! follows its bits, quickly at first; a mixer adds their logits with weights that follow, too
//! (logistic mixing, after Mahoney, Adaptive weighing of context models for lossless data compression,
//! 2005). All of it is integer arithmetic.
//!
//! Probabilities have 16 bits, a logit ln(p / (1 - p)) is in 1/256.

use super::contexts::{N_CONTEXTS, N_MIXERS};
#[cfg(feature = "training")]
use super::tally::Tally;
use crate::coding::range::BinaryCoder;

/// What the odds are before anything was seen, counted on real takes by `benches/lab`: three bytes a context, a
/// little-endian u16, its probability in 2^-16, and how many bits that weighs; then three little-endian i16 a mixer,
/// its weights in 1/1024.
static PRIOR: &[u8; 3 * N_CONTEXTS + 6 * N_MIXERS] = include_bytes!("prior.bin");

/// Probability in 2^-16 and weight of a context.
const fn prior_context(index: usize) -> (u16, u8) {
    let at = 3 * index;
    (u16::from_le_bytes([PRIOR[at], PRIOR[at + 1]]), PRIOR[at + 2])
}

/// The weights of a mixer, 1 being 2^16.
fn prior_weights(index: usize) -> [i32; 3] {
    std::array::from_fn(|i| {
        let at = 3 * N_CONTEXTS + 6 * index + 2 * i;
        i32::from(i16::from_le_bytes([PRIOR[at], PRIOR[at + 1]])) << 6
    })
}

/// Logits are cut to plus and minus this.
const MAX_LOGIT: i32 = 2047;

/// 65536 / (1 + exp(-x)) at x = -8, -7.875 ... 8.
const KNOTS: [i32; 129] = [
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

/// Odds of a mixed bit are not less than this, nor more than 2^16 less this.
const LEAST: i32 = 24;

/// The probability of a logit, linear between the knots.
const fn squashed(logit: i32) -> i32 {
    let at = logit + 2048;
    let (knot, rest) = ((at >> 5) as usize, at & 31);
    (KNOTS[knot] * (32 - rest) + KNOTS[knot + 1] * rest + 16) >> 5
}

/// What is left of 2^16 by the probabilities of all logits.
static UNSET: [u16; 2 * MAX_LOGIT as usize + 1] = {
    let mut table = [0; 2 * MAX_LOGIT as usize + 1];
    let mut logit = -MAX_LOGIT;
    while logit <= MAX_LOGIT {
        let unset = (1 << 16) - squashed(logit);
        let least = if unset < LEAST { LEAST } else { unset };
        let most = (1 << 16) - LEAST;
        table[(logit + MAX_LOGIT) as usize] = if least > most { most } else { least } as u16;
        logit += 1;
    }
    table
};

/// By interval of probabilities: the smallest logit whose probability is not below the middle of it.
static LOGITS: [i16; 4096] = {
    let mut table = [0; 4096];
    let mut logit = -MAX_LOGIT;
    let mut i = 0;
    while i < table.len() {
        while logit < MAX_LOGIT && squashed(logit) < i as i32 * 16 + 8 {
            logit += 1;
        }
        table[i] = logit as i16;
        i += 1;
    }
    table
};

/// The probability of a bit not being set, of a logit in any range; never 0 or 2^16.
#[inline(always)]
fn unset_of(logit: i64) -> u32 {
    let logit = logit.clamp(-i64::from(MAX_LOGIT), i64::from(MAX_LOGIT));
    u32::from(UNSET[(logit + i64::from(MAX_LOGIT)) as usize])
}

/// The logit of a probability.
#[inline(always)]
const fn logit(probability: u16) -> i32 {
    LOGITS[(probability >> 4) as usize] as i32
}

/// What is expected of bits, a context each.
#[derive(Debug, Clone)]
struct Contexts {
    /// Probabilities of a bit being set in the upper 16 bits, and how many bits they rest on in the lower.
    states: [u32; N_CONTEXTS],
    /// Of the probabilities: worked out when a bit has been seen, the next one need not wait for it.
    logits: [i16; N_CONTEXTS],
}

/// What everything starts from.
static FIRST: Contexts = {
    let mut first = Contexts { states: [0; N_CONTEXTS], logits: [0; N_CONTEXTS] };
    let mut index = 0;
    while index < N_CONTEXTS {
        let (probability, seen) = prior_context(index);
        first.states[index] = (probability as u32) << 16 | seen as u32;
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

    /// After one more bit.
    #[inline(always)]
    fn learn(&mut self, index: usize, state: u32, bit: bool) {
        let (probability, seen) = (state >> 16, (state & 0xffff) as usize);
        // 65535 or 0, without a branch: the bit is what nobody knows.
        let target = 0_u32.wrapping_sub(u32::from(bit)) >> 16;
        // Below nothing, too, the upper half of the product is the step, rounded down; the sum is in range.
        let step = target.wrapping_sub(probability).wrapping_mul(MOVES[seen % MOVES.len()]);
        let older = u32::from(seen < MOVES.len() - 1);
        self.set(index, state.wrapping_add(step & !0xffff).wrapping_add(older));
    }
}

/// Weights of up to three contexts, 1 being 2^16, and how many bits they rest on.
#[derive(Debug, Clone, Copy)]
struct Mixer {
    weights: [i32; 3],
    seen: u32,
}

/// A context moves by 1/(n + 1.6) of its error at its n-th bit, and by 2 % at least.
const MOVES: [u32; 64] = {
    let mut moves = [0; 64];
    let mut n = 0;
    while n < 64 {
        let share = 65536 * 5 / (5 * n as u32 + 8);
        moves[n] = if share < 1311 { 1311 } else { share };
        n += 1;
    }
    moves
};

/// The mixers' learning rate at first, and the least, in 2^-16.
const FIRST_RATE: i32 = 1311;
const LAST_RATE: i32 = 393;

/// What a mixer learns at after so many bits.
const RATES: [i32; 64] = {
    let mut rates = [0; 64];
    let mut seen = 0;
    while seen < 64 {
        let rate = FIRST_RATE * 16 / (16 + seen as i32);
        rates[seen] = if rate < LAST_RATE { LAST_RATE } else { rate };
        seen += 1;
    }
    rates
};
// From there on it is the least.
const _: () = assert!(RATES[63] == LAST_RATE);

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
            contexts: Box::new(FIRST.clone()),
            mixers: Box::new([Mixer { weights: [0; 3], seen: 0 }; N_MIXERS]),
            #[cfg(feature = "training")]
            tally: Tally::new(),
        };
        model.reset();
        model
    }

    /// Back to the odds that everything starts from.
    pub(super) fn reset(&mut self) {
        (*self.contexts).clone_from(&FIRST);
        for (index, mixer) in self.mixers.iter_mut().enumerate() {
            *mixer = Mixer { weights: prior_weights(index), seen: 0 };
        }
        #[cfg(feature = "training")]
        self.tally.key();
    }

    /// A bit that several contexts, all of them different, expect together.
    #[inline(always)]
    pub(super) fn mixed<const N: usize>(
        &mut self,
        coder: &mut impl BinaryCoder,
        contexts: [usize; N],
        mixer: usize,
        bit: bool,
    ) -> bool {
        let states = contexts.map(|index| self.contexts.states[index]);
        // In 64 bits, which no processor multiplies side by side: what waits for the weights is one after another.
        let logits = contexts.map(|index| i64::from(self.contexts.logits[index]));
        let weighing = &mut self.mixers[mixer];
        let mut sum = 0;
        for (&logit, weight) in logits.iter().zip(weighing.weights) {
            sum += logit * i64::from(weight);
        }
        let unset = unset_of(sum >> 16);
        let bit = coder.split(unset, bit);
        #[cfg(feature = "training")]
        self.tally.mixed(mixer, 65536 - unset as i32, bit);
        let error = i64::from(unset) - (i64::from(!bit) << 16);
        let age = weighing.seen as usize % RATES.len();
        let rate = i64::from(RATES[age]);
        for (weight, logit) in weighing.weights.iter_mut().zip(logits) {
            let step = ((((error * logit) >> 8) * rate) + (1 << 15)) >> 16;
            // It would take 2^31 bits that all push one way, and keys are nearer than that.
            *weight = weight.wrapping_add(step as i32);
        }
        weighing.seen = age as u32 + u32::from(age < RATES.len() - 1);
        for (index, state) in contexts.into_iter().zip(states) {
            self.contexts.learn(index, state, bit);
            #[cfg(feature = "training")]
            self.tally.context(index, bit);
        }
        #[cfg(feature = "training")]
        self.tally.mixer(mixer, self.mixers[mixer].weights);
        bit
    }

    /// A bit of one context.
    #[inline(always)]
    pub(super) fn single(&mut self, coder: &mut impl BinaryCoder, index: usize, bit: bool) -> bool {
        let state = self.contexts.states[index];
        let probability = (state >> 16).clamp(32, 65504);
        let bit = coder.split(65536 - probability, bit);
        self.contexts.learn(index, state, bit);
        #[cfg(feature = "training")]
        {
            self.tally.single(index, probability as i32, bit);
            self.tally.context(index, bit);
        }
        bit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_agree_with_the_logistic_function() {
        let probability = |logit: i32| 65536 - unset_of(logit.into()) as i32;
        for logit in -MAX_LOGIT..=MAX_LOGIT {
            let truth = 65536.0 / (1.0 + (-f64::from(logit) / 256.0).exp());
            assert!((f64::from(probability(logit)) - truth).abs() < 20.0, "{logit}");
        }
        for p in (0..=u16::MAX).step_by(7) {
            let back = probability(logit(p));
            // A logit step is up to 64 wide, a bucket of probabilities 16.
            assert!((back - i32::from(p)).abs() <= 80, "{p} {back}");
        }
        assert!(LOGITS.is_sorted());
    }
}

//! The odds of a group: contexts, and the mixing of what they say.
//!
//! Every decision is expected by one to three contexts at once. Each context holds a probability that
//! follows its bits, quickly at first; a mixer adds their logits with weights that follow, too
//! (logistic mixing, after Mahoney, Adaptive weighing of context models for lossless data compression,
//! 2005). All of it is integer arithmetic.

use super::{
    layout::{N_CONTEXTS, N_MIXERS},
    logistic, prior,
};
use crate::coding::range::BinaryCoder;

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
        let (probability, seen) = prior::context(index);
        first.states[index] = (probability as u32) << 16 | seen as u32;
        first.logits[index] = logistic::logit(probability) as i16;
        index += 1;
    }
    first
};

impl Contexts {
    #[inline(always)]
    fn set(&mut self, index: usize, state: u32) {
        self.states[index] = state;
        self.logits[index] = logistic::logit((state >> 16) as u16) as i16;
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
    pub(super) tally: super::training::Tally,
}

impl Model {
    pub(super) fn new() -> Self {
        let mut model = Self {
            contexts: Box::new(FIRST.clone()),
            mixers: Box::new([Mixer { weights: [0; 3], seen: 0 }; N_MIXERS]),
            #[cfg(feature = "training")]
            tally: super::training::Tally::new(),
        };
        model.reset();
        model
    }

    /// Back to the odds that everything starts from.
    pub(super) fn reset(&mut self) {
        (*self.contexts).clone_from(&FIRST);
        for (index, mixer) in self.mixers.iter_mut().enumerate() {
            *mixer = Mixer { weights: prior::weights(index), seen: 0 };
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
        let unset = logistic::unset(sum >> 16);
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

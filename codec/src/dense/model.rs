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

/// What is expected of a bit. Read and written as one, and aligned for it.
#[derive(Debug, Clone, Copy)]
#[repr(align(8))]
struct Context {
    /// Its probability of being set in the upper 16 bits, and how many bits that rests on in the lower.
    state: u32,
    /// Of the probability: worked out when a bit has been seen, the next one need not wait for it.
    logit: i32,
}

impl Context {
    fn new(probability: u16, seen: u8) -> Self {
        let logit = logistic::logit(probability);
        Self { state: u32::from(probability) << 16 | u32::from(seen), logit }
    }

    #[inline(always)]
    fn probability(self) -> u16 {
        (self.state >> 16) as u16
    }

    /// After one more bit.
    #[inline(always)]
    fn after(self, bit: bool) -> Self {
        let (probability, seen) = (self.state >> 16, self.state as usize % MOVES.len());
        // 65535 or 0, without a branch: the bit is what nobody knows.
        let target = 0_u32.wrapping_sub(u32::from(bit)) >> 16;
        // Below nothing, too, the upper half of the product is the step, rounded down; the sum is in range.
        let step = target.wrapping_sub(probability).wrapping_mul(MOVES[seen]) & !0xffff;
        let state = self.state.wrapping_add(step) + u32::from(seen < MOVES.len() - 1);
        Self { state, logit: logistic::logit((state >> 16) as u16) }
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
    contexts: Box<[Context; N_CONTEXTS]>,
    mixers: Box<[Mixer; N_MIXERS]>,
    #[cfg(feature = "training")]
    pub(super) tally: super::training::Tally,
}

impl Model {
    pub(super) fn new() -> Self {
        let mut model = Self {
            contexts: Box::new([Context { state: 0, logit: 0 }; N_CONTEXTS]),
            mixers: Box::new([Mixer { weights: [0; 3], seen: 0 }; N_MIXERS]),
            #[cfg(feature = "training")]
            tally: super::training::Tally::new(),
        };
        model.reset();
        model
    }

    /// Back to the odds that everything starts from.
    pub(super) fn reset(&mut self) {
        for (index, context) in self.contexts.iter_mut().enumerate() {
            let (probability, seen) = prior::context(index);
            *context = Context::new(probability, seen);
        }
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
        let seen = contexts.map(|index| self.contexts[index]);
        let logits = seen.map(|context| context.logit);
        let weighing = &mut self.mixers[mixer];
        let mut sum = 0;
        for (&logit, weight) in logits.iter().zip(weighing.weights) {
            sum += i64::from(logit) * i64::from(weight);
        }
        let unset = logistic::unset(sum >> 16);
        let bit = coder.split(unset, bit);
        #[cfg(feature = "training")]
        self.tally.mixed(mixer, 65536 - unset as i32, bit);
        let error = unset as i32 - (i32::from(!bit) << 16);
        let age = weighing.seen as usize % RATES.len();
        for (weight, logit) in weighing.weights.iter_mut().zip(logits) {
            let step = ((((error * logit) >> 8) * RATES[age]) + (1 << 15)) >> 16;
            // It would take 2^31 bits that all push one way, and keys are nearer than that.
            *weight = weight.wrapping_add(step);
        }
        weighing.seen = age as u32 + u32::from(age < RATES.len() - 1);
        for (index, context) in contexts.into_iter().zip(seen) {
            self.contexts[index] = context.after(bit);
            #[cfg(feature = "training")]
            self.tally.context(index, bit);
        }
        #[cfg(feature = "training")]
        self.tally.mixer(mixer, self.mixers[mixer].weights);
        bit
    }

    /// A bit of one context.
    pub(super) fn single(&mut self, coder: &mut impl BinaryCoder, index: usize, bit: bool) -> bool {
        let context = &mut self.contexts[index];
        let probability = u32::from(context.probability()).clamp(32, 65504);
        let bit = coder.split(65536 - probability, bit);
        *context = context.after(bit);
        #[cfg(feature = "training")]
        {
            self.tally.single(index, probability as i32, bit);
            self.tally.context(index, bit);
        }
        bit
    }
}

//! The odds of a group: contexts, and the mixing of what they say.
//!
//! Every decision is expected by one to three contexts at once. Each context holds a probability that
//! follows its bits, quickly at first; a mixer adds their logits with weights that follow, too
//! (logistic mixing, after Mahoney, Adaptive weighing of context models for lossless data compression,
//! 2005). All of it is integer arithmetic.

use super::{
    layout::{N_CONTEXTS, N_MIXERS},
    logistic::Logistic,
    prior,
};
use crate::coding::range::BinaryCoder;

/// A probability of a bit being set, and how many bits it rests on.
#[derive(Debug, Clone, Copy)]
struct Context {
    probability: u16,
    seen: u8,
}

/// Weights of up to three contexts, 1 being 2^16, and how many bits they rest on.
#[derive(Debug, Clone, Copy)]
struct Mixer {
    weights: [i32; 3],
    seen: u16,
}

/// A context moves by 1/(n + 1.6) of its error at its n-th bit, and by 2 % at least.
const MOVES: [i32; 64] = {
    let mut moves = [0; 64];
    let mut n = 0;
    while n < 64 {
        let share = 65536 * 5 / (5 * n as i32 + 8);
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
    contexts: Box<[Context]>,
    mixers: Box<[Mixer]>,
    logistic: &'static Logistic,
    #[cfg(feature = "training")]
    pub(super) tally: super::training::Tally,
}

impl Model {
    pub(super) fn new() -> Self {
        let context = Context { probability: 0, seen: 0 };
        let mut model = Self {
            contexts: vec![context; N_CONTEXTS].into_boxed_slice(),
            mixers: vec![Mixer { weights: [0; 3], seen: 0 }; N_MIXERS].into_boxed_slice(),
            logistic: Logistic::tables(),
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
            *context = Context { probability, seen };
        }
        for (index, mixer) in self.mixers.iter_mut().enumerate() {
            *mixer = Mixer { weights: prior::weights(index), seen: 0 };
        }
    }

    /// A bit that several contexts expect together.
    pub(super) fn mixed<const N: usize>(
        &mut self,
        coder: &mut impl BinaryCoder,
        contexts: [usize; N],
        mixer: usize,
        bit: bool,
    ) -> bool {
        let logits = contexts.map(|i| self.logistic.logit(self.contexts[i].probability));
        let weighing = &mut self.mixers[mixer];
        let sum = logits.iter().zip(weighing.weights);
        let sum = sum.fold(0, |sum, (&logit, weight)| sum + i64::from(logit) * i64::from(weight));
        let probability = self.logistic.probability(sum >> 16).clamp(24, 65512);
        let bit = coder.split((65536 - probability) as u32, bit);
        #[cfg(feature = "training")]
        self.tally.mixed(mixer, probability, bit);
        let error = (i32::from(bit) << 16) - probability;
        let rate = RATES[usize::from(weighing.seen).min(RATES.len() - 1)];
        for (weight, logit) in weighing.weights.iter_mut().zip(logits) {
            *weight += ((((error * logit) >> 8) * rate) + (1 << 15)) >> 16;
        }
        weighing.seen = (weighing.seen + 1).min(1 << 10);
        for index in contexts {
            self.learn(index, bit);
        }
        #[cfg(feature = "training")]
        self.tally.mixer(mixer, self.mixers[mixer].weights);
        bit
    }

    /// A bit of one context.
    pub(super) fn single(&mut self, coder: &mut impl BinaryCoder, index: usize, bit: bool) -> bool {
        let probability = i32::from(self.contexts[index].probability).clamp(32, 65504);
        let bit = coder.split((65536 - probability) as u32, bit);
        #[cfg(feature = "training")]
        self.tally.single(index, probability, bit);
        self.learn(index, bit);
        bit
    }

    #[inline(always)]
    fn learn(&mut self, index: usize, bit: bool) {
        let context = &mut self.contexts[index];
        let target = i32::from(bit) * 65535;
        let error = target - i32::from(context.probability);
        let step =
            (i64::from(error) * i64::from(MOVES[usize::from(context.seen) % MOVES.len()])) >> 16;
        context.probability = (i32::from(context.probability) + step as i32) as u16;
        context.seen = (context.seen + 1).min(63);
        #[cfg(feature = "training")]
        self.tally.context(index, bit);
    }
}

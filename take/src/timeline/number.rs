//! Signed integers that are mostly near zero: docs/take-format.md, "Numbers".

use mocapd_codec::range::{BinaryCoder, Bit};

/// How far the last two values are told apart: a line that batches makes a saw-tooth of them.
const LAST_MAX: i64 = 3;
const BEFORE_MAX: i64 = 1;
const CONTEXTS: usize = ((2 * LAST_MAX + 1) * (2 * BEFORE_MAX + 1)) as usize;

/// Magnitudes up to this, less one, are spelled in unary.
const LONGER: usize = 12;

/// Classes of activity begin at these.
const CLASSES: [u32; 5] = [12, 48, 128, 320, 1024];

/// An adaptive model of one kind of number.
#[derive(Debug)]
pub(super) struct Number {
    nonzero: [Bit; CONTEXTS],
    negative: [Bit; CONTEXTS],
    longer: [[Bit; LONGER]; CLASSES.len() + 1],
    exponent: [Bit; 63],
    last: i64,
    before: i64,
    activity: u32,
}

impl Number {
    /// Starts from the odds, in 1/256, that a number after two zeros is none.
    pub(super) fn new(odds: u8) -> Self {
        let mut nonzero = [Bit::expecting(128); CONTEXTS];
        nonzero[CONTEXTS / 2] = Bit::expecting(odds);
        Self {
            nonzero,
            negative: [Bit::NEW; CONTEXTS],
            longer: [[Bit::NEW; LONGER]; CLASSES.len() + 1],
            exponent: [Bit::NEW; 63],
            last: 0,
            before: 0,
            activity: 0,
        }
    }

    /// Encodes `value` and gives it back, or ignores it and gives the decoded one.
    pub(super) fn code(&mut self, coder: &mut impl BinaryCoder, value: i64) -> i64 {
        let last = self.last.clamp(-LAST_MAX, LAST_MAX) + LAST_MAX;
        let before = self.before.clamp(-BEFORE_MAX, BEFORE_MAX) + BEFORE_MAX;
        let context = (last * (2 * BEFORE_MAX + 1) + before) as usize;
        let value = if coder.bit(&mut self.nonzero[context], value != 0) {
            let negative = coder.bit(&mut self.negative[context], value < 0);
            let magnitude = self.code_magnitude(coder, value.unsigned_abs()).cast_signed();
            if negative { magnitude.wrapping_neg() } else { magnitude }
        } else {
            0
        };
        let seen = value.unsigned_abs().min(31) as u32;
        self.activity = self.activity - (self.activity >> 3) + 32 * seen;
        self.before = std::mem::replace(&mut self.last, value);
        value
    }

    /// At least 1, modulo 2^64.
    fn code_magnitude(&mut self, coder: &mut impl BinaryCoder, magnitude: u64) -> u64 {
        let class = CLASSES.iter().filter(|&&from| self.activity >= from).count();
        for (steps, longer) in (1..).zip(&mut self.longer[class]) {
            if !coder.bit(longer, magnitude > steps) {
                return steps;
            }
        }
        // What is left, and one more, has its highest bit at `exponent`.
        let rest = magnitude.wrapping_sub(LONGER as u64);
        let top = rest.max(1).ilog2();
        let mut exponent = 0;
        while exponent < 63 && coder.bit(&mut self.exponent[exponent as usize], exponent < top) {
            exponent += 1;
        }
        let low = coder.plain(rest & !(1 << top), exponent);
        (1_u64 << exponent | low).wrapping_add(LONGER as u64)
    }
}

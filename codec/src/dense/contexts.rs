//! The numbering of contexts and mixers, one family after another, and the classes that select contexts.

use super::LEVELS;

/// Kinds of rows: first row of a run; anchor 17, 5 or 1 and more rows after the last known row; strides 1 to 32.
pub(super) const KINDS: usize = 4 + LEVELS;
/// The kind of the first row of a run.
pub(super) const ORIGIN: usize = 0;
/// Stride 1, the first kind that is interpolated between decoded rows.
pub(super) const INTERPOLATED: usize = 4;

/// Magnitudes up to this are coded in unary, larger ones in Exp-Golomb code.
pub(super) const UNARY: usize = 4;
/// Exp-Golomb exponents with contexts of their own; larger ones share the last.
pub(super) const EXPONENTS: usize = 24;
/// Maximum number of ends of other channels' runs that are candidates for the origin of a first row.
pub(super) const MAX_ORIGIN_ENDS: usize = 16;
/// Largest Exp-Golomb exponent: one more than any encoder needs.
pub(super) const MAX_EXPONENT: usize = 42;

/// A family of contexts with consecutive numbers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Family {
    first: usize,
    len: usize,
}

impl Family {
    const fn after(before: Self, len: usize) -> Self {
        Self { first: before.first + before.len, len }
    }

    /// The number of the context at `index` within the family.
    pub(super) fn at(self, index: usize) -> usize {
        debug_assert!(index < self.len);
        self.first + index
    }
}

pub(super) const MOVING_REFERENCES: Family = Family { first: 0, len: KINDS * 6 * 8 };
pub(super) const MOVING_EXPECTED: Family = Family::after(MOVING_REFERENCES, KINDS * 32 * 3);
pub(super) const ODD: Family = Family::after(MOVING_EXPECTED, KINDS);
pub(super) const NONZERO_REFERENCES: Family = Family::after(ODD, KINDS * 6 * 8 * 6);
pub(super) const NONZERO_EXPECTED: Family = Family::after(NONZERO_REFERENCES, KINDS * 32 * 6);
pub(super) const SIGN_REFERENCES: Family = Family::after(NONZERO_EXPECTED, KINDS * 9);
pub(super) const SIGN_SIDE: Family = Family::after(SIGN_REFERENCES, KINDS * 9);
pub(super) const LONGER_NEAR: Family = Family::after(SIGN_SIDE, KINDS * UNARY * 6);
pub(super) const LONGER_REFERENCES: Family = Family::after(LONGER_NEAR, 3 * UNARY * 6 * 8);
pub(super) const LONGER_EXPECTED: Family = Family::after(LONGER_REFERENCES, 3 * 32 * UNARY);
pub(super) const EXPONENT_EXPECTED: Family = Family::after(LONGER_EXPECTED, 32 * EXPONENTS);
pub(super) const EXPONENT_REFERENCES: Family = Family::after(EXPONENT_EXPECTED, EXPONENTS * 6 * 8);
pub(super) const TOP_BIT: Family = Family::after(EXPONENT_REFERENCES, EXPONENTS * 32);
pub(super) const NEXT_BIT: Family = Family::after(TOP_BIT, EXPONENTS * 2);
pub(super) const ORIGIN_EXPONENT: Family = Family::after(NEXT_BIT, 3 * 3 * 48);
pub(super) const ORIGIN_OWN: Family = Family::after(ORIGIN_EXPONENT, 8);
pub(super) const ORIGIN_NONE: Family = Family::after(ORIGIN_OWN, 1);
pub(super) const ORIGIN_RANK: Family = Family::after(ORIGIN_NONE, MAX_ORIGIN_ENDS);
pub(super) const RAW: Family = Family::after(ORIGIN_RANK, 3);
pub(super) const FINE: Family = Family::after(RAW, 3);

/// Number of contexts.
pub(super) const N_CONTEXTS: usize = FINE.first + FINE.len;

/// The first mixer of each family: moving, nonzero and sign by kind of row; longer and exponent by position.
pub(super) const MIX_MOVING: usize = 0;
pub(super) const MIX_NONZERO: usize = MIX_MOVING + KINDS;
pub(super) const MIX_SIGN: usize = MIX_NONZERO + KINDS;
pub(super) const MIX_LONGER: usize = MIX_SIGN + KINDS;
pub(super) const MIX_EXPONENT: usize = MIX_LONGER + 3;
pub(super) const N_MIXERS: usize = MIX_EXPONENT + 7;

/// The class of a magnitude up to 10.
const MAGNITUDE_CLASSES: [u8; 11] = [0, 1, 2, 3, 3, 4, 4, 4, 4, 4, 5];

/// The smallest activity of each class but the first, in 1/256 of a lattice step.
const LIMITS: [u32; 7] = [5, 20, 51, 102, 205, 410, 1024];
const LAST_LIMIT: usize = 1024;

/// The class of every activity up to the last limit.
static ACTIVITY_CLASSES: [u8; LAST_LIMIT + 1] = {
    let mut table = [0; LAST_LIMIT + 1];
    let (mut activity, mut class) = (0, 0);
    while activity <= LAST_LIMIT {
        if activity as u32 == LIMITS[class as usize] {
            class += 1;
        }
        table[activity] = class;
        activity += 1;
    }
    table
};

/// The class of a magnitude, `six` in docs/codec.md: 0; 1; 2; 3 or 4; 5 to 9; 10 and more.
#[inline(always)]
pub(super) fn magnitude_class(sum: i32) -> usize {
    usize::from(MAGNITUDE_CLASSES[(sum as usize).min(MAGNITUDE_CLASSES.len() - 1)])
}

/// The class of an activity in 1/256, `eight` in docs/codec.md. These wide classes are part of a gain of 0.4 %.
#[inline(always)]
pub(super) fn activity_class(activity: i32) -> usize {
    usize::from(ACTIVITY_CLASSES[(activity as usize).min(LAST_LIMIT)])
}

/// The class of an expected magnitude in 1/256, `e32` in docs/codec.md: half octaves, 0 below 4.
#[inline(always)]
pub(super) fn expectation_class(expectation: i32) -> usize {
    let expectation = expectation.max(3) as usize;
    let octave = expectation.ilog2() as usize;
    // The top two bits are 2 or 3; the smallest expectation, 3, has octave 1 and gives class 0.
    ((expectation >> (octave - 1)) + 2 * octave - 5).min(31)
}

/// The class of a sign: 0 zero, 1 positive, 2 negative.
#[inline(always)]
pub(super) fn sign(step: i16) -> usize {
    usize::from(step > 0) + 2 * usize::from(step < 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_begin_at_their_limits() {
        let classes = [0, 1, 2, 3, 4, 5, 9, 10, 8100].map(magnitude_class);
        assert_eq!(classes, [0, 1, 2, 3, 3, 4, 4, 5, 5]);
        for activity in 0..3000 {
            let passed = LIMITS.iter().filter(|&&limit| activity as u32 >= limit).count();
            assert_eq!(activity_class(activity), passed, "{activity}");
        }
        let classes = [0, 3, 4, 5, 6, 7, 8, 11, 12].map(expectation_class);
        assert_eq!(classes, [0, 0, 1, 1, 2, 2, 3, 3, 4]);
        assert_eq!(expectation_class(i32::MAX), 31);
        assert_eq!([-3, 0, 2].map(sign), [2, 0, 1]);
    }
}

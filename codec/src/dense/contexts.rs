//! Which context is which: the numbers of the tables, one family after another; and the classes of what they go by.

use super::LEVELS;

/// Kinds of rows: first of a run, anchor of a long, a middling and a short span, and the strides.
pub(super) const KINDS: usize = 4 + LEVELS;
pub(super) const ORIGIN: usize = 0;
/// The first kind that lies between decoded rows: stride 1.
pub(super) const INTERPOLATED: usize = 4;

/// Magnitudes up to this are unary, the rest Exp-Golomb.
pub(super) const UNARY: usize = 4;
/// Classes of the exponent that have a context of their own.
pub(super) const EXPONENTS: usize = 24;
/// Candidates for an origin.
pub(super) const CANDIDATES: usize = 16;
/// The largest exponent that an encoder can need, and one to spare.
pub(super) const MAX_EXPONENT: usize = 42;

/// A family of contexts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Family {
    first: usize,
    len: usize,
}

impl Family {
    const fn after(before: Self, len: usize) -> Self {
        Self { first: before.first + before.len, len }
    }

    /// The number of one of its contexts.
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
pub(super) const ORIGIN_RANK: Family = Family::after(ORIGIN_NONE, CANDIDATES);
pub(super) const RAW: Family = Family::after(ORIGIN_RANK, 3);
pub(super) const FINE: Family = Family::after(RAW, 3);

/// Contexts in all.
pub(super) const N_CONTEXTS: usize = FINE.first + FINE.len;

/// Mixers: moving, nonzero and sign by kind; longer by position; exponents by position.
pub(super) const MIX_MOVING: usize = 0;
pub(super) const MIX_NONZERO: usize = MIX_MOVING + KINDS;
pub(super) const MIX_SIGN: usize = MIX_NONZERO + KINDS;
pub(super) const MIX_LONGER: usize = MIX_SIGN + KINDS;
pub(super) const MIX_EXPONENT: usize = MIX_LONGER + 3;
pub(super) const N_MIXERS: usize = MIX_EXPONENT + 7;

/// Of a size up to 10: 0, 1, 2, 3 or 4, 5 to 9, more.
const SIX: [u8; 11] = [0, 1, 2, 3, 3, 4, 4, 4, 4, 4, 5];

/// Where a class of activities ends and the next one begins, in 1/256.
const LIMITS: [u32; 7] = [5, 20, 51, 102, 205, 410, 1024];
const LAST_LIMIT: usize = 1024;

/// Classes of activities up to the last limit.
static EIGHT: [u8; LAST_LIMIT + 1] = {
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

/// Of a sum of magnitudes: 0, 1, 2, 3 or 4, 5 to 9, more.
#[inline(always)]
pub(super) fn six(sum: i32) -> usize {
    usize::from(SIX[(sum as usize).min(SIX.len() - 1)])
}

/// Of an activity in 1/256.
#[inline(always)]
pub(super) fn eight(activity: i32) -> usize {
    usize::from(EIGHT[(activity as usize).min(LAST_LIMIT)])
}

/// Half octaves of an expectation in 1/256; nothing below 4.
#[inline(always)]
pub(super) fn thirty_two(expectation: i32) -> usize {
    let expectation = expectation.max(3) as usize;
    let octave = expectation.ilog2() as usize;
    // The first two bits are 2 or 3: 3 is the last of class 0, of octave 1.
    ((expectation >> (octave - 1)) + 2 * octave - 5).min(31)
}

/// 0 zero, 1 positive, 2 negative.
#[inline(always)]
pub(super) fn sign(step: i16) -> usize {
    usize::from(step > 0) + 2 * usize::from(step < 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_begin_where_they_are_said_to() {
        assert_eq!([0, 1, 2, 3, 4, 5, 9, 10, 8100].map(six), [0, 1, 2, 3, 3, 4, 4, 5, 5]);
        for activity in 0..3000 {
            let passed = LIMITS.iter().filter(|&&limit| activity as u32 >= limit).count();
            assert_eq!(eight(activity), passed, "{activity}");
        }
        assert_eq!([0, 3, 4, 5, 6, 7, 8, 11, 12].map(thirty_two), [0, 0, 1, 1, 2, 2, 3, 3, 4]);
        assert_eq!(thirty_two(i32::MAX), 31);
        assert_eq!([-3, 0, 2].map(sign), [2, 0, 1]);
    }
}

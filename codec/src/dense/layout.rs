//! Which context is which: the numbers of the tables, one family after another.

/// Kinds of rows: first of a run, anchor of a long, a middling and a short span, and the strides.
pub(super) const KINDS: usize = 4 + super::LEVELS;
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

//! The syntax of one row: what it is expected by, and the bits of its residual.

use super::{
    lattice::{Lattice, Point},
    layout as is,
    layout::{EXPONENTS, KINDS, MAX_EXPONENT, UNARY},
    model::Model,
    track::{Track, magnitude, weight},
};
use crate::{CodecError, coding::range::BinaryCoder};

/// What a row's neighbours in time and its references say of its residual.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Surroundings {
    pub(super) kind: usize,
    /// Coded magnitudes: nearest rows before and after of coarser levels, the row of the same level
    /// before, and the one before that.
    pub(super) left: [i32; 3],
    pub(super) right: [i32; 3],
    pub(super) before: [i32; 3],
    pub(super) before_that: [i32; 3],
    pub(super) bend: usize,
    pub(super) side: [usize; 3],
    /// Sums of the references' magnitudes, by axis, and the sides that their residuals are on.
    pub(super) references: [i32; 3],
    pub(super) references_side: [usize; 3],
}

/// 0, 1, 2 or more.
fn three(value: i32) -> usize {
    value.min(2) as usize
}

/// 0, 1, 2, 3 or 4, 5 to 9, more.
fn six(value: i32) -> usize {
    match value {
        0..=2 => value as usize,
        3..=4 => 3,
        5..=9 => 4,
        _ => 5,
    }
}

/// Of an activity in 1/256.
fn eight(activity: i32) -> usize {
    const LIMITS: [i32; 7] = [5, 20, 51, 102, 205, 410, 1024];
    LIMITS.iter().take_while(|&&limit| activity >= limit).count()
}

/// Half octaves of an expectation in 1/256.
fn thirty_two(expectation: i32) -> usize {
    if expectation < 4 {
        return 0;
    }
    let octave = expectation.ilog2() as usize;
    (1 + 2 * (octave - 2) + (expectation >> (octave - 1) & 1) as usize).min(31)
}

/// 0 zero, 1 positive, 2 negative.
fn sign(value: i32) -> usize {
    match value.signum() {
        0 => 0,
        1 => 1,
        _ => 2,
    }
}

/// Codes one residual, in lattice steps, or none: the row stays where it is expected. Gives the steps, and
/// the magnitudes as they were coded. A residual that is there is never zero on all axes.
pub(super) fn residual(
    coder: &mut impl BinaryCoder,
    model: &mut Model,
    track: &Track,
    around: &Surroundings,
    lattice: Lattice,
    steps: Point,
) -> Result<Option<(Point, Point)>, CodecError> {
    let kind = around.kind;
    let activity = track.activity[kind];
    let (before, before_that) = (weight(around.before), weight(around.before_that));
    let (left, right) = (weight(around.left), weight(around.right));
    let references = around.references.iter().sum::<i32>();
    let expectation = ((activity * 115) >> 8)
        + before * 51
        + before_that * 26
        + (left + right) * 20
        + references * 26;
    let near = ((three(left) * 3 + three(right)) * 3 + three(before)) * 2;
    let contexts = [
        is::MOVING_NEAR.at(kind * 54 + near + usize::from(before_that > 0)),
        is::MOVING_REFERENCES.at((kind * 6 + six(references)) * 8 + eight(activity)),
        is::MOVING_EXPECTED.at((kind * 32 + thirty_two(expectation)) * 3 + around.bend),
    ];
    let moving = model.mixed(coder, contexts, is::MIX_MOVING + kind, steps != [0; 3]);
    if !moving {
        return Ok(None);
    }
    let odd =
        lattice == Lattice::Centred && model.single(coder, is::ODD.at(kind), steps[0] & 1 != 0);
    let form = match (lattice, odd) {
        (Lattice::Cubic, _) => Form { number: 0, odd, centred: false },
        (Lattice::Centred, true) => Form { number: 1, odd, centred: true },
        (Lattice::Centred, false) => Form { number: 2, odd, centred: true },
    };
    let mut coded = form.magnitudes(steps);
    let mut some = false;
    for (axis, steps) in coded.iter_mut().enumerate() {
        let certain = odd || axis == 2 && !some;
        axis_steps(coder, model, track, around, (form, axis, some, certain), steps)?;
        some |= *steps != 0;
    }
    Ok(Some((form.steps(coded), coded)))
}

/// How the steps of a residual are turned into magnitudes.
#[derive(Debug, Clone, Copy)]
struct Form {
    number: usize,
    centred: bool,
    odd: bool,
}

impl Form {
    fn magnitudes(self, steps: Point) -> Point {
        match (self.centred, self.odd) {
            (false, _) => steps,
            (true, false) => steps.map(|step| step / 2),
            (true, true) => steps.map(|step| (step.abs() + 1) / 2 * step.signum()),
        }
    }

    fn steps(self, coded: Point) -> Point {
        match (self.centred, self.odd) {
            (false, _) => coded,
            (true, false) => coded.map(|coded| coded * 2),
            (true, true) => coded.map(|coded| coded * 2 - coded.signum()),
        }
    }
}

fn axis_steps(
    coder: &mut impl BinaryCoder,
    model: &mut Model,
    track: &Track,
    around: &Surroundings,
    (form, axis, some, certain): (Form, usize, bool, bool),
    steps: &mut i64,
) -> Result<(), CodecError> {
    let kind = around.kind;
    let activity = track.axis_activity[kind][axis];
    let before = magnitude(around.before[axis]);
    let (left, right) = (magnitude(around.left[axis]), magnitude(around.right[axis]));
    let references = around.references[axis];
    let expectation = ((activity * 115) >> 8) + before * 51 + (left + right) * 20 + references * 26;
    let (expected, active) = (thirty_two(expectation), eight(activity));
    let referred = six(references);
    if !certain {
        let order =
            usize::from(axis > 0) + usize::from(axis > 0 && some) + 3 * usize::from(form.centred);
        let contexts = [
            is::NONZERO_REFERENCES.at(((kind * 6 + referred) * 8 + active) * 6 + order),
            is::NONZERO_EXPECTED.at((kind * 32 + expected) * 6 + order),
        ];
        if !model.mixed(coder, contexts, is::MIX_NONZERO + kind, *steps != 0) {
            *steps = 0;
            return Ok(());
        }
    }
    let last = sign(around.before[axis]);
    let contexts = [
        is::SIGN_PARENTS.at(kind * 9 + sign(around.left[axis]) * 3 + sign(around.right[axis])),
        is::SIGN_REFERENCES.at(kind * 9 + around.references_side[axis] * 3 + last),
        is::SIGN_SIDE.at(kind * 9 + around.side[axis] * 3 + last),
    ];
    let negative = model.mixed(coder, contexts, is::MIX_SIGN + kind, *steps < 0);
    let near = six(before.max(left).max(right));
    let place = Place { kind, form: form.number, near, referred, active, expected };
    let beyond_one = place.longer(coder, model, steps.unsigned_abs().saturating_sub(1))?;
    let length = 1 + beyond_one as i64;
    *steps = if negative { -length } else { length };
    Ok(())
}

/// The classes that a magnitude is coded in.
#[derive(Debug, Clone, Copy)]
struct Place {
    kind: usize,
    form: usize,
    near: usize,
    referred: usize,
    active: usize,
    expected: usize,
}

impl Place {
    /// A magnitude less one: unary at first, then Exp-Golomb.
    fn longer(
        self,
        coder: &mut impl BinaryCoder,
        model: &mut Model,
        value: u64,
    ) -> Result<u64, CodecError> {
        for i in 0..UNARY {
            let contexts = [
                is::LONGER_NEAR.at((self.kind * UNARY + i) * 6 + self.near),
                is::LONGER_REFERENCES
                    .at(((self.form * UNARY + i) * 6 + self.referred) * 8 + self.active),
                is::LONGER_EXPECTED.at((self.form * 32 + self.expected) * UNARY + i),
            ];
            if !model.mixed(coder, contexts, is::MIX_LONGER + i.min(2), value > i as u64) {
                return Ok(i as u64);
            }
        }
        let rest = value.wrapping_sub(UNARY as u64).wrapping_add(1);
        let wanted = rest.checked_ilog2().unwrap_or(0) as usize;
        let mut exponent = 0;
        loop {
            let i = exponent.min(EXPONENTS - 1);
            let contexts = [
                is::EXPONENT_NEAR.at((self.kind * EXPONENTS + i) * 6 + self.near),
                is::EXPONENT_REFERENCES.at((i * 6 + self.referred) * 8 + self.active),
                is::EXPONENT_EXPECTED.at(self.expected * EXPONENTS + i),
            ];
            let mixer = is::MIX_EXPONENT + exponent.min(6);
            if !model.mixed(coder, contexts, mixer, wanted > exponent) {
                break;
            }
            exponent += 1;
            if exponent > MAX_EXPONENT {
                return Err(CodecError::Corrupt("a residual beyond every coordinate"));
            }
        }
        Ok(self.mantissa(coder, model, exponent, rest) - 1 + UNARY as u64)
    }

    /// The bits below the highest: two of them adaptive.
    fn mantissa(
        self,
        coder: &mut impl BinaryCoder,
        model: &mut Model,
        exponent: usize,
        rest: u64,
    ) -> u64 {
        let class = exponent.min(EXPONENTS - 1);
        let mut value = 1;
        let mut left = exponent;
        if left > 0 {
            left -= 1;
            let context = is::TOP_BIT.at(class * 32 + self.expected);
            value = value << 1 | u64::from(model.single(coder, context, rest >> left & 1 == 1));
        }
        if left > 0 {
            left -= 1;
            let context = is::NEXT_BIT.at(class * 2 + (value & 1) as usize);
            value = value << 1 | u64::from(model.single(coder, context, rest >> left & 1 == 1));
        }
        value << left | coder.plain(rest, left as u32)
    }
}

/// The residual of a first row: it has nothing around it but the way it was found.
pub(super) fn origin(
    coder: &mut impl BinaryCoder,
    model: &mut Model,
    way: usize,
    steps: Point,
) -> Result<Point, CodecError> {
    let mut decoded = [0; 3];
    for (axis, decoded) in decoded.iter_mut().enumerate() {
        let value = steps[axis].unsigned_abs() + 1;
        let wanted = value.ilog2() as usize;
        let mut exponent = 0;
        let context = |i: usize| is::ORIGIN_EXPONENT.at((way * 3 + axis) * 48 + i);
        while model.single(coder, context(exponent), wanted > exponent) {
            exponent += 1;
            if exponent > MAX_EXPONENT {
                return Err(CodecError::Corrupt("a first row beyond every coordinate"));
            }
        }
        let low = coder.plain(value, exponent as u32);
        let length = ((1 << exponent) + low - 1) as i64;
        *decoded = length;
        if length > 0 && coder.plain(u64::from(steps[axis] < 0), 1) == 1 {
            *decoded = -length;
        }
    }
    Ok(decoded)
}

const _: () = assert!(KINDS == 10);

//! The syntax of one row: what it is expected by, and the bits of its residual.

use super::{
    ahead::Hints,
    classes::{eight, sign, six, thirty_two},
    lattice::{Lattice, Point},
    layout as is,
    layout::{EXPONENTS, KINDS, MAX_EXPONENT, UNARY},
    model::Model,
    track::{Steps, magnitude, marked, marked_weight},
};
use crate::{
    CodecError,
    coding::{isa::Kernel, range::BinaryCoder},
};

/// What is around a row, as far as it says whether the row is moved.
#[derive(Debug, Clone, Copy)]
pub(super) struct Near {
    pub(super) kind: usize,
    /// Coded magnitudes: nearest rows before and after of coarser levels, the row of the same level
    /// before, and the one before that.
    pub(super) left: Steps,
    pub(super) right: Steps,
    pub(super) before: Steps,
    pub(super) before_that: Steps,
    /// The sum of the references' marks.
    pub(super) references: u64,
    /// Of the kind, as [`Track::activity`](super::track::Track::activity).
    pub(super) activity: [i32; 4],
}

/// Codes whether a row is moved: whether its residual is not zero on all axes.
#[inline(always)]
pub(super) fn moving(
    coder: &mut impl BinaryCoder,
    model: &mut Model,
    near: &Near,
    bend: u8,
    moved: bool,
) -> bool {
    let Near { kind, left, right, before, before_that, .. } = *near;
    let activity = near.activity[3];
    let references = marked_weight(near.references);
    let expectation = ((activity * 115) >> 8)
        + i32::from(before.weight) * 51
        + i32::from(before_that.weight) * 26
        + (i32::from(left.weight) + i32::from(right.weight)) * 20
        + references * 26;
    let contexts = [
        is::MOVING_REFERENCES.at((kind * 6 + six(references)) * 8 + eight(activity)),
        is::MOVING_EXPECTED.at((kind * 32 + thirty_two(expectation)) * 3 + usize::from(bend)),
    ];
    model.mixed(coder, contexts, is::MIX_MOVING + kind, moved)
}

/// Codes the residual of a row that is moved, in lattice steps. Gives the steps, and the magnitudes as they
/// were coded. They are not zero on all axes.
#[derive(Debug)]
pub(super) struct Residual<'a, C> {
    pub(super) coder: &'a mut C,
    pub(super) model: &'a mut Model,
    pub(super) near: &'a Near,
    pub(super) hints: &'a Hints,
    pub(super) lattice: Lattice,
    pub(super) steps: Point,
}

impl<C: BinaryCoder> Kernel for Residual<'_, C> {
    type Output = Result<(Point, Point), CodecError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { coder, model, near, hints, lattice, steps } = self;
        let kind = near.kind;
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
            axis_steps(coder, model, (near, hints), (form, axis, some, certain), steps)?;
            some |= *steps != 0;
        }
        Ok((form.steps(coded), coded))
    }
}

/// How the steps of a residual are turned into magnitudes.
#[derive(Debug, Clone, Copy)]
struct Form {
    number: usize,
    centred: bool,
    odd: bool,
}

impl Form {
    #[inline(always)]
    fn magnitudes(self, steps: Point) -> Point {
        match (self.centred, self.odd) {
            (false, _) => steps,
            (true, false) => steps.map(|step| step / 2),
            (true, true) => steps.map(|step| (step.abs() + 1) / 2 * step.signum()),
        }
    }

    #[inline(always)]
    fn steps(self, coded: Point) -> Point {
        match (self.centred, self.odd) {
            (false, _) => coded,
            (true, false) => coded.map(|coded| coded * 2),
            (true, true) => coded.map(|coded| coded * 2 - coded.signum()),
        }
    }
}

#[inline(always)]
fn axis_steps(
    coder: &mut impl BinaryCoder,
    model: &mut Model,
    (near, hints): (&Near, &Hints),
    (form, axis, some, certain): (Form, usize, bool, bool),
    steps: &mut i64,
) -> Result<(), CodecError> {
    let kind = near.kind;
    let activity = near.activity[axis];
    let steps_around = [near.left, near.right, near.before].map(|row| row.axes[axis]);
    let [left, right, before] = steps_around.map(|step| magnitude(step.into()));
    let references = marked(near.references, axis);
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
    let last = sign(near.before.axes[axis]);
    let referred_side = hints.references_side[axis];
    let contexts = [
        is::SIGN_REFERENCES.at(kind * 9 + referred_side * 3 + last),
        is::SIGN_SIDE.at(kind * 9 + hints.side[axis] * 3 + last),
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
    #[inline(always)]
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
    #[inline(always)]
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

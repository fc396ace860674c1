//! The syntax of anchors and interpolated rows: the contexts of a row and the decisions that code its residual.

use super::{
    contexts::{
        EXPONENT_EXPECTED, EXPONENT_REFERENCES, EXPONENTS, KINDS, LONGER_EXPECTED, LONGER_NEAR,
        LONGER_REFERENCES, MAX_EXPONENT, MIX_EXPONENT, MIX_LONGER, MIX_MOVING, MIX_NONZERO,
        MIX_SIGN, MOVING_EXPECTED, MOVING_REFERENCES, NEXT_BIT, NONZERO_EXPECTED,
        NONZERO_REFERENCES, ODD, SIGN_REFERENCES, SIGN_SIDE, TOP_BIT, UNARY, activity_class,
        expectation_class, magnitude_class, sign,
    },
    level_prediction::Hints,
    model::{Model, ModelCoder},
    points::{Lattice, Point},
    track::{Steps, magnitude, unpack_magnitude, unpack_sum},
};
use crate::{Result, coding::isa::Kernel, ensure};

/// Weights, in units of 1/256, of the magnitudes around a row in the sum that chooses its contexts: those of the
/// activity, the row before in the level, the one before that, the two neighbours, and the references. The format
/// fixes them; no derivation is on record.
const ACTIVITY_WEIGHT: i32 = 115;
const BEFORE_WEIGHT: i32 = 51;
const BEFORE2_WEIGHT: i32 = 26;
const NEIGHBOUR_WEIGHT: i32 = 20;
const REFERENCE_WEIGHT: i32 = 26;

/// The decoded neighbourhood of a row, from which its contexts are chosen.
#[derive(Debug, Clone, Copy)]
pub(super) struct Neighbourhood {
    pub(super) kind: usize,
    /// Coded steps of the nearest rows of coarser levels before and after, of the row before in the same level, and of
    /// the one before that.
    pub(super) left: Steps,
    pub(super) right: Steps,
    pub(super) before: Steps,
    pub(super) before2: Steps,
    /// The sum of the references' packed steps.
    pub(super) references: u64,
    /// The activities of the kind, as in [`Track::activity`](super::track::Track::activity).
    pub(super) activity: [i32; 4],
}

/// Codes whether a row differs from its prediction: whether its residual is nonzero on any axis.
#[inline(always)]
pub(super) fn moving(
    coder: &mut impl ModelCoder,
    model: &mut Model,
    near: &Neighbourhood,
    bend: u8,
    moved: bool,
) -> bool {
    let Neighbourhood { kind, left, right, before, before2, .. } = *near;
    let activity = near.activity[3];
    let references = unpack_sum(near.references);
    let expectation = ((activity * ACTIVITY_WEIGHT) >> 8)
        + i32::from(before.weight) * BEFORE_WEIGHT
        + i32::from(before2.weight) * BEFORE2_WEIGHT
        + (i32::from(left.weight) + i32::from(right.weight)) * NEIGHBOUR_WEIGHT
        + references * REFERENCE_WEIGHT;
    let contexts = [
        MOVING_REFERENCES
            .at((kind * 6 + magnitude_class(references)) * 8 + activity_class(activity)),
        MOVING_EXPECTED.at((kind * 32 + expectation_class(expectation)) * 3 + usize::from(bend)),
    ];
    model.mixed(coder, contexts, MIX_MOVING + kind, moved)
}

/// Codes the residual of a moved row in lattice steps; at least one axis is nonzero.
#[derive(Debug)]
pub(super) struct Residual<'a, C> {
    pub(super) coder: &'a mut C,
    pub(super) model: &'a mut Model,
    pub(super) near: &'a Neighbourhood,
    pub(super) hints: &'a Hints,
    pub(super) lattice: Lattice,
    pub(super) steps: Point,
}

/// A coded residual: its lattice steps, and the magnitudes with signs by which they were coded.
#[derive(Debug)]
pub(super) struct CodedSteps {
    pub(super) steps: Point,
    pub(super) magnitudes: Point,
}

impl<C: ModelCoder> Kernel for Residual<'_, C> {
    type Output = Result<CodedSteps>;

    #[inline(always)]
    fn run(mut self) -> Self::Output {
        let centred = self.lattice == Lattice::Centred;
        let context = ODD.at(self.near.kind);
        let odd = centred && self.model.single(self.coder, context, self.steps[0] & 1 != 0);
        let form = Form { centred, odd };
        let mut magnitudes = form.magnitudes(self.steps);
        let mut some = false;
        for (axis, magnitude) in magnitudes.iter_mut().enumerate() {
            let certain = odd || axis == 2 && !some;
            *magnitude = self.axis(Axis { axis, form, some, certain }, *magnitude)?;
            some |= *magnitude != 0;
        }
        Ok(CodedSteps { steps: form.steps(magnitudes), magnitudes })
    }
}

/// The mapping between the steps of a residual and its coded magnitudes: on the centred lattice all steps are odd or
/// all even, so that half of each is enough.
#[derive(Debug, Clone, Copy)]
struct Form {
    centred: bool,
    odd: bool,
}

impl Form {
    /// The number of the form in the contexts.
    #[inline(always)]
    fn number(self) -> usize {
        match (self.centred, self.odd) {
            (false, _) => 0,
            (true, true) => 1,
            (true, false) => 2,
        }
    }

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

/// One axis of a residual, as far as earlier axes determine it.
#[derive(Debug, Clone, Copy)]
struct Axis {
    axis: usize,
    form: Form,
    /// Whether an earlier axis is nonzero.
    some: bool,
    /// Whether the axis must be nonzero, so that this is not coded.
    certain: bool,
}

/// The context classes of a magnitude.
#[derive(Debug, Clone, Copy)]
struct Classes {
    kind: usize,
    form: usize,
    near: usize,
    referred: usize,
    active: usize,
    expected: usize,
}

impl<C: ModelCoder> Residual<'_, C> {
    #[inline(always)]
    fn axis(&mut self, Axis { axis, form, some, certain }: Axis, wanted: i64) -> Result<i64> {
        let Neighbourhood { kind, left, right, before, references, activity, .. } = *self.near;
        let last = sign(before.axes[axis]);
        let [left, right, before] =
            [left, right, before].map(|row| magnitude(row.axes[axis].into()));
        let references = unpack_magnitude(references, axis);
        let expectation = ((activity[axis] * ACTIVITY_WEIGHT) >> 8)
            + before * BEFORE_WEIGHT
            + (left + right) * NEIGHBOUR_WEIGHT
            + references * REFERENCE_WEIGHT;
        let classes = Classes {
            kind,
            form: form.number(),
            near: magnitude_class(before.max(left).max(right)),
            referred: magnitude_class(references),
            active: activity_class(activity[axis]),
            expected: expectation_class(expectation),
        };
        let Classes { referred, active, expected, .. } = classes;
        if !certain {
            let order = usize::from(axis > 0)
                + usize::from(axis > 0 && some)
                + 3 * usize::from(form.centred);
            let contexts = [
                NONZERO_REFERENCES.at(((kind * 6 + referred) * 8 + active) * 6 + order),
                NONZERO_EXPECTED.at((kind * 32 + expected) * 6 + order),
            ];
            if !self.model.mixed(self.coder, contexts, MIX_NONZERO + kind, wanted != 0) {
                return Ok(0);
            }
        }
        let contexts = [
            SIGN_REFERENCES.at(kind * 9 + self.hints.references_side[axis] * 3 + last),
            SIGN_SIDE.at(kind * 9 + self.hints.side[axis] * 3 + last),
        ];
        let negative = self.model.mixed(self.coder, contexts, MIX_SIGN + kind, wanted < 0);
        let beyond_one = self.longer(classes, wanted.unsigned_abs().saturating_sub(1))?;
        let length = 1 + beyond_one as i64;
        Ok(if negative { -length } else { length })
    }

    /// Codes a magnitude less one: up to [`UNARY`] in unary, the rest in Exp-Golomb code.
    #[inline(always)]
    fn longer(&mut self, classes: Classes, value: u64) -> Result<u64> {
        let Classes { kind, form, near, referred, active, expected } = classes;
        for i in 0..UNARY {
            let contexts = [
                LONGER_NEAR.at((kind * UNARY + i) * 6 + near),
                LONGER_REFERENCES.at(((form * UNARY + i) * 6 + referred) * 8 + active),
                LONGER_EXPECTED.at((form * 32 + expected) * UNARY + i),
            ];
            if !self.model.mixed(self.coder, contexts, MIX_LONGER + i.min(2), value > i as u64) {
                return Ok(i as u64);
            }
        }
        let rest = value.wrapping_sub(UNARY as u64).wrapping_add(1);
        let wanted = rest.checked_ilog2().unwrap_or(0) as usize;
        let mut exponent = 0;
        loop {
            let i = exponent.min(EXPONENTS - 1);
            let contexts = [
                EXPONENT_REFERENCES.at((i * 6 + referred) * 8 + active),
                EXPONENT_EXPECTED.at(expected * EXPONENTS + i),
            ];
            let mixer = MIX_EXPONENT + exponent.min(6);
            if !self.model.mixed(self.coder, contexts, mixer, wanted > exponent) {
                break;
            }
            exponent += 1;
            ensure(exponent <= MAX_EXPONENT, "a residual out of range")?;
        }
        Ok(self.mantissa(expected, exponent, rest) - 1 + UNARY as u64)
    }

    /// Codes the bits below the highest: the top two with contexts (coding exponents and upper mantissa bits with
    /// contexts is
    /// part of a gain of 0.4 %), the others plain.
    #[inline(always)]
    fn mantissa(&mut self, expected: usize, exponent: usize, rest: u64) -> u64 {
        let class = exponent.min(EXPONENTS - 1);
        let mut value = 1;
        let mut left = exponent;
        if left > 0 {
            left -= 1;
            let context = TOP_BIT.at(class * 32 + expected);
            value = value << 1
                | u64::from(self.model.single(self.coder, context, rest >> left & 1 == 1));
        }
        if left > 0 {
            left -= 1;
            let context = NEXT_BIT.at(class * 2 + (value & 1) as usize);
            value = value << 1
                | u64::from(self.model.single(self.coder, context, rest >> left & 1 == 1));
        }
        value << left | self.coder.plain(rest, left as u32)
    }
}

const _: () = assert!(KINDS == 10);

//! The syntax of a row: the origin and the residual of the first row of a run, and the decisions that code the
//! residual of an anchor or an interpolated row, with their contexts.
//!
//! The candidates for the origin of a run are the last sample of its own channel, moved as its nearest neighbour has moved since; the last
//! samples of other channels whose runs have ended and are not continued, since unlabelled markers change channels;
//! and the current position of another marker. Continuing the runs of other channels gains 1.8 %; it makes the one
//! unlabelled take up to 1.5 times smaller.

use super::{
    contexts::{
        EXPONENT_EXPECTED, EXPONENT_REFERENCES, EXPONENTS, KINDS, LONGER_EXPECTED, LONGER_NEAR,
        LONGER_REFERENCES, MAX_EXPONENT, MAX_ORIGIN_ENDS, MIX_EXPONENT, MIX_LONGER, MIX_MOVING,
        MIX_NONZERO, MIX_SIGN, MOVING_EXPECTED, MOVING_REFERENCES, NEXT_BIT, NONZERO_EXPECTED,
        NONZERO_REFERENCES, ODD, ORIGIN_EXPONENT, ORIGIN_NONE, ORIGIN_OWN, ORIGIN_RANK,
        SIGN_REFERENCES, SIGN_SIDE, TOP_BIT, UNARY, activity_class, expectation_class,
        magnitude_class, sign,
    },
    lattice::{Grid, Lattice, Point},
    level_prediction::{Hints, PAST_ROWS},
    model::{Model, ModelCoder},
    track::{Steps, Track, magnitude, unpack_magnitude, unpack_sum},
};
use crate::{Position, Result, block::squared_distance, coding::isa::Kernel, ensure};

/// How a first row is coded: the index of its origin among the candidates, and the lattice steps from there.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct FirstRow {
    pub(super) candidate: usize,
    pub(super) steps: Point,
}

/// Chooses the origin of a first row with this position, and its steps from there; `step` is the size of a step in
/// units. If `is_exact`, origins from which the steps lead to the position itself come first.
pub(super) fn choose(
    grid: Grid,
    position: Position,
    step: i64,
    is_exact: bool,
    origins: &[Point],
) -> FirstRow {
    let units = grid.units(position);
    let steps_from = |from: &Point| -> Point {
        std::array::from_fn(|axis| ((units[axis] - from[axis] as f64) / step as f64).round() as i64)
    };
    // In half bits: the exponent, as many mantissa bits, a sign, and the rank of the candidate.
    let cost = |steps: &Point| -> u64 {
        let axis = |step: &i64| {
            let value = step.unsigned_abs() * 2 + 1;
            u64::from(value.ilog2()) * 4 + (value >> (value.ilog2().max(1) - 1) & 1) * 2
        };
        steps.iter().map(axis).sum()
    };
    let ranked = origins.iter().enumerate().map(|(rank, from)| {
        let start = FirstRow { candidate: rank, steps: steps_from(from) };
        let rank_cost = if rank == 0 { 2 + origins.len() as u64 } else { rank as u64 };
        let point = std::array::from_fn(|axis| (from[axis] + start.steps[axis] * step) as f64);
        let misses = is_exact && grid.position(point) != position;
        (misses, cost(&start.steps) + rank_cost, start)
    });
    let best = ranked.min_by_key(|&(misses, cost, start)| (misses, cost, start.candidate));
    best.map(|(_, _, start)| start).unwrap_or_default()
}

/// Ends of other channels' runs are candidates for fewer rows than this.
const MAX_END_AGE_ROWS: u64 = 200;

/// The candidates for the origin of a first row: the nearby marker, always present; then the channel's own end, if any;
/// then the ends of other channels.
#[derive(Debug)]
pub(super) struct OriginCandidates {
    points: [Point; MAX_ORIGIN_ENDS + 2],
    /// The channels of the ends.
    channels: [usize; MAX_ORIGIN_ENDS + 2],
    n: usize,
    first_end: usize,
    /// Age of the channel's own end, in rows.
    own: Option<u64>,
}

impl OriginCandidates {
    pub(super) fn find(
        tracks: &[Track],
        channel: usize,
        at: usize,
        first_row: u64,
        present: &[Option<&[bool]>],
    ) -> Self {
        let (mut points, mut channels) = ([[0; 3]; MAX_ORIGIN_ENDS + 2], [0; MAX_ORIGIN_ENDS + 2]);
        if let Some(before) = tracks[..channel].iter().rev().find(|track| track.is_known(at)) {
            points[0] = before.point(at);
        }
        let now = first_row + (at - PAST_ROWS) as u64;
        let own = tracks[channel].end.map(|end| now - end.row);
        if let (Some(end), Some(age)) = (tracks[channel].end, own) {
            points[1] = follow_nearest(tracks, channel, at, end.point, age);
        }
        let first_end = 1 + usize::from(own.is_some());
        // The latest end first; ties in the order of channels.
        let (mut n, mut rows) = (first_end, [u64::MAX; MAX_ORIGIN_ENDS + 2]);
        for (k, track) in tracks.iter().enumerate().take(present.len()) {
            let Some(end) = track.end.filter(|_| k != channel) else { continue };
            let goes_on = (end.row + 1).checked_sub(first_row).is_some_and(|next| {
                present[k].is_some_and(|present| present.get(next as usize).is_some_and(|&p| p))
            });
            if end.taken || goes_on || end.row >= now || end.row + MAX_END_AGE_ROWS <= now {
                continue;
            }
            let place = rows[..n].partition_point(|&row| row >= end.row);
            if place == first_end + MAX_ORIGIN_ENDS {
                continue;
            }
            n = (n + 1).min(first_end + MAX_ORIGIN_ENDS);
            rows[place..n].rotate_right(1);
            channels[place..n].rotate_right(1);
            points[place..n].rotate_right(1);
            (rows[place], channels[place], points[place]) = (end.row, k, end.point);
        }
        Self { points, channels, n, first_end, own }
    }

    pub(super) fn points(&self) -> &[Point] {
        &self.points[..self.n]
    }

    /// Codes the index of the chosen candidate.
    pub(super) fn code(
        &self,
        coder: &mut impl ModelCoder,
        model: &mut Model,
        choice: usize,
    ) -> usize {
        if let Some(age) = self.own {
            let class = age.max(1).ilog2().min(7) as usize;
            if model.single(coder, ORIGIN_OWN.at(class), choice == 1) {
                return 1;
            }
        }
        let Self { n, first_end, .. } = *self;
        if n == first_end || model.single(coder, ORIGIN_NONE.at(0), choice == 0) {
            return 0;
        }
        (first_end..n - 1)
            .find(|&end| model.single(coder, ORIGIN_RANK.at(end - first_end), choice == end))
            .unwrap_or(n - 1)
    }

    /// The class of a candidate, for the contexts of the residual: 0 nearby, 1 own, 2 an end.
    pub(super) fn class(&self, choice: usize) -> usize {
        match (choice, self.own) {
            (0, _) => 0,
            (1, Some(_)) => 1,
            _ => 2,
        }
    }

    /// The channel whose run a candidate continues; `None` for the nearby marker and the channel's own end.
    pub(super) fn taken(&self, choice: usize) -> Option<usize> {
        (choice >= self.first_end).then(|| self.channels[choice])
    }
}

/// A point of `rows` rows ago, moved as the channel nearest to it at that time has moved since.
fn follow_nearest(tracks: &[Track], channel: usize, at: usize, point: Point, rows: u64) -> Point {
    let Some(then) = usize::try_from(rows).ok().and_then(|rows| at.checked_sub(rows)) else {
        return point;
    };
    let mut best = (f64::INFINITY, point);
    for (k, track) in tracks.iter().enumerate() {
        if k == channel || !track.is_known(at) || !track.is_known(then) {
            continue;
        }
        let (old, new) = (track.point(then), track.point(at));
        let off = |axis: usize| old[axis].wrapping_sub(point[axis]) as f64;
        let squares = squared_distance([off(0), off(1), off(2)], [0.0; 3]);
        if squares < best.0 {
            let axes = |axis: usize| point[axis].wrapping_add(new[axis]).wrapping_sub(old[axis]);
            best = (squares, std::array::from_fn(axes));
        }
    }
    best.1
}

/// Codes the residual of a first row in Exp-Golomb code, with the class of its origin as the only context.
pub(super) fn residual(
    coder: &mut impl ModelCoder,
    model: &mut Model,
    class: usize,
    steps: Point,
) -> Result<Point> {
    let mut decoded = [0; 3];
    for (axis, decoded) in decoded.iter_mut().enumerate() {
        let value = steps[axis].unsigned_abs() + 1;
        let target = value.ilog2() as usize;
        let mut exponent = 0;
        let context = |i: usize| ORIGIN_EXPONENT.at((class * 3 + axis) * 48 + i);
        while model.single(coder, context(exponent), target > exponent) {
            exponent += 1;
            ensure(exponent <= MAX_EXPONENT, "a first row out of range")?;
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

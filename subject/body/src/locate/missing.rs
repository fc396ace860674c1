//! What is missing of a body: limbs that end too early, and a head that is not there.
//!
//! Each limb is judged by itself before both sides are brought to one length: by how long it is beside the other one and
//! beside the body, and by whether its end has the shape of a foot or a hand.

use super::scale::ALL_PAIRS;
use super::section::{STEP, Sections, between, level};
use super::{FOOT, Fields, HAND, HEAD};
use crate::mesh::Point;

/// How much shorter one arm is than the other on a whole body, at most, in body scales: less, in any pose. A hand has 0.108 of stature (Drillis and Contini 1966).
/// What has the shape of a hand at its end is left whole up to this.
const ARM_SHORTER: f64 = 0.08;
/// The same where the end has not the shape of a hand: 0.023 was seen, and hands that are cut off have 0.06 and more.
const HANDLESS_SHORTER: f64 = 0.03;
/// The same of legs: 0.044 was seen, in lunges, and a knee that bends sharply shortens the way over it by more. A difference that is the legs' own is 0.003 of stature in the mean, and beyond
/// 0.012 in one of a thousand people (Knutson 2005); a foot and what is below the ankle have 0.08 of the way along the skin.
const LEG_SHORTER: f64 = 0.1;
/// The same where the end has not the shape of a foot.
const FOOTLESS_SHORTER: f64 = 0.02;
/// How much shorter than of a whole body's proportion the way between the hands is where both are missing, as a logarithm:
/// it is shorter by 0.12 at most on free bodies, and by 0.2 without hands.
const HANDS_SHORTER: f64 = 0.17;
/// What the ways lose with a hand or a foot that is cut off where it begins, in body scales.
const END: f64 = 0.08;
/// Ways between hands, and from the head to a foot, on an average body, in body scales: see `extremity::naming`.
const HAND_TO_HAND: f64 = 0.945;
const HEAD_TO_FOOT: f64 = 1.078;

/// The longest curve round the heel over the shortest round the ankle behind it, at least. Chosen between measured ends: of
/// whole feet nearly all have 1.22 to 1.9, of shanks and thighs that are cut nearly all 1.00 to 1.10.
const HEEL_LEAST: f64 = 1.14;
/// Where the heel is, in body scales from the end; and the ankle is at most so far behind it.
const HEEL: [f64; 2] = [0.09, 0.19];
const ANKLE_REACH: f64 = 0.08;
/// How far the end of a foot lies off the line of the shank, in radii of the shank: whole feet have 2.1 to 5, mostly over 2.8.
/// The end of a stump lies within its own girth, whatever the curves are: then there is no foot.
const WITHIN_GIRTH: f64 = 1.0;
/// An end that lies off by so much is a foot without a heel's bulge, too. The slant of a cut alone, of 40 degrees, gives 0.84; with a
/// leg that bends, or a part of the heel left, 2.5 was seen once, and 3.6 and more where the cut left the toes.
const OFF_AXIS_LEAST: f64 = 2.5;
/// The part of the leg that is taken for the shank, in body scales.
const SHANK: [f64; 2] = [0.15, 0.25];
/// The longest curve of a hand over that of the wrist, at least. Chosen between measured ends: open hands have 1.6 to 2.9, fists
/// of generated bodies 1.0 to 1.4 and tell little, arms that are cut 1.00 to 1.04.
const HAND_LEAST: f64 = 1.15;
/// A hand that has so much is open: no fist of a generated body but few have it.
const PLAIN_HAND: f64 = 1.5;
/// An arm without a hand has less: 1.04 was seen.
const NO_HAND: f64 = 1.08;
/// Where a hand is thickest, and how far behind that the wrist is at most.
const HAND_AT: [f64; 2] = [0.03, 0.13];
const WRIST_REACH: f64 = 0.09;

/// What is missing at each end, in the mesh's unit, by the ways between ends alone.
pub(super) fn from_distances(fields: &Fields<'_>) -> [f64; 5] {
    let mut missing = [0.0; 5];
    let Some(scale) = scale(fields) else { return missing };
    for (pair, others, most) in [(HAND, FOOT, ARM_SHORTER), (FOOT, HAND, LEG_SHORTER)] {
        let Some((short, by)) = shorter(fields, pair, others) else { continue };
        if by.least > most * scale {
            missing[short] = by.mean;
        }
    }
    missing
}

/// The same, with the shape of the ends. `arms` and `legs` are the curves round them; the first leg is on the side of the first
/// arm.
pub(super) fn from_shape(
    fields: &Fields<'_>,
    from_distances: [f64; 5],
    arms: [&Sections; 2],
    legs: [&Sections; 2],
    toes: [Point; 2],
) -> [f64; 5] {
    let mut missing = from_distances;
    let Some(scale) = scale(fields) else { return missing };
    let hands = arms.map(|arm| has_hand(&arm.perimeter));
    let feet = [has_foot(legs[0], toes[0]), has_foot(legs[1], toes[1])];
    let ends = [(HAND, FOOT, hands, HANDLESS_SHORTER), (FOOT, HAND, feet, FOOTLESS_SHORTER)];
    for (pair, others, whole, most) in ends {
        if pair.iter().any(|end| missing[*end] > 0.0) {
            continue;
        }
        let one = shorter(fields, pair, others).filter(|(end, by)| {
            let side = usize::from(*end == pair[1]);
            !whole[side] && by.least > most * scale
        });
        if let Some((end, by)) = one {
            missing[end] = by.mean;
        }
    }
    // One hand that is plainly a hand, and none on the other arm: then a pose that hides part of the difference from one of the
    // two measures is allowed for, and their mean counts.
    let bulges = arms.map(|arm| bulge(&arm.perimeter, HAND_AT, WRIST_REACH));
    for (side, end) in HAND.into_iter().enumerate() {
        let whole = HAND.iter().all(|hand| missing[*hand] <= 0.0);
        let by = shorter_by(fields, [end, HAND[1 - side]], FOOT);
        let is_shorter = by.is_some_and(|[a, b]| f64::midpoint(a, b) > END / 2.0 * scale);
        if whole && is_shorter && bulges[side] < NO_HAND && bulges[1 - side] > PLAIN_HAND {
            missing[end] = END * scale;
        }
    }
    let ways = fields.between(HAND[0], HAND[1]).zip(head_to_feet(fields));
    let hands_near = ways.is_some_and(|(hands, legs)| {
        (hands / HAND_TO_HAND).ln() - (legs / HEAD_TO_FOOT).ln() < -HANDS_SHORTER
    });
    let both = [(HAND, hands == [false; 2] && hands_near), (FOOT, feet == [false; 2])];
    for (pair, _) in both.into_iter().filter(|(_, none)| *none) {
        pair.into_iter().for_each(|end| missing[end] = f64::max(missing[end], END * scale));
    }
    missing
}

/// By how much a limb is shorter than its twin, in the mesh's unit.
struct Shortfall {
    /// By the two measures' lesser: what no pose alone does to both.
    least: f64,
    mean: f64,
}

/// The shorter of two limbs: as seen from the head, and from the other pair of ends. Nothing if the two do not agree.
fn shorter(
    fields: &Fields<'_>,
    [a, b]: [usize; 2],
    others: [usize; 2],
) -> Option<(usize, Shortfall)> {
    // Negative where the first is shorter.
    let [by_head, by_others] = shorter_by(fields, [a, b], others)?.map(|by| -by);
    if by_head * by_others <= 0.0 {
        return None;
    }
    let short = if by_head < 0.0 { a } else { b };
    let (by_head, by_others) = (by_head.abs(), by_others.abs());
    let by = Shortfall { least: by_head.min(by_others), mean: f64::midpoint(by_head, by_others) };
    Some((short, by))
}

/// By how much the first of two limbs is shorter than the second, in the mesh's unit: as seen from the head, and from the other
/// pair of ends.
fn shorter_by(fields: &Fields<'_>, [a, b]: [usize; 2], [c, d]: [usize; 2]) -> Option<[f64; 2]> {
    let way = |one: usize, other: usize| fields.between(one, other);
    let by_head = way(HEAD, b)? - way(HEAD, a)?;
    // Both ends of the other pair together: each is nearer to one side.
    let by_others = (way(c, b)? + way(d, b)? - way(c, a)? - way(d, a)?) / 2.0;
    Some([by_head, by_others])
}

/// The body scale, as long as ways that are missing let it be.
fn scale(fields: &Fields<'_>) -> Option<f64> {
    Some(fields.pairwise().sum::<Option<f64>>()? / ALL_PAIRS)
}

/// The mean way from the head to the feet.
fn head_to_feet(fields: &Fields<'_>) -> Option<f64> {
    let [a, b] = FOOT.map(|foot| fields.between(HEAD, foot));
    Some(f64::midpoint(a?, b?))
}

fn has_hand(perimeter: &[f64]) -> bool {
    bulge(perimeter, HAND_AT, WRIST_REACH) >= HAND_LEAST
}

/// Whether the leg has a heel and ends outside its shank's girth, or ends far outside.
fn has_foot(leg: &Sections, toes: Point) -> bool {
    let heel = bulge(&leg.perimeter, HEEL, ANKLE_REACH) >= HEEL_LEAST;
    match off_axis(leg, toes) {
        Some(off) => off >= OFF_AXIS_LEAST || heel && off >= WITHIN_GIRTH,
        None => heel,
    }
}

/// The most by which a curve between two levels is longer than one behind it, as a ratio.
fn bulge(perimeter: &[f64], within: [f64; 2], reach: f64) -> f64 {
    let reach = (reach / STEP) as usize;
    let mut most: f64 = 1.0;
    for (at, length) in between(perimeter, within) {
        let behind = perimeter[at..].iter().take(reach + 1).copied();
        most = most.max(length / behind.fold(f64::INFINITY, f64::min).max(f64::MIN_POSITIVE));
    }
    most
}

/// How far the end lies off the line of the shank, in radii of the shank. Nothing where there is no line.
fn off_axis(leg: &Sections, end: Point) -> Option<f64> {
    let [low, high] = SHANK.map(|at| leg.centre_at(at));
    let along = (high - low).try_normalize(0.0)?;
    let offset = end - low;
    let off = (offset - along * offset.dot(&along)).norm();
    let middle = leg.perimeter.get((f64::midpoint(SHANK[0], SHANK[1]) / STEP) as usize)?;
    let radius = middle / std::f64::consts::TAU;
    (radius > 0.0).then(|| off / radius)
}

/// A head is thickest between these levels from its crown, in body scales.
const HEAD_AT: [f64; 2] = [0.03, 0.13];
/// The neck is thinnest at most so far from there.
const NECK_ENDS: f64 = 0.24;
/// No neck is thicker: 0.38 at most, as they are and in other builds.
const NECK_MOST: f64 = 0.5;

/// No head has less girth: the means are 0.33 of stature of men and 0.34 of women (ANSUR II, Gordon et al. 2014), those of hands
/// 0.12 and 0.11; curves that go round spread fingers have up to 0.25, measured.
const HEAD_LEAST: f64 = 0.27;
/// No neck is thinner behind a head of less than [`HEAD_STOUT`]: the means are 0.23 of stature of men and 0.20 of women, of
/// wrists 0.10 (ANSUR II); stout wrists of measured bodies have 0.14.
const NECK_LEAST: f64 = 0.16;
/// No hand is this thick.
const HEAD_STOUT: f64 = 0.36;

/// No curve round a hand is longer, in body scales, however its fingers are spread: 0.255 was seen of stout ones. One round a
/// head is.
const HAND_MOST: f64 = 0.30;
/// Where a hand ends on a body with its fist closed, in body scales.
const HAND_ENDS: f64 = 0.10;

/// Whether the curves round an arm's end may be those of a hand or of what is left of an arm, and not of a head.
pub(super) fn may_be_a_hand(perimeter: &[f64]) -> bool {
    between(perimeter, [0.0, HAND_ENDS]).map(|(_, length)| length).fold(0.0, f64::max) <= HAND_MOST
}

/// The curves round the head and behind it, in body scales.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neck {
    /// The longest round the head.
    pub head: f64,
    /// The shortest behind that, up to the shoulders.
    pub neck: f64,
}

impl Neck {
    /// The longest curve round the head over the shortest behind it. On what is left of a neck the curves only grow, or go
    /// round shoulders and arms, and it is 1.
    #[must_use]
    pub fn narrows(self) -> f64 {
        if self.neck > NECK_MOST { 1.0 } else { self.head / self.neck.max(f64::MIN_POSITIVE) }
    }

    /// Whether this may be a head, and is no hand and no stump that was taken for one.
    #[must_use]
    pub fn may_be_a_head(self) -> bool {
        let is_thin = self.head < HEAD_LEAST || (self.neck < NECK_LEAST && self.head < HEAD_STOUT);
        !is_thin
    }

    pub(super) fn new(perimeter: &[f64]) -> Self {
        let longest = between(perimeter, HEAD_AT).max_by(|one, other| one.1.total_cmp(&other.1));
        let Some((at, head)) = longest else { return Self { head: 0.0, neck: 0.0 } };
        let behind = between(perimeter, [level(at), NECK_ENDS]).map(|(_, length)| length);
        Self { head, neck: behind.fold(head, f64::min) }
    }
}

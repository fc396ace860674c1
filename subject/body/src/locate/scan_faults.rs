//! Faults of a scan: limbs that have fused, which shortens distances, limbs that end early, and a missing head; and
//! the body scale, independent of unit and pose, against which they are measured.
//!
//! Each limb is assessed before both sides get a common length: by its length relative to the other limb and to
//! the body, and by the shape of its end.

use super::{
    FOOT, Fields, HAND, HEAD, STEP,
    limb::{Sections, between, level},
};
use crate::mesh::Point;

/// Distance between the feet on an upright body, in body scales.
const FOOT_TO_FOOT: f64 = 1.09;
/// Sum of the distances between all ten pairs of extremities, in body scales.
const ALL_PAIRS: f64 = 10.3;

/// Range of the ratio of both estimates on free bodies: the learned ones have 0.93 to 1.09.
const FREE_RATIO: [f64; 2] = [0.90, 1.13];
/// Beyond this ratio the distances are not those of one body.
const RATIO_MAX: f64 = 1.6;

/// The body scale and the agreement of its two estimates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BodyScale {
    /// Length in the mesh's unit: about the stature.
    pub(super) length: f64,
    /// Ratio of the estimate from the feet to that from all pairs: 1 if the limbs are free.
    feet_to_all: f64,
}

impl BodyScale {
    /// The mean of two estimates, each a geodesic length divided by its value on a body of average build. The distance
    /// between the feet changes by 5 % with the pose, the sum over all pairs by 3 %; girth hardly affects either.
    ///
    /// Contact shortens distances and never lengthens them: if the estimates disagree, the longer counts.
    ///
    /// None if an extremity is unreachable, two coincide, or the estimates are not those of a body.
    pub(super) fn new(fields: &Fields<'_>) -> Option<Self> {
        let feet = fields.between(FOOT[0], FOOT[1])? / FOOT_TO_FOOT;
        let all = fields.pairwise().map(|d| Some(d.filter(|d| *d > 0.0)? / ALL_PAIRS));
        let all = all.sum::<Option<f64>>()?;
        let feet_to_all = feet / all;
        let found = Self { length: f64::midpoint(feet, all), feet_to_all };
        let length = if found.disagrees() { feet.max(all) } else { found.length };
        let is_body = (1.0 / RATIO_MAX..RATIO_MAX).contains(&feet_to_all) && length.is_finite();
        is_body.then_some(Self { length, feet_to_all })
    }

    /// Whether some distances are too short for the others.
    pub(super) fn disagrees(self) -> bool {
        !(FREE_RATIO[0]..=FREE_RATIO[1]).contains(&self.feet_to_all)
    }
}

/// Largest ratio of an arm's longest curve to its shortest, without hand and armpit: free bodies that were learned
/// from, stout builds included, have at most 2.7.
const ARM_MAX: f64 = 4.0;
/// Largest ratio of a leg's longest curve to its shortest, without foot and groin: at most 2.5, and 3.2 on squatting
/// generated bodies of capsules.
const LEG_MAX: f64 = 3.4;
/// Levels of the arm's longest and shortest curve, in body scales.
const ARM: [[f64; 2]; 2] = [[0.17, 0.33], [0.12, 0.25]];
/// Levels of the leg's longest and shortest curve, in body scales.
const LEG: [[f64; 2]; 2] = [[0.20, 0.50], [0.17, 0.30]];

/// Limbs in contact, whose joints are uncertain.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Touching {
    /// Left and right arm.
    pub arms: [bool; 2],
    /// Left and right leg: both or neither.
    pub legs: [bool; 2],
    /// Whether some geodesic distance is too short, so the body scale and every joint are in doubt.
    pub scale: bool,
}

impl Touching {
    /// From the curves of each limb; none for a cut limb.
    pub(super) fn new(
        scale: BodyScale,
        arms: [Option<&Sections>; 2],
        legs: [Option<&Sections>; 2],
    ) -> Self {
        // Only the distance between the feet can be too short for all others if the feet touch. If it is too long for
        // them, the others cross arms.
        let feet = scale.disagrees() && scale.feet_to_all < 1.0;
        let across = scale.disagrees() && !feet;
        Self {
            arms: arms.map(|arm| across || arm.is_some_and(|arm| widening(arm, ARM) > ARM_MAX)),
            // A leg most often touches the other one.
            legs: [feet || legs.into_iter().flatten().any(|leg| widening(leg, LEG) > LEG_MAX); 2],
            scale: scale.disagrees(),
        }
    }

    /// Whether anything is in doubt.
    #[must_use]
    pub fn any(&self) -> bool {
        self.scale || self.arms.contains(&true) || self.legs.contains(&true)
    }
}

/// Ratio of the longest curve within some levels to the shortest within others.
fn widening(limb: &Sections, [longest, shortest]: [[f64; 2]; 2]) -> f64 {
    let lengths = |levels| between(&limb.perimeter, levels).map(|(_, length)| length);
    let most = lengths(longest).fold(0.0, f64::max);
    most / lengths(shortest).fold(f64::INFINITY, f64::min).max(f64::MIN_POSITIVE)
}

/// Largest difference in length between whole arms in any pose, in body scales; a hand has 0.108 of stature (Drillis
/// and Contini 1966). An arm that ends in the shape of a hand counts as whole up to this difference.
const ARM_SHORTER: f64 = 0.08;
/// Largest difference if the shorter arm has no hand shape: whole arms have at most 0.023, missing hands 0.06 and more.
const HANDLESS_SHORTER: f64 = 0.03;
/// Largest difference between whole legs: 0.044 was measured in lunges, and a sharply bent knee shortens the path over
/// it by more. The legs' own difference is 0.003 of stature on average and exceeds 0.012 in one of a thousand people
/// (Knutson 2005); a foot, measured from the ankle along the skin, has 0.08.
const LEG_SHORTER: f64 = 0.1;
/// Largest difference if the shorter leg has no foot shape.
const FOOTLESS_SHORTER: f64 = 0.02;
/// Minimum logarithmic shortening of the distance between the hands relative to the body if both hands are missing:
/// free bodies have at most 0.12, bodies without hands 0.2.
const HANDS_SHORTER: f64 = 0.17;
/// Length lost with a hand or a foot cut off at its beginning, in body scales.
const END: f64 = 0.08;
/// Distances from hand to hand and from head to foot on an average body, in body scales: see `extremity::naming`.
const HAND_TO_HAND: f64 = 0.945;
const HEAD_TO_FOOT: f64 = 1.078;

/// Minimum ratio of the longest curve around the heel to the shortest around the ankle. Nearly all whole feet have
/// 1.22 to 1.9, nearly all cut shanks and thighs 1.00 to 1.10.
const HEEL_MIN: f64 = 1.14;
/// Range of the heel in body scales from the end, and largest distance from there to the ankle.
const HEEL: [f64; 2] = [0.09, 0.19];
const ANKLE_REACH: f64 = 0.08;
/// Distance of the end of a foot from the axis of the shank, in radii of the shank: whole feet have 2.1 to 5, mostly
/// over 2.8. An end within the girth of its limb is a stump, even if its curves resemble a foot's.
const WITHIN_GIRTH: f64 = 1.0;
/// A larger distance is a foot even without the bulge of a heel. The slant of a cut of 40 degrees alone gives 0.84;
/// with a bent leg or part of the heel left, 2.5 was measured once, and 3.6 and more where the cut left the toes.
const OFF_AXIS_MIN: f64 = 2.5;
/// Range of the shank, in body scales.
const SHANK: [f64; 2] = [0.15, 0.25];
/// Minimum ratio of the longest curve of a hand to that of the wrist. Open hands have 1.6 to 2.9, cut arms 1.00 to
/// 1.04; fists of generated bodies have 1.0 to 1.4 and are weak evidence.
const HAND_MIN: f64 = 1.15;
/// A hand with this ratio is open: few fists of generated bodies have it.
const PLAIN_HAND: f64 = 1.5;
/// An arm without a hand has less; 1.04 was measured.
const NO_HAND: f64 = 1.08;
/// Range of a hand's thickest curve, and largest distance from there to the wrist.
const HAND_AT: [f64; 2] = [0.03, 0.13];
const WRIST_REACH: f64 = 0.09;

/// Missing length at each extremity, in the mesh's unit, by distances alone.
pub(super) fn missing_by_distances(fields: &Fields<'_>) -> [f64; 5] {
    let mut missing = [0.0; 5];
    let Some(scale) = scale(fields) else { return missing };
    for (pair, others, most) in [(HAND, FOOT, ARM_SHORTER), (FOOT, HAND, LEG_SHORTER)] {
        let Some(by) = shorter(fields, pair, others) else { continue };
        if by.least > most * scale {
            missing[by.end] = by.mean;
        }
    }
    missing
}

/// Missing length at each extremity with the shapes of the ends. `arms` and `legs` are their curves; the first leg is
/// on the side of the first arm.
pub(super) fn missing_by_shape(
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
        let one = shorter(fields, pair, others).filter(|by| {
            let side = usize::from(by.end == pair[1]);
            !whole[side] && by.least > most * scale
        });
        if let Some(by) = one {
            missing[by.end] = by.mean;
        }
    }
    // One arm with an open hand, the other without any: a pose may hide part of the difference from one of the two
    // measures, so their mean counts.
    let bulges = arms.map(|arm| bulge(&arm.perimeter, HAND_AT, WRIST_REACH));
    for (side, end) in HAND.into_iter().enumerate() {
        let whole = HAND.iter().all(|hand| missing[*hand] <= 0.0);
        let by = shorter_by(fields, [end, HAND[1 - side]], FOOT);
        let is_shorter = by.is_some_and(|[a, b]| f64::midpoint(a, b) > END / 2.0 * scale);
        if whole && is_shorter && bulges[side] < NO_HAND && bulges[1 - side] > PLAIN_HAND {
            missing[end] = END * scale;
        }
    }
    let lengths = fields.between(HAND[0], HAND[1]).zip(head_to_feet(fields));
    let hands_near = lengths.is_some_and(|(hands, legs)| {
        (hands / HAND_TO_HAND).ln() - (legs / HEAD_TO_FOOT).ln() < -HANDS_SHORTER
    });
    let both = [(HAND, hands == [false; 2] && hands_near), (FOOT, feet == [false; 2])];
    for (pair, _) in both.into_iter().filter(|(_, none)| *none) {
        pair.into_iter().for_each(|end| missing[end] = f64::max(missing[end], END * scale));
    }
    missing
}

/// Shortening of a limb relative to the contralateral one, in the mesh's unit.
struct Shortfall {
    /// The extremity of the shorter limb.
    end: usize,
    /// The smaller of the two measures: no pose alone affects both.
    least: f64,
    mean: f64,
}

/// The shorter of two limbs, as seen from the head and from the other pair of extremities; none if these disagree.
fn shorter(fields: &Fields<'_>, [a, b]: [usize; 2], others: [usize; 2]) -> Option<Shortfall> {
    // Negative if the first limb is shorter.
    let [by_head, by_others] = shorter_by(fields, [a, b], others)?.map(|by| -by);
    if by_head * by_others <= 0.0 {
        return None;
    }
    let end = if by_head < 0.0 { a } else { b };
    let (by_head, by_others) = (by_head.abs(), by_others.abs());
    let (least, mean) = (by_head.min(by_others), f64::midpoint(by_head, by_others));
    Some(Shortfall { end, least, mean })
}

/// Shortening of the first limb relative to the second, in the mesh's unit, as seen from the head and from the other
/// pair of extremities.
fn shorter_by(fields: &Fields<'_>, [a, b]: [usize; 2], [c, d]: [usize; 2]) -> Option<[f64; 2]> {
    let distance = |one: usize, other: usize| fields.between(one, other);
    let by_head = distance(HEAD, b)? - distance(HEAD, a)?;
    // Both ends of the other pair, since each is nearer to one side.
    let by_others = (distance(c, b)? + distance(d, b)? - distance(c, a)? - distance(d, a)?) / 2.0;
    Some([by_head, by_others])
}

/// The body scale, as far as missing parts allow.
fn scale(fields: &Fields<'_>) -> Option<f64> {
    Some(fields.pairwise().sum::<Option<f64>>()? / ALL_PAIRS)
}

/// Mean distance from the head to the feet.
fn head_to_feet(fields: &Fields<'_>) -> Option<f64> {
    let [a, b] = FOOT.map(|foot| fields.between(HEAD, foot));
    Some(f64::midpoint(a?, b?))
}

fn has_hand(perimeter: &[f64]) -> bool {
    bulge(perimeter, HAND_AT, WRIST_REACH) >= HAND_MIN
}

/// Whether the leg has a heel and ends outside the girth of its shank, or ends far outside.
fn has_foot(leg: &Sections, toes: Point) -> bool {
    let heel = bulge(&leg.perimeter, HEEL, ANKLE_REACH) >= HEEL_MIN;
    match off_axis(leg, toes) {
        Some(off) => off >= OFF_AXIS_MIN || heel && off >= WITHIN_GIRTH,
        None => heel,
    }
}

/// Largest ratio of a curve between two levels to a later one within `reach`.
fn bulge(perimeter: &[f64], within: [f64; 2], reach: f64) -> f64 {
    let reach = (reach / STEP) as usize;
    let mut most: f64 = 1.0;
    for (at, length) in between(perimeter, within) {
        let behind = perimeter[at..].iter().take(reach + 1).copied();
        most = most.max(length / behind.fold(f64::INFINITY, f64::min).max(f64::MIN_POSITIVE));
    }
    most
}

/// Distance of the end from the axis of the shank, in radii of the shank; none without an axis.
fn off_axis(leg: &Sections, end: Point) -> Option<f64> {
    let [low, high] = SHANK.map(|at| leg.centre_at(at));
    let along = (high - low).try_normalize(0.0)?;
    let offset = end - low;
    let off = (offset - along * offset.dot(&along)).norm();
    let middle = leg.perimeter.get((f64::midpoint(SHANK[0], SHANK[1]) / STEP) as usize)?;
    let radius = middle / std::f64::consts::TAU;
    (radius > 0.0).then(|| off / radius)
}

/// Range of a head's thickest curve from its crown, in body scales.
const HEAD_AT: [f64; 2] = [0.03, 0.13];
/// Largest distance from the crown to the neck's thinnest curve.
const NECK_ENDS: f64 = 0.24;
/// Largest girth of a neck: 0.38 was measured, builds included.
const NECK_MAX: f64 = 0.5;

/// Minimum girth of a head: the means are 0.33 of stature for men and 0.34 for women (ANSUR II, Gordon et al.
/// 2014), those of hands 0.12 and 0.11; curves around spread fingers have up to 0.25.
const HEAD_MIN: f64 = 0.27;
/// Minimum girth of a neck below a head of less than [`HEAD_STOUT`]: the means are 0.23 of stature for men and 0.20
/// for women, 0.10 for wrists (ANSUR II); stout wrists have 0.14.
const NECK_MIN: f64 = 0.16;
/// A hand is never this thick.
const HEAD_STOUT: f64 = 0.36;

/// Largest curve around a hand, in body scales, however its fingers are spread: 0.255 was measured on stout ones.
/// Around a head they are longer.
const HAND_MAX: f64 = 0.30;
/// Length of a closed fist, in body scales.
const HAND_ENDS: f64 = 0.10;

/// Whether the curves around an arm's end may be those of a hand or of a stump, and not of a head.
pub(super) fn may_be_a_hand(perimeter: &[f64]) -> bool {
    between(perimeter, [0.0, HAND_ENDS]).map(|(_, length)| length).fold(0.0, f64::max) <= HAND_MAX
}

/// Girths of head and neck, in body scales.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neck {
    /// The longest curve around the head.
    pub head: f64,
    /// The shortest curve from there to the shoulders.
    pub neck: f64,
}

impl Neck {
    /// Ratio of the girths of head and neck. It is 1 on a remainder of a neck, where the curves only grow or go around
    /// shoulders and arms.
    #[must_use]
    pub fn girth_ratio(self) -> f64 {
        if self.neck > NECK_MAX { 1.0 } else { self.head / self.neck.max(f64::MIN_POSITIVE) }
    }

    /// Whether this may be a head, and not a hand or a stump mistaken for one.
    #[must_use]
    pub fn may_be_a_head(self) -> bool {
        let is_thin = self.head < HEAD_MIN || (self.neck < NECK_MIN && self.head < HEAD_STOUT);
        !is_thin
    }

    pub(super) fn new(perimeter: &[f64]) -> Self {
        let longest = between(perimeter, HEAD_AT).max_by(|one, other| one.1.total_cmp(&other.1));
        let Some((at, head)) = longest else { return Self { head: 0.0, neck: 0.0 } };
        let behind = between(perimeter, [level(at), NECK_ENDS]).map(|(_, length)| length);
        Self { head, neck: behind.fold(head, f64::min) }
    }
}

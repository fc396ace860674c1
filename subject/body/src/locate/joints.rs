//! Joint centres from landmarks.

use std::collections::BTreeMap;

use super::model::{JOINTS, Model};
use super::{Landmarks, Touching, limb};
use crate::mesh::Point;
use crate::{Estimate, Joint, Joints, Side};

/// Index of a landmark in the forefoot, proximal to the toes.
const TOES: usize = 0;

/// Additional standard deviations of joints of a limb that touches something, in body scales: about the root mean
/// square errors on the learned shapes with limbs touching.
const SHOULDER_IN_DOUBT: f64 = 0.15;
const ELBOW_IN_DOUBT: f64 = 0.05;
const HIP_IN_DOUBT: f64 = 0.06;
const KNEE_IN_DOUBT: f64 = 0.07;
/// Additional standard deviation of every joint if the body scale is in doubt.
const SCALE_IN_DOUBT: f64 = 0.02;

/// Additional standard deviation of the head if its point is not the one farthest from the neck: the forehead or a
/// temple is at most a quarter of the head's girth away, 0.08 of stature.
const OFF_TOP: f64 = 0.05;

/// Additional standard deviation of the joints of a cut limb along it, in body scales: the missing length comes from
/// distances that change with the pose by 0.03, and the place of a stump's end by its thickness.
const OF_STUMP: f64 = 0.05;
/// Additional standard deviation of hip and shoulder of a cut limb, which landmarks of the trunk support too.
const ROOT_OF_STUMP: f64 = 0.03;
/// Minimum length of limb beyond a joint, in body scales, for the joint to be located.
const STUMP_MIN: f64 = 0.03;

/// The joints of a set of landmarks, in the frame and unit of their mesh.
#[must_use]
pub fn joints(landmarks: &Landmarks) -> Joints {
    let of = &*JOINTS;
    let arms = limbs(landmarks, 0, [&of.shoulder, &of.elbow, &of.wrist], limb::elbow_sigma);
    let arms = equalise_bones(arms, UPPER_ARM_PRIOR, of.upper_arm);
    let legs = limbs(landmarks, 1, [&of.hip, &of.knee, &of.ankle], limb::knee_sigma);
    let legs = equalise_bones(legs, THIGH_PRIOR, of.thigh);
    let toes = [0, 1].map(|side| landmarks.halves[side].leg.get(TOES).copied().unwrap_or_default());
    let left = left(legs, toes);
    let Touching { arms: arms_touch, legs: legs_touch, scale } = landmarks.touching;
    let doubt = if scale { SCALE_IN_DOUBT } else { 0.0 };
    let mut estimates = BTreeMap::new();
    let mut add = |joint: Joint, at: Point, sigma: f64| {
        let position = (at * landmarks.scale).into();
        let sigma = sigma.hypot(doubt) * landmarks.scale;
        estimates.insert(joint, Estimate { position, sigma });
    };
    let of_top = if landmarks.head_is_in_doubt() { OFF_TOP } else { 0.0 };
    // Midline joints are seen from both sides.
    let middle = |model: &Model| (landmarks.joint(model, 0) + landmarks.joint(model, 1)) / 2.0;
    add(Joint::Head, middle(&of.head), of.head.sigma.hypot(of_top));
    add(Joint::Throat, middle(&of.throat), of.throat.sigma);
    let in_doubt = |touches: bool, by: f64| if touches { by } else { 0.0 };
    // Hips depend on arm landmarks too.
    let touched = arms_touch.contains(&true) || legs_touch.contains(&true);
    let of_stumps = legs.map(|leg| leg.stump(ROOT_OF_STUMP));
    let hip_sigma = of.hip.sigma.hypot(in_doubt(touched, HIP_IN_DOUBT));
    let hip_sigma = hip_sigma.hypot(of_stumps[0].max(of_stumps[1]));
    // The errors of the two hips are about half common, half independent.
    add(Joint::Pelvis, (legs[0].root + legs[1].root) / 2.0, hip_sigma);
    for (half, (arm, leg)) in arms.iter().zip(&legs).enumerate() {
        let side = if half == left.unwrap_or(0) { Side::Left } else { Side::Right };
        let of_arm = |sigma: f64, by: f64| sigma.hypot(in_doubt(arms_touch[half], by));
        let shoulder_sigma = of_arm(of.shoulder.sigma, SHOULDER_IN_DOUBT);
        add(Joint::Shoulder(side), arm.root, shoulder_sigma.hypot(arm.stump(ROOT_OF_STUMP)));
        add(Joint::Hip(side), leg.root, hip_sigma);
        let elbow_sigma = of_arm(arm.hinge_sigma, ELBOW_IN_DOUBT);
        let knee_sigma = leg.hinge_sigma.hypot(in_doubt(legs_touch[half], KNEE_IN_DOUBT));
        let [[wrist, elbow, _], [ankle, knee, _]] = landmarks.halves[half].marks;
        for (joint, limb, at, mark, sigma) in [
            (Joint::Elbow(side), arm, arm.hinge, elbow, elbow_sigma),
            (Joint::Wrist(side), arm, arm.end, wrist, of.wrist.sigma),
            (Joint::Knee(side), leg, leg.hinge, knee, knee_sigma),
            (Joint::Ankle(side), leg, leg.end, ankle, of.ankle.sigma),
        ] {
            if limb.missing <= 0.0 || mark >= limb.missing + STUMP_MIN {
                add(joint, at, sigma.hypot(limb.stump(OF_STUMP)));
            }
        }
    }
    Joints { estimates, sides_told: left.is_some(), size_sigma: 0.0 }
}

/// An arm or a leg, in body scales.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limb {
    /// Shoulder or hip.
    pub(super) root: Point,
    /// Elbow or knee.
    pub(super) hinge: Point,
    /// Wrist or ankle.
    pub(super) end: Point,
    /// Standard deviation of the hinge along the limb.
    pub(super) hinge_sigma: f64,
    /// Missing length of the limb. A cut limb keeps its bones, and the other limb its own lengths.
    pub(super) missing: f64,
}

impl Limb {
    /// `by` if part of the limb is missing, else 0.
    fn stump(&self, by: f64) -> f64 {
        if self.missing > 0.0 { by } else { 0.0 }
    }
}

/// Both arms (`part` 0) or both legs (1), by the models `of` their root, hinge and end.
fn limbs(landmarks: &Landmarks, part: usize, of: [&Model; 3], sigma: fn(f64) -> f64) -> [Limb; 2] {
    [0, 1].map(|side| {
        let [root, hinge, end] = of.map(|model| landmarks.joint(model, side));
        let hinge_sigma = sigma(landmarks.halves[side].sharpness[part]).hypot(of[1].sigma);
        Limb { root, hinge, end, hinge_sigma, missing: landmarks.missing[part][side] }
    })
}

/// Weight of the average body's bone length against the measured one.
///
/// Shoulder and hip lie deep, and their landmarks shift with the girth. Elbow and knee lie on a bend and were weighed
/// against the average already.
pub(super) const UPPER_ARM_PRIOR: f64 = 0.6;
/// Half the optimum for bodies near the average: it costs these little and leaves others as they are.
pub(super) const THIGH_PRIOR: f64 = 0.3;

/// Gives the bones of two limbs one length, and draws the upper bones towards `average`, the average body's length.
/// Joints move along their bones from the ends inwards, since outer joints are more certain.
pub(super) fn equalise_bones(mut limbs: [Limb; 2], prior_weight: f64, average: f64) -> [Limb; 2] {
    let whole = limbs.map(|limb| if limb.missing > 0.0 { 0.0 } else { 1.0 });
    if whole == [0.0; 2] {
        return limbs;
    }
    let weights = [0, 1].map(|side| whole[side] * limbs[side].hinge_sigma.powi(-2));
    let length = mean(limbs.map(|limb| (limb.hinge - limb.end).norm()), weights);
    for limb in limbs.iter_mut().filter(|limb| limb.missing <= 0.0) {
        limb.hinge = at(limb.end, limb.hinge, length);
    }
    let length = mean(limbs.map(|limb| (limb.root - limb.hinge).norm()), whole);
    let length = length + prior_weight * (average - length);
    for limb in limbs.iter_mut().filter(|limb| limb.missing <= 0.0) {
        limb.root = at(limb.hinge, limb.root, length);
    }
    limbs
}

/// Weighted mean of the two sides.
fn mean([a, b]: [f64; 2], [weight_a, weight_b]: [f64; 2]) -> f64 {
    (a * weight_a + b * weight_b) / (weight_a + weight_b)
}

/// The point at distance `length` from `from` in the direction of `towards`.
fn at(from: Point, towards: Point, length: f64) -> Point {
    let bone = (towards - from).try_normalize(0.0).unwrap_or_default();
    from + bone * length
}

/// Minimum cosine of the angle between the hips' axis and the legs'; below it left and right stay unknown.
const AGREEMENT_MIN: f64 = 0.3;

/// Minimum cosine if only one foot is visible: a leg rotated outwards by 60 degrees is not evidence.
const AGREEMENT_OF_ONE_MIN: f64 = 0.5;

/// Index of the left leg; none if the feet give no answer. `toes` are points in the front of the feet.
///
/// Toes point forwards. Hip, knee and ankle bend about axes that run from right to left, so in every pose the cross
/// product of shank (upwards) and foot (forwards) points to the left.
pub(super) fn left(legs: [Limb; 2], toes: [Point; 2]) -> Option<usize> {
    let with_feet = legs.iter().zip(toes).filter(|(leg, _)| leg.missing <= 0.0);
    let to_left =
        |(leg, toes): (&Limb, Point)| (leg.hinge - leg.end).cross(&(toes - leg.end)).normalize();
    let feet: Vec<Point> = with_feet.map(to_left).collect();
    let least = match feet.len() {
        0 => return None,
        1 => AGREEMENT_OF_ONE_MIN,
        _ => AGREEMENT_MIN,
    };
    // Legs rotated against each other cancel: the sum is short on purpose, and not normalised.
    let sum: Point = feet.iter().sum();
    let agreement = (legs[0].root - legs[1].root).normalize().dot(&sum) / feet.len() as f64;
    (agreement.abs() >= least).then_some(usize::from(agreement < 0.0))
}

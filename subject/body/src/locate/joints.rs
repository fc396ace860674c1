//! From landmarks to joints.

use std::collections::BTreeMap;

use super::model::{JOINTS, Model};
use super::{Landmarks, Touching, limb};
use crate::mesh::Point;
use crate::{Estimate, Joint, Joints, Side};

/// A landmark in the front of the foot, behind the toes.
const TOES: usize = 0;

/// How far joints may be off besides, in body scales, where a limb touches something: about the root mean squares of the errors
/// on the shapes that were learned from, with limbs touching.
const SHOULDER_IN_DOUBT: f64 = 0.15;
const ELBOW_IN_DOUBT: f64 = 0.05;
const HIP_IN_DOUBT: f64 = 0.06;
const KNEE_IN_DOUBT: f64 = 0.07;
/// How far any joint may be off because the scale is.
const SCALE_IN_DOUBT: f64 = 0.02;

/// How far the top of the head may be off where it is not what is farthest from the neck: from there to the forehead or a temple
/// it is a quarter of the head's girth, 0.08 of stature, at most.
const OFF_TOP: f64 = 0.05;

/// How far the joints of a limb that ends early may be off along it, in body scales: what is missing is told by ways that
/// change with the pose by 0.03, and where a stump ends by as much as it is thick.
const OF_STUMP: f64 = 0.05;
/// How far hip and shoulder of such a limb may be off, which landmarks of the trunk tell, too.
const ROOT_OF_STUMP: f64 = 0.03;
/// A joint is told where the limb goes on behind it by at least this, in body scales.
const STUMP_LEAST: f64 = 0.03;

/// The joints among landmarks, in the frame and unit of the mesh that these are of.
#[must_use]
pub fn joints(landmarks: &Landmarks) -> Joints {
    let of = &*JOINTS;
    let arms =
        equalise_bones([0, 1].map(|side| arm(landmarks, side)), UPPER_ARM_PRIOR, of.upper_arm);
    let legs = equalise_bones([0, 1].map(|side| leg(landmarks, side)), THIGH_PRIOR, of.thigh);
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
    // A joint in the middle of the body: as seen from both sides.
    let middle = |model: &Model| (landmarks.joint(model, 0) + landmarks.joint(model, 1)) / 2.0;
    add(Joint::Head, middle(&of.head), of.head.sigma.hypot(of_top));
    add(Joint::Throat, middle(&of.throat), of.throat.sigma);
    let in_doubt = |touches: bool, by: f64| if touches { by } else { 0.0 };
    // Hips are told by arms too.
    let touched = arms_touch.contains(&true) || legs_touch.contains(&true);
    let of_stumps = legs.map(|leg| leg.stump(ROOT_OF_STUMP));
    let hip_sigma = of.hip.sigma.hypot(in_doubt(touched, HIP_IN_DOUBT));
    let hip_sigma = hip_sigma.hypot(of_stumps[0].max(of_stumps[1]));
    // The errors of two hips are about as much the same as they are each one's own.
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
            if limb.missing <= 0.0 || mark >= limb.missing + STUMP_LEAST {
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
    /// How far the hinge may be off along the limb.
    pub(super) hinge_sigma: f64,
    /// How much of the limb is not in the scan: then its bones stay as they are, and the other limb's lengths are its own.
    pub(super) missing: f64,
}

impl Limb {
    /// `by` where a part of the limb is missing.
    fn stump(&self, by: f64) -> f64 {
        if self.missing > 0.0 { by } else { 0.0 }
    }
}

fn arm(landmarks: &Landmarks, side: usize) -> Limb {
    let at = |model: &Model| landmarks.joint(model, side);
    Limb {
        root: at(&JOINTS.shoulder),
        hinge: at(&JOINTS.elbow),
        end: at(&JOINTS.wrist),
        hinge_sigma: limb::elbow_sigma(landmarks.halves[side].sharpness[0])
            .hypot(JOINTS.elbow.sigma),
        missing: landmarks.missing[0][side],
    }
}

fn leg(landmarks: &Landmarks, side: usize) -> Limb {
    let at = |model: &Model| landmarks.joint(model, side);
    Limb {
        root: at(&JOINTS.hip),
        hinge: at(&JOINTS.knee),
        end: at(&JOINTS.ankle),
        hinge_sigma: limb::knee_sigma(landmarks.halves[side].sharpness[1])
            .hypot(JOINTS.knee.sigma),
        missing: landmarks.missing[1][side],
    }
}

/// How much the length of the average body counts against the measured one.
///
/// Shoulder and hip lie deep, and their landmarks shift with the girth. Elbow and knee lie on a bend, whose place was weighed
/// against the average already.
pub(super) const UPPER_ARM_PRIOR: f64 = 0.6;
/// A thigh is drawn half as far as is best for bodies near the average: it costs these little, and leaves others what they are.
pub(super) const THIGH_PRIOR: f64 = 0.3;

/// Makes the bones of two limbs as long on the left as on the right, and the upper ones about as long as bones are: moves joints
/// along their bones, from the ends of the limbs inwards, since what lies farther out is surer. `average` is the length of the
/// upper bone of the average body.
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

/// The length of the bone of both sides: their mean by how sure each is.
fn mean([a, b]: [f64; 2], [weight_a, weight_b]: [f64; 2]) -> f64 {
    (a * weight_a + b * weight_b) / (weight_a + weight_b)
}

/// The point so far from `from` as `length`, in the direction of `towards`.
fn at(from: Point, towards: Point, length: f64) -> Point {
    let bone = (towards - from).try_normalize(0.0).unwrap_or_default();
    from + bone * length
}

/// The hips' axis and the legs' must agree at least so well, as the cosine of the angle between them, or it is not told.
const AGREEMENT_MIN: f64 = 0.3;

/// The same where one foot alone is seen: a leg that is turned out by 60 degrees does not tell.
const AGREEMENT_OF_ONE_MIN: f64 = 0.5;

/// Which of two legs is the left; nothing if the feet do not tell. `toes` are points in the front of the feet.
///
/// Toes point forwards. Hip, knee and ankle bend about axes that run from right to left, so whatever they do, shank
/// upwards x foot forwards stays along these axes and points to the left.
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
    // Two legs turned against each other cancel out, and the sum is short: not divided by its length for that.
    let sum: Point = feet.iter().sum();
    let agreement = (legs[0].root - legs[1].root).normalize().dot(&sum) / feet.len() as f64;
    (agreement.abs() >= least).then_some(usize::from(agreement < 0.0))
}

//! From landmarks to joints.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::bones::{self, Limbs};
use super::model::Model;
use super::sides::{self, Leg};
use super::{Landmarks, Touching, limb, settle, weights};

use crate::extremity::Ends;
use crate::geodesic::{Graph, Workspace};
use crate::{Estimate, Joint, Joints, Mesh, Side};

/// A landmark in the front of the foot, behind the toes.
const TOES: usize = 0;

/// How far joints may be off besides, in body scales, where a limb touches something.
struct InDoubt {
    shoulder: f64,
    elbow: f64,
    hip: f64,
    knee: f64,
    scale: f64,
}

/// About the root mean squares of the errors on the shapes that were learned from, with limbs touching.
const IN_DOUBT: InDoubt =
    InDoubt { shoulder: 0.15, elbow: 0.05, hip: 0.06, knee: 0.07, scale: 0.02 };

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

/// The joints of the body whose ends are known, in the frame and unit of `mesh`.
///
/// `ends` are of the same mesh and graph. Nothing is given if an end cannot be reached from another, or a limb has no
/// centre line.
#[must_use]
pub fn locate(mesh: &Mesh, graph: &Graph, ends: Ends, workspace: &mut Workspace) -> Option<Joints> {
    let settled = settle(graph, &ends.extremities, ends.fields, &ends.spread, workspace);
    Some(joints(&Landmarks::new(mesh, &settled.fields())?))
}

/// The joints among landmarks.
#[must_use]
pub fn joints(landmarks: &Landmarks) -> Joints {
    let limbs = bones::settle([0, 1].map(|side| limbs(landmarks, side)));
    let toes = [0, 1].map(|side| landmarks.halves[side].leg.get(TOES).copied().unwrap_or_default());
    let left = sides::left([0, 1].map(|side| Leg {
        hip: limbs[side].hip,
        knee: limbs[side].knee,
        ankle: limbs[side].ankle,
        toes: toes[side],
        has_foot: landmarks.missing[1][side] <= 0.0,
    }));
    let Touching { arms, legs, scale } = landmarks.touching;
    let mut found = Found {
        scale: landmarks.scale,
        doubt: if scale { IN_DOUBT.scale } else { 0.0 },
        estimates: BTreeMap::new(),
    };
    let of_top = if landmarks.head_is_in_doubt() { OFF_TOP } else { 0.0 };
    let head_sigma = weights::HEAD.sigma.hypot(of_top);
    found.add(Joint::Head, weights::HEAD.locate_midline(landmarks), head_sigma);
    found.add(Joint::Throat, weights::THROAT.locate_midline(landmarks), weights::THROAT.sigma);
    // The errors of two hips are about as much the same as they are each one's own.
    let hips = (limbs[0].hip + limbs[1].hip) / 2.0;
    let in_doubt = |touches: bool, by: f64| if touches { by } else { 0.0 };
    // Hips are told by arms too.
    let of_hips = in_doubt(arms.contains(&true) || legs.contains(&true), IN_DOUBT.hip);
    let missing = landmarks.missing;
    let stump = |part: f64, by: f64| if part > 0.0 { by } else { 0.0 };
    let of_stumps = missing[1].map(|part| stump(part, ROOT_OF_STUMP));
    let hip_sigma = weights::HIP.sigma.hypot(of_hips).hypot(of_stumps[0].max(of_stumps[1]));
    found.add(Joint::Pelvis, hips, hip_sigma);
    for (half, limb) in limbs.iter().enumerate() {
        let side = if half == left.unwrap_or(0) { Side::Left } else { Side::Right };
        let of_arm = |sigma: f64, by: f64| sigma.hypot(in_doubt(arms[half], by));
        let of_leg = |sigma: f64, by: f64| sigma.hypot(in_doubt(legs[half], by));
        let [arm, leg] = [missing[0][half], missing[1][half]];
        let [[wrist, elbow, _], [ankle, knee, _]] = landmarks.halves[half].marks;
        let is_there = |mark: f64, part: f64| part <= 0.0 || mark >= part + STUMP_LEAST;
        let shoulder = of_arm(weights::SHOULDER.sigma, IN_DOUBT.shoulder);
        let shoulder = shoulder.hypot(stump(arm, ROOT_OF_STUMP));
        found.add(Joint::Shoulder(side), limb.shoulder, shoulder);
        if is_there(elbow, arm) {
            let sigma = of_arm(limb.elbow_sigma, IN_DOUBT.elbow).hypot(stump(arm, OF_STUMP));
            found.add(Joint::Elbow(side), limb.elbow, sigma);
        }
        if is_there(wrist, arm) {
            let sigma = weights::WRIST.sigma.hypot(stump(arm, OF_STUMP));
            found.add(Joint::Wrist(side), limb.wrist, sigma);
        }
        found.add(Joint::Hip(side), limb.hip, hip_sigma);
        if is_there(knee, leg) {
            let sigma = of_leg(limb.knee_sigma, IN_DOUBT.knee).hypot(stump(leg, OF_STUMP));
            found.add(Joint::Knee(side), limb.knee, sigma);
        }
        if is_there(ankle, leg) {
            let sigma = weights::ANKLE.sigma.hypot(stump(leg, OF_STUMP));
            found.add(Joint::Ankle(side), limb.ankle, sigma);
        }
    }
    Joints { estimates: found.estimates, sides_told: left.is_some(), size_sigma: 0.0 }
}

fn limbs(landmarks: &Landmarks, side: usize) -> Limbs {
    let at = |model: &Model| model.locate(landmarks, side);
    let [elbow, knee] = landmarks.halves[side].sharpness;
    Limbs {
        shoulder: at(&weights::SHOULDER),
        elbow: at(&weights::ELBOW),
        wrist: at(&weights::WRIST),
        hip: at(&weights::HIP),
        knee: at(&weights::KNEE),
        ankle: at(&weights::ANKLE),
        elbow_sigma: limb::elbow_spread(elbow).hypot(weights::ELBOW.sigma),
        knee_sigma: limb::knee_spread(knee).hypot(weights::KNEE.sigma),
        arm_missing: landmarks.missing[0][side] > 0.0,
        leg_missing: landmarks.missing[1][side] > 0.0,
    }
}

struct Found {
    scale: f64,
    /// How far any joint may be off because the scale is.
    doubt: f64,
    estimates: BTreeMap<Joint, Estimate>,
}

impl Found {
    /// Takes a joint in body scales.
    fn add(&mut self, joint: Joint, at: Vector3<f64>, sigma: f64) {
        let position = (at * self.scale).into();
        self.estimates
            .insert(joint, Estimate { position, sigma: sigma.hypot(self.doubt) * self.scale });
    }
}

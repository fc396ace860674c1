//! From landmarks to joints.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::model::Model;
use super::sides::{self, Leg};
use super::{Landmarks, limb, settle, weights};
use crate::body::extremity::Extremities;
use crate::body::geodesic::{Graph, Workspace};
use crate::body::{Estimate, Joint, Joints, Mesh, Side};

/// A landmark in the front of the foot, behind the toes.
const TOES: usize = 0;

/// The joints of the body whose ends are known, in the frame and unit of `mesh`.
///
/// `distances_from_ends` are those from [`Extremities::all`] to each vertex, in the mesh's unit, along `graph`. Nothing
/// is given if an end cannot be reached from another, or a limb has no centre line.
#[must_use]
pub fn locate(
    mesh: &Mesh,
    graph: &Graph,
    extremities: &Extremities,
    distances_from_ends: [Vec<f64>; 5],
    workspace: &mut Workspace,
) -> Option<Joints> {
    let settled = settle(graph, extremities, distances_from_ends, workspace);
    Some(joints(&Landmarks::new(mesh, &settled.fields())?))
}

/// The joints among landmarks.
#[must_use]
pub fn joints(landmarks: &Landmarks) -> Joints {
    let at = |model: &Model, side: usize| model.locate(landmarks, side);
    let legs = [0, 1].map(|side| Leg {
        hip: at(&weights::HIP, side),
        knee: at(&weights::KNEE, side),
        ankle: at(&weights::ANKLE, side),
        toes: landmarks.halves[side].leg.get(TOES).copied().unwrap_or_default(),
    });
    let left = sides::left(legs);
    let mut found = Found { scale: landmarks.scale, estimates: BTreeMap::new() };
    let hips = (legs[0].hip + legs[1].hip) / 2.0;
    found.add(Joint::Head, weights::HEAD.locate_midline(landmarks), weights::HEAD.sigma);
    found.add(Joint::Throat, weights::THROAT.locate_midline(landmarks), weights::THROAT.sigma);
    // The errors of two hips are about as much the same as they are each one's own.
    found.add(Joint::Pelvis, hips, weights::HIP.sigma);
    for (half, leg) in legs.iter().enumerate() {
        let side = if half == left.unwrap_or(0) { Side::Left } else { Side::Right };
        let [elbow, knee] = landmarks.halves[half].sharpness;
        found.add(Joint::Shoulder(side), at(&weights::SHOULDER, half), weights::SHOULDER.sigma);
        found.add(Joint::Wrist(side), at(&weights::WRIST, half), weights::WRIST.sigma);
        found.add(Joint::Hip(side), leg.hip, weights::HIP.sigma);
        found.add(Joint::Ankle(side), leg.ankle, weights::ANKLE.sigma);
        let along = limb::elbow_spread(elbow).hypot(weights::ELBOW.sigma);
        found.add(Joint::Elbow(side), at(&weights::ELBOW, half), along);
        let along = limb::knee_spread(knee).hypot(weights::KNEE.sigma);
        found.add(Joint::Knee(side), leg.knee, along);
    }
    Joints { estimates: found.estimates, sides_told: left.is_some() }
}

struct Found {
    scale: f64,
    estimates: BTreeMap<Joint, Estimate>,
}

impl Found {
    /// Takes a joint in body scales.
    fn add(&mut self, joint: Joint, at: Vector3<f64>, sigma: f64) {
        let position = (at * self.scale).into();
        self.estimates.insert(joint, Estimate { position, sigma: sigma * self.scale });
    }
}

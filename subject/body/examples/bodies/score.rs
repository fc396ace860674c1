//! Whether extremities are named correctly, and the errors of joints.

use mocapd_body::extremity::Extremities;
use mocapd_body::{Joint, Joints, Mesh, Side};

use crate::read::Truth;

/// Largest distance of an extremity from the joint at its end, as a fraction of stature.
const NEAR_MAX: f64 = 0.12;
/// Largest distance if only a more proximal joint is known: the wrist is a hand's length away, the ankle a foot's,
/// the neck a head's.
const FARTHER_MAX: f64 = 0.16;
/// Largest distance from the neck if no joint above it is known.
const NECK_MAX: f64 = 0.25;

/// Known joints by kind of extremity: the joint at its end, and one farther up as a substitute.
const KINDS: [[&str; 2]; 3] = [["head_top", "head"], ["mcp3", "wrist"], ["toe", "ankle"]];

/// Strictness of the test for an extremity.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Limit {
    /// 12 % of stature for a joint at the end of its limb, 16 % for one farther up.
    ByJoint,
    /// 12 % of stature for every joint.
    Strict,
}

/// Whether every extremity is of its kind, and those of a pair are on two sides. None if nothing is known of the mesh.
pub(crate) fn right(mesh: &Mesh, truth: &Truth, ends: &Extremities, limit: Limit) -> Option<bool> {
    truth.joints.as_ref()?;
    let at = |vertex: u32| mesh.positions[vertex as usize];
    let near = |kind, side, vertex| near(truth, kind, side, at(vertex), limit);
    let pair = |kind: usize, [a, b]: [u32; 2]| {
        let sides = |one, other| near(kind, one, a) && near(kind, other, b);
        sides(".L", ".R") || sides(".R", ".L")
    };
    Some(near(0, "", ends.head) && pair(1, ends.hands) && pair(2, ends.feet))
}

fn near(truth: &Truth, kind: usize, side: &str, end: [f64; 3], limit: Limit) -> bool {
    let Some(joints) = &truth.joints else { return false };
    let within = |name: &str, most: f64| {
        let joint = joints.get(&format!("{name}{side}"));
        joint.is_some_and(|joint| distance(*joint, end) <= most * truth.stature_m)
    };
    let [last, farther] = KINDS[kind];
    let strict = limit == Limit::Strict;
    let only_neck = kind == 0 && joints.len() < 15;
    within(last, NEAR_MAX)
        || within(farther, if strict { NEAR_MAX } else { FARTHER_MAX })
        || (only_neck && within("neck", if strict { NEAR_MAX } else { NECK_MAX }))
}

/// The error of each joint in the mesh's unit, with its name; the sides of arms and of legs are assigned in the way
/// that fits better.
pub(crate) fn joint_errors(found: &Joints, truth: &Truth) -> Vec<(&'static str, f64)> {
    type Pair = (&'static str, fn(Side) -> Joint);
    let arm: [Pair; 3] =
        [("shoulder", Joint::Shoulder), ("elbow", Joint::Elbow), ("wrist", Joint::Wrist)];
    let leg: [Pair; 3] = [("hip", Joint::Hip), ("knee", Joint::Knee), ("ankle", Joint::Ankle)];
    let single = [("head_top", Joint::Head), ("neck", Joint::Throat), ("root", Joint::Pelvis)];
    let known = |name: &str| truth.joints.as_ref().and_then(|known| known.get(name));
    let pair = |(name, joint)| {
        let at = found.estimates.get(&joint)?.position;
        Some((name, distance(*known(name)?, at)))
    };
    let mut all: Vec<_> = single.into_iter().filter_map(pair).collect();
    for limb in [arm, leg] {
        let assignments = [["L", "R"], ["R", "L"]].map(|sides| {
            let mut errors = Vec::new();
            for (name, joint) in limb {
                for (side, letter) in [Side::Left, Side::Right].into_iter().zip(sides) {
                    let Some(estimate) = found.estimates.get(&joint(side)) else { continue };
                    let Some(at) = known(&format!("{name}.{letter}")) else { continue };
                    errors.push((name, distance(*at, estimate.position)));
                }
            }
            errors
        });
        let sum = |errors: &[(&str, f64)]| errors.iter().map(|(_, error)| error).sum::<f64>();
        let [one, other] = assignments;
        all.extend(if sum(&one) <= sum(&other) { one } else { other });
    }
    all
}

pub(crate) fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

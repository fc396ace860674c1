//! Equalisation of left and right bones.

use nalgebra::Vector3;

use crate::locate::joints::{Limb, THIGH_PRIOR, UPPER_ARM_PRIOR, equalise_bones};
use crate::locate::model::JOINTS;

/// A limb along y.
fn limb(x: f64, [root, hinge, end]: [f64; 3]) -> Limb {
    let at = |y: f64| Vector3::new(x, y, 0.0);
    Limb { root: at(root), hinge: at(hinge), end: at(end), hinge_sigma: 0.005, missing: 0.0 }
}

fn arm(x: f64, elbow: f64) -> Limb {
    limb(x, [0.8, elbow, elbow - 0.14])
}

fn leg(x: f64, hip: f64) -> Limb {
    limb(x, [hip, 0.27, 0.03])
}

fn equalised_arms(arms: [Limb; 2]) -> [Limb; 2] {
    equalise_bones(arms, UPPER_ARM_PRIOR, JOINTS.upper_arm)
}

fn equalised_legs(legs: [Limb; 2]) -> [Limb; 2] {
    equalise_bones(legs, THIGH_PRIOR, JOINTS.thigh)
}

fn lower(limb: Limb) -> f64 {
    (limb.hinge - limb.end).norm()
}

fn upper(limb: Limb) -> f64 {
    (limb.root - limb.hinge).norm()
}

#[test]
fn the_more_certain_elbow_determines_both_forearm_lengths() {
    let (mut sure, mut unsure) = (arm(-0.2, 0.65), arm(0.2, 0.65));
    sure.hinge.y += 0.02;
    unsure.hinge_sigma = 0.5;
    let [a, b] = equalised_arms([sure, unsure]).map(lower);
    assert!((a - b).abs() < 1e-12);
    assert!((a - 0.16).abs() < 1e-4, "{a}");
}

#[test]
fn upper_arm_lengths_move_towards_the_average() {
    let long = arm(-0.2, 0.6);
    let [equalised, _] = equalised_arms([long, arm(0.2, 0.6)]);
    let length = upper(equalised);
    assert!(length > JOINTS.upper_arm && length < 0.2, "{length}");
    assert_eq!((equalised.root.x, equalised.hinge), (long.root.x, long.hinge));
}

#[test]
fn coinciding_joints_stay_finite() {
    let limb = limb(0.0, [0.56; 3]);
    for equalise in [equalised_arms, equalised_legs] {
        let [equalised, _] = equalise([limb, limb]);
        assert!(equalised.root.iter().chain(equalised.hinge.iter()).all(|value| value.is_finite()));
    }
}

#[test]
fn the_more_certain_knee_determines_both_shank_lengths() {
    let (mut one, other) = (leg(-0.1, 0.5), leg(0.1, 0.5));
    one.hinge.y += 0.02;
    let both = equalised_legs([one, other]).map(lower);
    assert!((both[0] - 0.25).abs() < 1e-12 && (both[1] - 0.25).abs() < 1e-12, "{both:?}");
    let mut unsure = other;
    unsure.hinge_sigma = 0.5;
    let [surer, _] = equalised_legs([one, unsure]).map(lower);
    assert!((surer - 0.26).abs() < 1e-4, "{surer}");
}

#[test]
fn thigh_lengths_move_towards_the_average_by_less_than_half() {
    let long = leg(0.1, 0.6);
    let [equalised, _] = equalised_legs([long, long]);
    let (before, after) = (0.33 - JOINTS.thigh, upper(equalised) - JOINTS.thigh);
    assert!(after > 0.5 * before && after < 0.9 * before, "{before} {after}");
}

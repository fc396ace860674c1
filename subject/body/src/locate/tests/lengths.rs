//! Bones of two sides.

use nalgebra::Vector3;

use crate::locate::bones::{Limbs, settle};
use crate::locate::weights;

fn limbs(x: f64, elbow: f64) -> Limbs {
    let at = |y: f64| Vector3::new(x, y, 0.0);
    Limbs {
        shoulder: at(0.8),
        elbow: at(elbow),
        wrist: at(elbow - 0.14),
        hip: at(0.5),
        knee: at(0.27),
        ankle: at(0.03),
        elbow_sigma: 0.005,
        knee_sigma: 0.005,
        arm_missing: false,
        leg_missing: false,
    }
}

#[test]
fn the_surer_elbow_gives_the_length_of_both_forearms() {
    let (mut sure, mut unsure) = (limbs(-0.2, 0.65), limbs(0.2, 0.65));
    sure.elbow.y += 0.02;
    unsure.elbow_sigma = 0.5;
    let [a, b] = settle([sure, unsure]).map(|limb| (limb.elbow - limb.wrist).norm());
    assert!((a - b).abs() < 1e-12);
    assert!((a - 0.16).abs() < 1e-4, "{a}");
}

#[test]
fn an_upper_arm_is_drawn_towards_the_average_along_itself() {
    let long = limbs(-0.2, 0.6);
    let [settled, _] = settle([long, limbs(0.2, 0.6)]);
    let length = (settled.shoulder - settled.elbow).norm();
    assert!(length > weights::UPPER_ARM && length < 0.2, "{length}");
    assert_eq!((settled.shoulder.x, settled.elbow), (long.shoulder.x, long.elbow));
}

#[test]
fn joints_in_one_place_stay_finite() {
    let mut limb = limbs(0.0, 0.7);
    limb.elbow = limb.wrist;
    limb.shoulder = limb.wrist;
    let [settled, _] = settle([limb, limb]);
    assert!(settled.shoulder.iter().chain(settled.elbow.iter()).all(|value| value.is_finite()));
}

#[test]
fn shanks_are_as_long_as_the_surer_knee_says_and_no_nearer_to_the_average() {
    let (mut one, other) = (limbs(-0.1, 0.65), limbs(0.1, 0.65));
    one.knee.y += 0.02;
    let both = settle([one, other]).map(|limb| (limb.knee - limb.ankle).norm());
    assert!((both[0] - 0.25).abs() < 1e-12 && (both[1] - 0.25).abs() < 1e-12, "{both:?}");
    let mut unsure = other;
    unsure.knee_sigma = 0.5;
    let [surer, _] = settle([one, unsure]).map(|limb| (limb.knee - limb.ankle).norm());
    assert!((surer - 0.26).abs() < 1e-4, "{surer}");
}

#[test]
fn a_thigh_is_drawn_towards_the_average_by_less_than_half() {
    let mut long = limbs(0.1, 0.65);
    long.hip.y = 0.6;
    let [settled, _] = settle([long, long]);
    let (before, after) =
        (0.33 - weights::THIGH, (settled.hip - settled.knee).norm() - weights::THIGH);
    assert!(after > 0.5 * before && after < 0.9 * before, "{before} {after}");
}

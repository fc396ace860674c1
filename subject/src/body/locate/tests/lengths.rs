//! Bones of two sides.

use nalgebra::Vector3;

use crate::body::locate::bones::{Limbs, settle};
use crate::body::locate::weights;

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
fn a_knee_moves_to_where_it_parts_a_leg_of_any_length() {
    let part = weights::SHANK / (weights::SHANK + weights::THIGH);
    for scale in [0.8, 1.0, 1.3] {
        let mut limb = limbs(0.1, 0.65);
        limb.hip = Vector3::new(0.1, 0.03 + 0.47 * scale, 0.0);
        limb.knee = Vector3::new(0.1, 0.03 + 0.47 * scale * (part - 0.04), 0.0);
        let [settled, _] = settle([limb, limb]);
        let before = (limb.knee - limb.ankle).norm() / 0.47 / scale;
        let after = (settled.knee - settled.ankle).norm() / 0.47 / scale;
        assert!((before - part + 0.04).abs() < 1e-9 && (after - part).abs() < 0.021, "{after}");
    }
}

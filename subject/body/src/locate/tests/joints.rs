//! The scale of bodies with fused limbs, left and right, bones of equal length, and the learned constants.

use nalgebra::Vector3;

use crate::locate::{
    ARM_LANDMARKS, Fields, HEAD_LANDMARKS, LEG_LANDMARKS, Limb, THIGH_PRIOR, UPPER_ARM_PRIOR,
    equalise_bones, index_of_left,
    limb::{LEVELS, Sections, level},
    model::{JOINTS, JointModels, LandmarkGroup, Model},
    scan_faults::{BodyScale, Touching},
};

/// Distances between the five extremities of a body of scale 1; the vertices are the extremities.
const DISTANCES: [[f64; 5]; 5] = [
    [0.0, 0.68, 0.68, 1.13, 1.13],
    [0.68, 0.0, 0.95, 1.17, 1.25],
    [0.68, 0.95, 0.0, 1.25, 1.17],
    [1.13, 1.17, 1.25, 0.0, 1.09],
    [1.13, 1.25, 1.17, 1.09, 0.0],
];

fn scale(change: impl Fn(&mut [[f64; 5]; 5])) -> Option<BodyScale> {
    let mut distances = DISTANCES;
    change(&mut distances);
    BodyScale::new(&Fields {
        first_head: None,
        missing: [0.0; 5],
        ends: [0, 1, 2, 3, 4],
        distances: distances.each_ref().map(<[f64; 5]>::as_slice),
    })
}

fn sections(perimeter: impl Fn(f64) -> f64) -> Sections {
    Sections {
        perimeter: (0..LEVELS).map(|index| perimeter(level(index))).collect(),
        centre: vec![Vector3::zeros(); LEVELS],
    }
}

#[test]
fn limbs_of_a_free_body_are_certain() {
    let scale = scale(|_| ()).unwrap();
    assert!((scale.length - 1.0).abs() < 0.03, "{scale:?}");
    let (arm, leg) = (sections(|at| 0.1 + 0.2 * at), sections(|at| 0.1 + 0.5 * at));
    let touching = Touching::new(scale, [Some(&arm), Some(&arm)], [Some(&leg), Some(&leg)]);
    assert!(!touching.any(), "{touching:?}");
}

#[test]
fn only_the_arm_whose_curves_enclose_the_trunk_is_uncertain() {
    let (free, leg) = (sections(|at| 0.1 + 0.2 * at), sections(|at| 0.1 + 0.5 * at));
    let grown = sections(|at| if at < 0.25 { 0.12 } else { 0.8 });
    let touching = Touching::new(
        scale(|_| ()).unwrap(),
        [Some(&free), Some(&grown)],
        [Some(&leg), Some(&leg)],
    );
    assert_eq!((touching.arms, touching.legs, touching.scale), ([false, true], [false; 2], false));
}

#[test]
fn with_hands_on_the_hips_the_feet_determine_the_scale() {
    let change = |distances: &mut [[f64; 5]; 5]| {
        for (one, other) in [(1, 2), (1, 3), (1, 4), (2, 3), (2, 4)] {
            distances[one][other] *= 0.55;
            distances[other][one] = distances[one][other];
        }
    };
    let found = scale(change).unwrap();
    assert!(found.disagrees() && (found.length - 1.0).abs() < 1e-9, "{found:?}");
}

#[test]
fn touching_legs_are_uncertain_and_do_not_determine_the_scale() {
    let change = |distances: &mut [[f64; 5]; 5]| {
        distances[3][4] *= 0.8;
        distances[4][3] = distances[3][4];
    };
    let found = scale(change).unwrap();
    let limb = sections(|_| 0.2);
    let touching = Touching::new(found, [Some(&limb), Some(&limb)], [Some(&limb), Some(&limb)]);
    assert!(touching.scale && touching.legs == [true; 2], "{found:?} {touching:?}");
    assert!((found.length - 1.0).abs() < 0.04, "{found:?}");
}

#[test]
fn contradicting_distances_have_no_scale() {
    let none = scale(|distances| {
        distances[3][4] *= 0.2;
        distances[4][3] = distances[3][4];
    });
    assert_eq!(none, None);
    assert_eq!(scale(|distances| distances[2][1] = 0.0), None);
    assert_eq!(scale(|distances| distances[4][3] = f64::INFINITY), None);
}

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

/// A leg of a person who faces along y, head along z: the left is at negative x.
fn bent_leg(x: f64, flexion: f64) -> Limb {
    let hip = Vector3::new(x, 0.0, 0.9);
    let knee = hip + Vector3::new(0.0, 0.4 * flexion.sin(), -0.4 * flexion.cos());
    // The shank points straight down, the foot forwards.
    let ankle = knee - Vector3::z() * 0.4;
    Limb { root: hip, hinge: knee, end: ankle, hinge_sigma: 0.005, missing: 0.0 }
}

fn toes(leg: &Limb) -> Vector3<f64> {
    leg.end + Vector3::new(0.02 * leg.root.x, 0.2, -0.05)
}

fn left_by_toes(legs: [Limb; 2]) -> Option<usize> {
    index_of_left(legs, legs.each_ref().map(toes))
}

#[test]
fn the_feet_determine_left_and_right_however_the_legs_bend() {
    for flexion in [0.0, 0.8, 1.6, 2.2] {
        assert_eq!(
            left_by_toes([bent_leg(-0.1, 0.0), bent_leg(0.1, flexion)]),
            Some(0),
            "{flexion}"
        );
        assert_eq!(
            left_by_toes([bent_leg(0.1, flexion), bent_leg(-0.1, 0.0)]),
            Some(1),
            "{flexion}"
        );
    }
}

#[test]
fn contradicting_feet_leave_the_sides_undetermined() {
    let legs = [bent_leg(-0.1, 0.0), bent_leg(0.1, 0.0)];
    let [forwards, other] = legs.each_ref().map(toes);
    let toes = [forwards, legs[1].end - (other - legs[1].end)];
    assert_eq!(index_of_left(legs, toes), None);
    // Toes at the ankle are not a foot.
    assert_eq!(index_of_left(legs, legs.map(|leg| leg.end)), None);
    // One foot is sufficient; none is not.
    let stump = |leg| Limb { missing: 0.1, ..leg };
    assert_eq!(index_of_left([legs[0], stump(legs[1])], toes), Some(0));
    assert_eq!(index_of_left(legs.map(stump), toes), None);
}

#[test]
fn weights_of_every_joint_add_up_to_one() {
    let JointModels { head, throat, shoulder, elbow, wrist, hip, knee, ankle, .. } = &*JOINTS;
    for Model { spans, sigma } in [head, throat, shoulder, elbow, wrist, hip, knee, ankle] {
        let sum: f64 = spans.iter().flat_map(|span| &span.weights).sum();
        assert!((sum - 1.0).abs() < 1e-9, "{sum}");
        assert!((0.001..0.05).contains(sigma));
        for span in spans {
            let most = match span.part {
                LandmarkGroup::Arm | LandmarkGroup::OtherArm => ARM_LANDMARKS,
                LandmarkGroup::Leg | LandmarkGroup::OtherLeg => LEG_LANDMARKS,
                LandmarkGroup::Head => HEAD_LANDMARKS,
            };
            assert!(span.first + span.weights.len() <= most);
        }
    }
}

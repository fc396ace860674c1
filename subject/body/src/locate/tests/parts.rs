//! Left and right, and the learned constants.

use nalgebra::Vector3;

use crate::locate::joints::{Limb, left};
use crate::locate::model::{JOINTS, JointModels, LandmarkGroup, Model};
use crate::locate::{ARM_LANDMARKS, HEAD_LANDMARKS, LEG_LANDMARKS};

/// A leg of a person who faces along y, head along z: the left is at negative x.
fn leg(x: f64, flexion: f64) -> Limb {
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
    left(legs, legs.each_ref().map(toes))
}

#[test]
fn the_feet_determine_left_and_right_however_the_legs_bend() {
    for flexion in [0.0, 0.8, 1.6, 2.2] {
        assert_eq!(left_by_toes([leg(-0.1, 0.0), leg(0.1, flexion)]), Some(0), "{flexion}");
        assert_eq!(left_by_toes([leg(0.1, flexion), leg(-0.1, 0.0)]), Some(1), "{flexion}");
    }
}

#[test]
fn contradicting_feet_leave_the_sides_undetermined() {
    let legs = [leg(-0.1, 0.0), leg(0.1, 0.0)];
    let [forwards, other] = legs.each_ref().map(toes);
    let toes = [forwards, legs[1].end - (other - legs[1].end)];
    assert_eq!(left(legs, toes), None);
    // Toes at the ankle are not a foot.
    assert_eq!(left(legs, legs.map(|leg| leg.end)), None);
    // One foot is sufficient; none is not.
    let stump = |leg| Limb { missing: 0.1, ..leg };
    assert_eq!(left([legs[0], stump(legs[1])], toes), Some(0));
    assert_eq!(left(legs.map(stump), toes), None);
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

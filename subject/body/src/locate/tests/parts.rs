//! Sides, and the learned constants.

use nalgebra::Vector3;

use crate::locate::model::{Model, Part};
use crate::locate::sides::{Leg, left};
use crate::locate::{ARM_LANDMARKS, HEAD_LANDMARKS, LEG_LANDMARKS, weights};

/// A leg of somebody who looks along y, head along z: so the left is at negative x.
fn leg(x: f64, flexion: f64) -> Leg {
    let hip = Vector3::new(x, 0.0, 0.9);
    let knee = hip + Vector3::new(0.0, 0.4 * flexion.sin(), -0.4 * flexion.cos());
    // The shank hangs straight down, the foot points forwards.
    let ankle = knee - Vector3::z() * 0.4;
    Leg { hip, knee, ankle, toes: ankle + Vector3::new(0.02 * x, 0.2, -0.05), has_foot: true }
}

#[test]
fn the_left_is_told_by_the_feet_however_the_legs_bend() {
    for flexion in [0.0, 0.8, 1.6, 2.2] {
        assert_eq!(left([leg(-0.1, 0.0), leg(0.1, flexion)]), Some(0), "{flexion}");
        assert_eq!(left([leg(0.1, flexion), leg(-0.1, 0.0)]), Some(1), "{flexion}");
    }
}

#[test]
fn feet_that_contradict_each_other_tell_nothing() {
    let forwards = leg(-0.1, 0.0);
    let mut backwards = leg(0.1, 0.0);
    backwards.toes = backwards.ankle - (backwards.toes - backwards.ankle);
    assert_eq!(left([forwards, backwards]), None);
    let mut no_foot = [forwards, leg(0.1, 0.0)];
    no_foot.iter_mut().for_each(|leg| leg.toes = leg.ankle);
    assert_eq!(left(no_foot), None);
    // One foot alone tells; none does not.
    let mut stump = backwards;
    stump.has_foot = false;
    assert_eq!(left([forwards, stump]), Some(0));
    assert_eq!(left([Leg { has_foot: false, ..forwards }, stump]), None);
}

#[test]
fn weights_of_every_joint_are_of_landmarks_and_add_up_to_one() {
    use weights::{ANKLE, ELBOW, HEAD, HIP, KNEE, SHOULDER, THROAT, WRIST};
    for Model { spans, sigma } in [HEAD, THROAT, SHOULDER, ELBOW, WRIST, HIP, KNEE, ANKLE] {
        let sum: f64 = spans.iter().flat_map(|span| span.weights).sum();
        assert!((sum - 1.0).abs() < 1e-9, "{sum}");
        assert!((0.001..0.05).contains(&sigma));
        for span in spans {
            let most = match span.part {
                Part::Arm | Part::OtherArm => ARM_LANDMARKS,
                Part::Leg | Part::OtherLeg => LEG_LANDMARKS,
                Part::Head => HEAD_LANDMARKS,
            };
            assert!(span.first + span.weights.len() <= most);
        }
    }
}

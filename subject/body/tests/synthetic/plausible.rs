//! Anatomical plausibility of joints.

use mocapd_body::{Joint, Joints, Plausibility, Side};
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};

/// Moves some joints towards another one, by a share of the distance.
fn moved(joints: &Joints, which: fn(Side) -> Joint, to: Joint, part: f64) -> Joints {
    let mut moved = joints.clone();
    let end = joints.estimates[&to].position;
    for side in [Side::Left, Side::Right] {
        let at = &mut moved.estimates.get_mut(&which(side)).unwrap().position;
        *at = [0, 1, 2].map(|axis| at[axis] + part * (end[axis] - at[axis]));
    }
    moved
}

#[test]
fn joints_of_bodies_are_plausible_and_displaced_ones_are_not() {
    for (seed, pose) in (1..).zip(Pose::ALL) {
        let (_, joints) = body(seed, pose, BodyOptions { n_faces: 500, turned: true });
        assert_eq!(Plausibility::of(&joints), Plausibility::Whole, "{pose:?}");
        let in_the_belly = moved(&joints, Joint::Shoulder, Joint::Pelvis, 0.8);
        assert_eq!(Plausibility::of(&in_the_belly), Plausibility::WithoutArms, "{pose:?}");
        let legs = moved(&joints, Joint::Hip, Joint::Ankle(Side::Left), 0.9);
        let legs = moved(&legs, Joint::Knee, Joint::Ankle(Side::Left), 0.9);
        assert_eq!(Plausibility::of(&legs), Plausibility::Nothing, "{pose:?}");
    }
    assert_eq!(Plausibility::of(&Joints::default()), Plausibility::Whole);
}

//! Whether joints lie as a body can have them.
//!
//! Where limbs have grown together, distances lead across, and what is built upon them is no body's: shoulders in the
//! belly, a trunk twice as long as the legs. What is measured here are parts of the length of a leg, which hardly differ
//! from person to person: far from what they are, something is wrong with the scan, and not with the subject.

use std::ops::RangeInclusive;

use super::geometry::distance;
use super::{Joint, Joints, Side};

/// Thigh and shank are one. From throat to pelvis: 0.54 to 0.76 on bodies whose limbs are free, more on a child.
const TRUNK: RangeInclusive<f64> = 0.4..=1.2;
/// From throat to shoulder: 0.19 to 0.30, and up to 0.385 on generated bodies of capsules.
const SHOULDER: RangeInclusive<f64> = 0.14..=0.40;
/// Upper arm and forearm: 0.57 to 0.63, 0.68 by the table of Drillis and Contini 1966, and from 0.48 on generated bodies.
const ARM: RangeInclusive<f64> = 0.475..=0.85;

/// What of a body's joints can be believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Plausible {
    /// All of them.
    Whole,
    /// All but shoulders and elbows: the arms are not where they were looked for.
    WithoutArms,
    /// None: lengths of trunk and legs do not go together.
    Nothing,
}

impl Plausible {
    /// Of joints in any unit; those that are missing are not doubted.
    pub(super) fn of(joints: &Joints) -> Self {
        let Some(leg) = limb(joints, [Joint::Hip, Joint::Knee, Joint::Ankle]) else {
            return Self::Whole;
        };
        let fits = |length: Option<f64>, parts: RangeInclusive<f64>| {
            length.is_none_or(|length| parts.contains(&(length / leg)))
        };
        let shoulder =
            |side: Side| fits(way(joints, Joint::Throat, Joint::Shoulder(side)), SHOULDER);
        if !fits(way(joints, Joint::Throat, Joint::Pelvis), TRUNK) {
            return Self::Nothing;
        }
        let arm = limb(joints, [Joint::Shoulder, Joint::Elbow, Joint::Wrist]);
        let arms = fits(arm, ARM) && shoulder(Side::Left) && shoulder(Side::Right);
        if arms { Self::Whole } else { Self::WithoutArms }
    }
}

/// The length of a limb of three joints: the mean of both sides, or that of the one that has all three.
fn limb(joints: &Joints, [root, middle, end]: [fn(Side) -> Joint; 3]) -> Option<f64> {
    let of = |side: Side| {
        Some(way(joints, root(side), middle(side))? + way(joints, middle(side), end(side))?)
    };
    match (of(Side::Left), of(Side::Right)) {
        (Some(left), Some(right)) => Some(f64::midpoint(left, right)),
        (one, other) => one.or(other),
    }
}

fn way(joints: &Joints, from: Joint, to: Joint) -> Option<f64> {
    let at = |joint: Joint| joints.estimates.get(&joint).map(|estimate| estimate.position);
    Some(distance(at(from)?, at(to)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{Options, Pose, body};

    /// With some joints moved towards another, by a part of the way.
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
    fn joints_of_bodies_are_believed_and_others_are_not() {
        for (seed, pose) in (1..).zip(Pose::ALL) {
            let (_, joints) = body(seed, pose, Options { n_faces: 500, turned: true });
            assert_eq!(Plausible::of(&joints), Plausible::Whole, "{pose:?}");
            let in_the_belly = moved(&joints, Joint::Shoulder, Joint::Pelvis, 0.8);
            assert_eq!(Plausible::of(&in_the_belly), Plausible::WithoutArms, "{pose:?}");
            let legs = moved(&joints, Joint::Hip, Joint::Ankle(Side::Left), 0.9);
            let legs = moved(&legs, Joint::Knee, Joint::Ankle(Side::Left), 0.9);
            assert_eq!(Plausible::of(&legs), Plausible::Nothing, "{pose:?}");
        }
        assert_eq!(Plausible::of(&Joints::default()), Plausible::Whole);
    }
}

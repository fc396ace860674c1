//! Names of joints and bones.

use crate::{Joint, Side};
use Joint::{Ankle, Elbow, Head, Hip, Knee, Pelvis, Shoulder, Throat, Wrist};
use Side::{Left, Right};

/// Every joint with its name, in the order in which they are written.
const JOINTS: [(Joint, &str); 15] = [
    (Head, "head"),
    (Throat, "throat"),
    (Pelvis, "pelvis"),
    (Shoulder(Left), "l_shoulder"),
    (Elbow(Left), "l_elbow"),
    (Wrist(Left), "l_wrist"),
    (Hip(Left), "l_hip"),
    (Knee(Left), "l_knee"),
    (Ankle(Left), "l_ankle"),
    (Shoulder(Right), "r_shoulder"),
    (Elbow(Right), "r_elbow"),
    (Wrist(Right), "r_wrist"),
    (Hip(Right), "r_hip"),
    (Knee(Right), "r_knee"),
    (Ankle(Right), "r_ankle"),
];

/// Name, parent and child of every bone: a tree whose root is the pelvis.
pub const BONES: [(&str, Joint, Joint); 14] = [
    ("throat_pelvis", Pelvis, Throat),
    ("head_throat", Throat, Head),
    ("throat_l_shoulder", Throat, Shoulder(Left)),
    ("l_upper_arm", Shoulder(Left), Elbow(Left)),
    ("l_forearm", Elbow(Left), Wrist(Left)),
    ("pelvis_l_hip", Pelvis, Hip(Left)),
    ("l_thigh", Hip(Left), Knee(Left)),
    ("l_shank", Knee(Left), Ankle(Left)),
    ("throat_r_shoulder", Throat, Shoulder(Right)),
    ("r_upper_arm", Shoulder(Right), Elbow(Right)),
    ("r_forearm", Elbow(Right), Wrist(Right)),
    ("pelvis_r_hip", Pelvis, Hip(Right)),
    ("r_thigh", Hip(Right), Knee(Right)),
    ("r_shank", Knee(Right), Ankle(Right)),
];

/// The name of a joint: `head`, `l_shoulder`.
#[must_use]
pub fn joint_name(joint: Joint) -> &'static str {
    JOINTS.iter().find(|(other, _)| *other == joint).map_or("", |(_, name)| name)
}

/// The joint of a name.
#[must_use]
pub fn joint_from_name(name: &str) -> Option<Joint> {
    JOINTS.iter().find(|(_, other)| *other == name).map(|(joint, _)| *joint)
}

/// Side and pair of a bone: `l` and `thigh`, of `l_thigh`.
pub(super) fn pair(name: &str) -> Option<(char, &str)> {
    [('l', "l_"), ('r', "r_")]
        .into_iter()
        .find_map(|(side, prefix)| Some((side, name.strip_prefix(prefix)?)))
}

/// All joints, in the order in which they are written.
pub(super) fn joints() -> impl Iterator<Item = Joint> {
    JOINTS.iter().map(|(joint, _)| *joint)
}

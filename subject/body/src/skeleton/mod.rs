//! The skeleton of a subject: joints and bones with their uncertainties, from one scan or several, as JSON that a take
//! can carry.

mod combine;
mod functional;
mod json;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

pub use self::json::{LEN_MAX, SkeletonError};
use super::{Joint, Joints, Repaired, Side, Unit};
use Joint::{Ankle, Elbow, Head, Hip, Knee, Pelvis, Shoulder, Throat, Wrist};
use Side::{Left, Right};

/// Joints and their names, in the order of documents.
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

/// A bone and the joints that it connects.
#[derive(Debug, Clone, Copy)]
pub struct BoneEnds {
    /// Name of the bone.
    pub name: &'static str,
    /// The joint nearer to the pelvis.
    pub parent: Joint,
    /// The other joint.
    pub child: Joint,
}

const fn bone(name: &'static str, parent: Joint, child: Joint) -> BoneEnds {
    BoneEnds { name, parent, child }
}

/// All bones: a tree with its root at the pelvis.
pub const BONES: [BoneEnds; 14] = [
    bone("throat_pelvis", Pelvis, Throat),
    bone("head_throat", Throat, Head),
    bone("throat_l_shoulder", Throat, Shoulder(Left)),
    bone("l_upper_arm", Shoulder(Left), Elbow(Left)),
    bone("l_forearm", Elbow(Left), Wrist(Left)),
    bone("pelvis_l_hip", Pelvis, Hip(Left)),
    bone("l_thigh", Hip(Left), Knee(Left)),
    bone("l_shank", Knee(Left), Ankle(Left)),
    bone("throat_r_shoulder", Throat, Shoulder(Right)),
    bone("r_upper_arm", Shoulder(Right), Elbow(Right)),
    bone("r_forearm", Elbow(Right), Wrist(Right)),
    bone("pelvis_r_hip", Pelvis, Hip(Right)),
    bone("r_thigh", Hip(Right), Knee(Right)),
    bone("r_shank", Knee(Right), Ankle(Right)),
];

/// The name of a joint: `head`, `l_shoulder`.
#[must_use]
pub fn joint_name(joint: Joint) -> &'static str {
    JOINTS.iter().find(|(other, _)| *other == joint).map_or("", |(_, name)| name)
}

/// The corresponding bone of the other side. Left and right bones are stored in the same order.
fn counterpart(name: &str) -> Option<&'static str> {
    let at = BONES.iter().position(|bone| bone.name == name)?.checked_sub(2)?;
    Some(BONES[2 + (at + 6) % 12].name)
}

/// All joints, in the order of documents.
fn joints() -> impl Iterator<Item = Joint> {
    JOINTS.iter().map(|(joint, _)| *joint)
}

/// The method that found the joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// This crate's method.
    Default,
    /// The method of Yu et al. 2008 as printed.
    Paper,
}

impl Method {
    /// Its name in documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Paper => "paper",
        }
    }
}

/// A scan file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Source {
    /// File name without its folder.
    pub name: String,
    /// SHA-256 of its bytes, in hexadecimal.
    pub sha256: String,
    /// `m`, `cm`, `mm` or `in`; may be missing in a document.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Whether the unit was inferred from the size; may be missing in a document.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit_inferred: Option<bool>,
}

impl Source {
    /// Describes a file by its name, its bytes and its repaired mesh.
    #[must_use]
    pub fn new(name: &str, bytes: &[u8], repaired: &Repaired) -> Self {
        let sha256 = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        let name = name.rsplit(['/', '\\']).next().unwrap_or(name);
        let name = name.chars().filter(|c| !c.is_control()).take(combine::TEXT_MAX).collect();
        let unit = Some(repaired.unit.to_string());
        Self { name, sha256, unit, unit_inferred: Some(repaired.unit_inferred) }
    }
}

/// A joint, in the frame of the first source.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SkeletonJoint {
    /// One of the 15 sites ([`joint_name`]), or another program's name.
    pub name: String,
    /// x, y, z in millimetres; none in a skeleton measured by hand.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_mm: Option<[f64; 3]>,
    /// Standard deviation of the distance to the true centre, in millimetres, if known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uncertainty_mm: Option<f64>,
}

/// A segment between two joints, whose length does not depend on the pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bone {
    /// One of [`BONES`], or another program's name.
    pub name: String,
    /// The joint nearer to the pelvis.
    pub parent: String,
    /// The other joint.
    pub child: String,
    /// Length over all scans, in millimetres.
    pub length_mm: f64,
    /// Expected standard deviation of the length, in millimetres, if known.
    pub uncertainty_mm: Option<f64>,
    /// Standard deviation between scans, in millimetres; null for one scan.
    pub spread_mm: Option<f64>,
    /// Number of scans; 0 if unknown.
    #[serde(default)]
    pub scans: u64,
}

impl Bone {
    fn length(&self) -> Length {
        Length { mm: self.length_mm, sigma_mm: self.uncertainty_mm.unwrap_or_default() }
    }
}

/// A subject's skeleton. Serialised as in `docs/subject-body-format.md`: the fields in order, after `format` and
/// `version`. What a document may omit has a default or is an `Option`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Skeleton {
    /// The method: [`Method::name`], or another program's; empty if unknown.
    #[serde(default)]
    pub method: String,
    /// The scans. The first gives the frame of the joints; a skeleton measured by hand has none.
    #[serde(default)]
    pub sources: Vec<Source>,
    /// Stature in millimetres, computed from the bones in any pose. None if a bone is missing, and for
    /// [`Method::Paper`], whose bones do not allow it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stature_mm: Option<f64>,
    /// Expected standard deviation of the stature, in millimetres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stature_uncertainty_mm: Option<f64>,
    /// Whether `l_` is the subject's left. If false, the sides may be exchanged as a whole.
    #[serde(default)]
    pub sides_told: bool,
    /// The joints that were found.
    pub joints: Vec<SkeletonJoint>,
    /// The bones between joints that were found.
    pub bones: Vec<Bone>,
    /// Remarks for readers.
    #[serde(default)]
    pub notes: Vec<String>,
}

/// A length with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    /// Length in millimetres.
    pub mm: f64,
    /// Expected standard deviation in millimetres.
    pub sigma_mm: f64,
}

/// The joints of one scan.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanJoints {
    /// The scan file.
    pub source: Source,
    /// The joints, in the mesh's frame and unit.
    pub joints: Joints,
    /// The unit of `joints`.
    pub unit: Unit,
    /// Remarks for people.
    pub notes: Vec<String>,
}

impl Skeleton {
    /// Combines one or several scans of one person, in any poses; none without scans.
    ///
    /// Lengths are means over the scans, weighted by the uncertainty of the joints. If the poses of several scans
    /// differ enough, shoulders and hips become the centres of rotation of elbows and knees (`functional`).
    #[must_use]
    pub fn new(method: Method, scans: &[ScanJoints]) -> Option<Self> {
        combine::combine(method, scans)
    }
}

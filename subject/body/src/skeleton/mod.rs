//! What remains of scans: joints, bones, how sure each is, and what they are from, as JSON that a take can carry.

mod combine;
mod functional;
mod json;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

pub use self::json::{LEN_MAX, SkeletonError};
use super::{Joint, Joints, Repaired, Side, Unit};
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

/// The joints that a bone joins.
#[derive(Debug, Clone, Copy)]
pub struct BoneEnds {
    /// The bone.
    pub name: &'static str,
    /// The joint nearer to the pelvis.
    pub parent: Joint,
    /// The other joint.
    pub child: Joint,
}

const fn bone(name: &'static str, parent: Joint, child: Joint) -> BoneEnds {
    BoneEnds { name, parent, child }
}

/// Every bone: a tree whose root is the pelvis.
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

/// The joint of a name.
#[must_use]
pub fn joint_from_name(name: &str) -> Option<Joint> {
    JOINTS.iter().find(|(_, other)| *other == name).map(|(joint, _)| *joint)
}

/// The same bone of the other side: those of the left stand in the order of those of the right.
fn twin(name: &str) -> Option<&'static str> {
    let at = BONES.iter().position(|bone| bone.name == name)?.checked_sub(2)?;
    Some(BONES[2 + (at + 6) % 12].name)
}

/// Side and pair of a bone: `l` and `thigh`, of `l_thigh`.
fn pair(name: &str) -> Option<(char, &str)> {
    [('l', "l_"), ('r', "r_")]
        .into_iter()
        .find_map(|(side, prefix)| Some((side, name.strip_prefix(prefix)?)))
}

/// All joints, in the order in which they are written.
fn joints() -> impl Iterator<Item = Joint> {
    JOINTS.iter().map(|(joint, _)| *joint)
}

/// How the joints were found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// As this crate does.
    Default,
    /// As Yu et al. 2008 print it.
    Paper,
}

impl Method {
    /// As documents have it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Paper => "paper",
        }
    }
}

/// The file that a scan came from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Source {
    /// The file's name, without its folder.
    pub name: String,
    /// SHA-256 of its bytes, in hexadecimal.
    pub sha256: String,
    /// `m`, `cm`, `mm` or `in`; a document may leave it out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Whether the unit was inferred from the size; a document may leave it out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit_inferred: Option<bool>,
}

impl Source {
    /// Of a file's name and bytes, and what became of its mesh.
    #[must_use]
    pub fn new(name: &str, bytes: &[u8], repaired: &Repaired) -> Self {
        let sha256 = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        let name = name.rsplit(['/', '\\']).next().unwrap_or(name);
        let name = name.chars().filter(|c| !c.is_control()).take(combine::TEXT_MAX).collect();
        let unit = Some(repaired.unit.to_string());
        Self { name, sha256, unit, unit_inferred: Some(repaired.unit_inferred) }
    }
}

/// One joint, in the frame of the first source, turned as it was.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SkeletonJoint {
    /// One of the 15 sites ([`joint_name`]), or what others call theirs.
    pub name: String,
    /// x, y, z in millimetres; a skeleton that was measured by hand has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_mm: Option<[f64; 3]>,
    /// Standard deviation of the distance to the true centre, in millimetres, where it is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uncertainty_mm: Option<f64>,
}

/// A length that does not change with the pose, from one joint to the next.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bone {
    /// One of [`BONES`], or what others call theirs.
    pub name: String,
    /// The joint nearer to the pelvis.
    pub parent: String,
    /// The other joint.
    pub child: String,
    /// Over all scans, in millimetres.
    pub length_mm: f64,
    /// Standard deviation that is expected of it, in millimetres, where it is known.
    pub uncertainty_mm: Option<f64>,
    /// Standard deviation between scans, in millimetres; null for one scan.
    pub spread_mm: Option<f64>,
    /// How many scans it is from; 0 where nobody said.
    #[serde(default)]
    pub scans: u64,
}

impl Bone {
    fn length(&self) -> Length {
        Length { mm: self.length_mm, sigma_mm: self.uncertainty_mm.unwrap_or_default() }
    }
}

/// A subject's skeleton, as `docs/subject-body-format.md` has it: the keys are the fields, in their order, with `format`
/// and `version` before them. What a document may leave out has a default, or is an `Option`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Skeleton {
    /// How the joints were found: [`Method::name`], or what others say; empty where nobody said.
    #[serde(default)]
    pub method: String,
    /// The scans, the first of which gives the frame of the joints; none of a skeleton that was measured by hand.
    #[serde(default)]
    pub sources: Vec<Source>,
    /// How tall the subject stands, in millimetres, out of the bones: whatever the pose. None where one is missing, and
    /// of [`Method::Paper`], whose bones do not tell.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stature_mm: Option<f64>,
    /// Standard deviation that is expected of it, in millimetres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stature_uncertainty_mm: Option<f64>,
    /// Whether `l_` is the subject's left. If not, the sides may be the wrong way round as a whole.
    #[serde(default)]
    pub sides_told: bool,
    /// Those that were found.
    pub joints: Vec<SkeletonJoint>,
    /// Those between joints that were found.
    pub bones: Vec<Bone>,
    /// What a reader should know.
    #[serde(default)]
    pub notes: Vec<String>,
}

/// A length, in millimetres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    /// The length.
    pub mm: f64,
    /// Standard deviation that is expected of it.
    pub sigma_mm: f64,
}

/// What one scan gives.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanJoints {
    /// Where from.
    pub source: Source,
    /// The joints, in the mesh's frame and unit.
    pub joints: Joints,
    /// That unit.
    pub unit: Unit,
    /// Sentences for people.
    pub notes: Vec<String>,
}

impl Skeleton {
    /// The skeleton of one person out of one scan or several, in any poses; nothing of none.
    ///
    /// Lengths are means over the scans, each weighted with what is expected of its joints. Where the poses of several
    /// scans differ enough, shoulders and hips are the centres that elbows and knees turned about (`functional`).
    #[must_use]
    pub fn new(method: Method, scans: &[ScanJoints]) -> Option<Self> {
        combine::combine(method, scans)
    }

    /// Length of a pair of bones, such as `upper_arm`: the mean of both sides.
    ///
    /// Limbs differ by a per cent between sides, scans by more.
    #[must_use]
    pub fn symmetric_length(&self, pair: &str) -> Option<Length> {
        let side = |side: char| {
            self.bones.iter().find(|bone| self::pair(&bone.name) == Some((side, pair)))
        };
        match (side('l').map(Bone::length), side('r').map(Bone::length)) {
            (Some(left), Some(right)) => Some(Length {
                mm: (left.mm + right.mm) / 2.0,
                sigma_mm: left.sigma_mm.hypot(right.sigma_mm) / 2.0,
            }),
            (one, other) => one.or(other),
        }
    }
}

//! The skeleton of a subject: joints and bones with their uncertainties, from one scan or several, as JSON documents
//! that a take can carry.

mod combine;

use std::ops::RangeInclusive;

use Joint::{Ankle, Elbow, Head, Hip, Knee, Pelvis, Shoulder, Throat, Wrist};
use Side::{Left, Right};
use serde::{Deserialize, Serialize};
use serde_json::error::Category;
use sha2::{Digest, Sha256};

use super::{Joint, Joints, Repaired, Side, Unit};

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

const FORMAT: &str = "mocapd-skeleton";
const VERSION: u64 = 1;
/// Largest document: the most that a take holds.
pub const LEN_MAX: usize = 1 << 20;
/// Maximum number of joints, and of bones.
const PARTS_MAX: usize = 256;
/// Maximum number of characters of a document that an error quotes.
const QUOTED_MAX: usize = 200;
/// Largest coordinate, in millimetres.
const POSITION_MAX_MM: f64 = 1e9;
/// Statures and standard deviations, in millimetres, a doubtful unit included.
const SIZES_MM: RangeInclusive<f64> = 0.0..=10_000.0;
/// Bone lengths, in millimetres; [`round`] would leave nothing of a shorter one.
const LENGTHS_MM: RangeInclusive<f64> = 0.001..=10_000.0;

/// Why a document is not a skeleton.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SkeletonError {
    /// The document is too long.
    #[error("{0} bytes, a skeleton has at most {LEN_MAX}: use the output of `mocapd subject body`")]
    TooLong(usize),
    /// Not JSON, another kind of document, or a later version.
    #[error("{0}")]
    DocumentHeader(String),
    /// A missing key, or a value of the wrong type.
    #[error("invalid {FORMAT} (see docs/subject-body-format.md): {0}")]
    Schema(String),
    /// A value out of range.
    #[error("invalid {FORMAT}: `{place}` is {found}, expected {expected}")]
    Value {
        /// Its place, such as `joints[3].uncertainty_mm`.
        place: String,
        /// The value.
        found: String,
        /// The expected value.
        expected: String,
    },
}

/// The keys that identify a document.
#[derive(Deserialize)]
#[serde(expecting = "an object")]
struct DocumentHeader {
    #[serde(default)]
    format: Option<String>,
    #[serde(default)]
    version: Option<u64>,
}

#[derive(Serialize)]
struct Document<'a> {
    format: &'static str,
    version: u64,
    #[serde(flatten)]
    skeleton: &'a Skeleton,
}

impl Skeleton {
    /// Reads a document. Unknown keys are ignored.
    ///
    /// # Errors
    /// [`SkeletonError`] with the first reason.
    pub fn from_json(bytes: &[u8]) -> Result<Self, SkeletonError> {
        if bytes.len() > LEN_MAX {
            return Err(SkeletonError::TooLong(bytes.len()));
        }
        check_kind(bytes).map_err(SkeletonError::DocumentHeader)?;
        let mut json = serde_json::Deserializer::from_slice(bytes);
        let skeleton: Self = serde_path_to_error::deserialize(&mut json)
            .map_err(|error| SkeletonError::Schema(quoted(&error.to_string())))?;
        skeleton.check()?;
        Ok(skeleton)
    }

    /// The document as pretty-printed JSON with a final newline. Numbers are rounded so that every JSON reader restores
    /// them to the last bit: reading it with [`Self::from_json`] and writing it again gives the same bytes.
    #[must_use]
    pub fn to_json(&self) -> String {
        let skeleton = &self.clone().rounded();
        let document = Document { format: FORMAT, version: VERSION, skeleton };
        // Serialisation cannot fail: there are no maps and no special numbers.
        serde_json::to_string_pretty(&document).map(|text| text + "\n").unwrap_or_default()
    }

    fn rounded(mut self) -> Self {
        self.stature_mm = self.stature_mm.map(round);
        self.stature_uncertainty_mm = self.stature_uncertainty_mm.map(round);
        for joint in &mut self.joints {
            joint.position_mm = joint.position_mm.map(|at| at.map(round));
            joint.uncertainty_mm = joint.uncertainty_mm.map(round);
        }
        for bone in &mut self.bones {
            bone.length_mm = round(bone.length_mm);
            bone.uncertainty_mm = bone.uncertainty_mm.map(round);
            bone.spread_mm = bone.spread_mm.map(round);
        }
        self
    }

    fn check(&self) -> Result<(), SkeletonError> {
        for (key, count) in [("joints", self.joints.len()), ("bones", self.bones.len())] {
            let found = || format!("a list of {count}");
            expect(count <= PARTS_MAX, key, found, format!("at most {PARTS_MAX}"))?;
        }
        expect_size(self.stature_mm, "stature_mm")?;
        expect_size(self.stature_uncertainty_mm, "stature_uncertainty_mm")?;
        for (i, joint) in self.joints.iter().enumerate() {
            let of = |key: &str| format!("joints[{i}].{key}");
            let is_new = self.joints.iter().take(i).all(|other| other.name != joint.name);
            expect(is_new, of("name"), || quoted(&joint.name), "each joint once")?;
            let at = joint.position_mm.unwrap_or_default();
            let is_near = at.iter().all(|mm| mm.abs() <= POSITION_MAX_MM);
            let expected = "at most 1000 km from the origin";
            expect(is_near, of("position_mm"), || format!("{at:?}"), expected)?;
            expect_size(joint.uncertainty_mm, of("uncertainty_mm"))?;
        }
        self.bones.iter().enumerate().try_for_each(|(i, bone)| self.check_bone(bone, i))
    }

    fn check_bone(&self, bone: &Bone, i: usize) -> Result<(), SkeletonError> {
        let of = |key: &str| format!("bones[{i}].{key}");
        for (key, end) in [("parent", &bone.parent), ("child", &bone.child)] {
            let is_joint = self.joints.iter().any(|joint| joint.name == *end);
            expect(is_joint, of(key), || quoted(end), "one of the joints")?;
        }
        let is_between = bone.parent != bone.child;
        expect(is_between, of("child"), || quoted(&bone.child), "a joint other than the parent")?;
        let (mm, is_length) = (bone.length_mm, LENGTHS_MM.contains(&bone.length_mm));
        expect(is_length, of("length_mm"), || mm.to_string(), "0.001 to 10000")?;
        expect_size(bone.uncertainty_mm, of("uncertainty_mm"))?;
        expect_size(bone.spread_mm, of("spread_mm"))
    }
}

/// Rejects what is not JSON, another kind of document, or a later version.
fn check_kind(bytes: &[u8]) -> Result<(), String> {
    const MADE_BY: &str = "which `mocapd subject body -o` writes";
    const WRITE_VERSION: &str = "write \"version\": 1";
    let kind: DocumentHeader = serde_json::from_slice(bytes).map_err(|error| {
        let is = match error.classify() {
            Category::Data => "not a",
            Category::Eof => "cut off, or not a",
            Category::Syntax | Category::Io => "not JSON, and so not a",
        };
        format!("{is} {FORMAT}, {MADE_BY}: {}", quoted(&error.to_string()))
    })?;
    if kind.format.as_deref() != Some(FORMAT) {
        let found = kind.format.map_or("no format".to_owned(), |format| quoted(&format));
        return Err(format!("expected format {FORMAT}, {MADE_BY}; found {found}"));
    }
    match kind.version {
        Some(VERSION) => Ok(()),
        Some(found @ VERSION..) => Err(format!(
            "version {found} of {FORMAT}, but this build reads {VERSION}: use a newer mocapd"
        )),
        Some(found) => Err(format!("no version {found} of {FORMAT}: {WRITE_VERSION}")),
        None => Err(format!("{FORMAT} with no version: {WRITE_VERSION}")),
    }
}

fn expect(
    holds: bool,
    place: impl Into<String>,
    found: impl Fn() -> String,
    expected: impl Into<String>,
) -> Result<(), SkeletonError> {
    if holds {
        return Ok(());
    }
    Err(SkeletonError::Value { place: place.into(), found: found(), expected: expected.into() })
}

/// Checks a length or a standard deviation in millimetres, if present.
fn expect_size(mm: Option<f64>, place: impl Into<String>) -> Result<(), SkeletonError> {
    let mm = mm.unwrap_or_default();
    expect(SIZES_MM.contains(&mm), place, || mm.to_string(), "0 to 10000")
}

/// Rounds to 0.1 µm: every JSON reader restores numbers this short to the last bit.
fn round(mm: f64) -> f64 {
    (mm * 1e4).round() / 1e4
}

/// Quotes foreign text as a short line.
fn quoted(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(QUOTED_MAX).collect()
}

//! JSON of anybody to a skeleton, and back.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};
use serde_json::error::Category;

use super::{Bone, Skeleton};

const FORMAT: &str = "mocapd-skeleton";
const VERSION: u64 = 1;
/// Bytes of a document at most: a take holds no more of one.
pub const LEN_MAX: usize = 1 << 20;
/// Joints, and bones, at most: more than any body has.
const PARTS_MAX: usize = 256;
/// Characters of a document that an error repeats at most.
const QUOTED_MAX: usize = 200;
/// Farthest from the origin of a scan, in millimetres.
pub(super) const POSITION_MAX_MM: f64 = 1e9;
/// Statures, and how far off lengths are, in millimetres: those of any body, and of one whose unit is in doubt.
const SIZES_MM: RangeInclusive<f64> = 0.0..=10_000.0;
/// Bones: of a shorter one nothing would be left when it is written ([`round`]).
const LENGTHS_MM: RangeInclusive<f64> = 0.001..=10_000.0;

/// Why a document is no skeleton.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SkeletonError {
    /// Longer than any skeleton.
    #[error(
        "{0} bytes are more than a skeleton has ({LEN_MAX}): give what `mocapd subject body` wrote"
    )]
    TooLong(usize),
    /// No JSON, another document, or one of a later version.
    #[error("{0}")]
    DocumentHeader(String),
    /// A key that is missing, or a value of another type.
    #[error("a damaged {FORMAT} (docs/subject-body-format.md has the format): {0}")]
    Schema(String),
    /// A value that no skeleton has.
    #[error("a damaged {FORMAT}: `{place}` is {found}: expected {expected}")]
    Value {
        /// Which one: `joints[3].uncertainty_mm`.
        place: String,
        /// What it is.
        found: String,
        /// What it should be.
        expected: String,
    },
}

/// Which document it is.
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
    /// Reads a document. Keys that it does not know are passed over.
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

    /// The document, with a line a value, a line end, and numbers that every reader of JSON reads to the last bit: what
    /// [`Self::from_json`] makes of it gives the same document again.
    #[must_use]
    pub fn to_json(&self) -> String {
        let skeleton = &self.clone().rounded();
        let document = Document { format: FORMAT, version: VERSION, skeleton };
        // There is no map and no number in it that JSON could not hold.
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
            expect(count <= PARTS_MAX, key, found, format!("no more than {PARTS_MAX}"))?;
        }
        expect_size(self.stature_mm, "stature_mm")?;
        expect_size(self.stature_uncertainty_mm, "stature_uncertainty_mm")?;
        for (i, joint) in self.joints.iter().enumerate() {
            let of = |key: &str| format!("joints[{i}].{key}");
            let is_new = self.joints.iter().take(i).all(|other| other.name != joint.name);
            expect(is_new, of("name"), || quoted(&joint.name), "each joint once")?;
            let at = joint.position_mm.unwrap_or_default();
            let is_near = at.iter().all(|mm| mm.abs() <= POSITION_MAX_MM);
            let expected = "no more than 1000 km from the origin";
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
        expect(is_between, of("child"), || quoted(&bone.child), "another joint than the parent")?;
        let (mm, is_length) = (bone.length_mm, LENGTHS_MM.contains(&bone.length_mm));
        expect(is_length, of("length_mm"), || mm.to_string(), "0.001 to 10000")?;
        expect_size(bone.uncertainty_mm, of("uncertainty_mm"))?;
        expect_size(bone.spread_mm, of("spread_mm"))
    }
}

/// Refuses what is no JSON, JSON that is another document, and one of a later version.
fn check_kind(bytes: &[u8]) -> Result<(), String> {
    const MADE_BY: &str = "which `mocapd subject body -o` writes";
    const WRITE_VERSION: &str = "write \"version\": 1";
    let kind: DocumentHeader = serde_json::from_slice(bytes).map_err(|error| {
        let is = match error.classify() {
            Category::Data => "it is no",
            Category::Eof => "it is cut off, or no",
            Category::Syntax | Category::Io => "it is no JSON, and so no",
        };
        format!("{is} {FORMAT}, {MADE_BY}: {}", quoted(&error.to_string()))
    })?;
    if kind.format.as_deref() != Some(FORMAT) {
        let found = kind.format.map_or("no format".to_owned(), |format| quoted(&format));
        return Err(format!("it says {found} where {FORMAT} is expected, {MADE_BY}"));
    }
    match kind.version {
        Some(VERSION) => Ok(()),
        Some(found @ VERSION..) => Err(format!(
            "it is version {found} of {FORMAT}, this build reads {VERSION}: use a newer mocapd"
        )),
        Some(found) => Err(format!("there is no version {found} of {FORMAT}: {WRITE_VERSION}")),
        None => Err(format!("it says {FORMAT} and no version: {WRITE_VERSION}")),
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

/// A length or a standard deviation, in millimetres, where it is known.
fn expect_size(mm: Option<f64>, place: impl Into<String>) -> Result<(), SkeletonError> {
    let mm = mm.unwrap_or_default();
    expect(SIZES_MM.contains(&mm), place, || mm.to_string(), "0 to 10000")
}

/// To a tenth of a micrometre: numbers this short are read back to the last bit by every reader of JSON.
pub(super) fn round(mm: f64) -> f64 {
    (mm * 1e4).round() / 1e4
}

/// Foreign words, of any length, as a short line.
fn quoted(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(QUOTED_MAX).collect()
}

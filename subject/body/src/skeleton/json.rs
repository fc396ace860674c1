//! Reading and writing of skeleton documents.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};
use serde_json::error::Category;

use super::{Bone, Skeleton};

const FORMAT: &str = "mocapd-skeleton";
const VERSION: u64 = 1;
/// Largest document: the most that a take holds.
pub const LEN_MAX: usize = 1 << 20;
/// Maximum number of joints, and of bones.
const PARTS_MAX: usize = 256;
/// Maximum number of characters of a document that an error quotes.
const QUOTED_MAX: usize = 200;
/// Largest coordinate, in millimetres.
pub(super) const POSITION_MAX_MM: f64 = 1e9;
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
pub(super) fn round(mm: f64) -> f64 {
    (mm * 1e4).round() / 1e4
}

/// Quotes foreign text as a short line.
fn quoted(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(QUOTED_MAX).collect()
}

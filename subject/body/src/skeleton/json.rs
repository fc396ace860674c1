//! JSON of anybody to a skeleton, and back.

use super::{BONES, Bone, Skeleton, SkeletonJoint, joint_from_name};
use crate::Unit;

/// What `format` says.
pub(super) const FORMAT: &str = "mocapd-skeleton";
/// Bytes of a document at most: one of 64 sources and 100 notes has 50 thousand.
pub const LEN_MAX: usize = 1 << 18;
/// Sources, and notes, at most.
pub(super) const LIST_MAX: usize = 100;
/// Characters of a name or note at most.
pub(super) const TEXT_MAX: usize = 300;
/// Farthest from the origin of a scan, in millimetres.
pub(super) const POSITION_MAX_MM: f64 = 1e9;
/// Longest bone: more than the trunk of any person.
pub(super) const LENGTH_MAX_MM: f64 = 2000.0;
/// Statures of people.
pub(super) const STATURE_MM: std::ops::RangeInclusive<f64> = 300.0..=3000.0;

/// Why a document is no skeleton.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SkeletonError {
    /// Longer than any skeleton.
    #[error(
        "{0} bytes are more than a skeleton has ({LEN_MAX}): give what `mocapd subject body` wrote"
    )]
    TooLong(usize),
    /// No JSON, or not of this schema.
    #[error("not a skeleton: {0}")]
    Schema(String),
    /// A value that no skeleton has.
    #[error("not a skeleton: `{place}` {reason}")]
    Value {
        /// Which one: `joints[3].uncertainty_mm`.
        place: String,
        /// What was expected.
        reason: &'static str,
    },
}

impl Skeleton {
    /// Reads a document; unknown keys are refused, since they would be lost.
    ///
    /// # Errors
    /// [`SkeletonError`] with the first reason.
    pub fn from_json(bytes: &[u8]) -> Result<Self, SkeletonError> {
        if bytes.len() > LEN_MAX {
            return Err(SkeletonError::TooLong(bytes.len()));
        }
        let skeleton: Self = serde_json::from_slice(bytes).map_err(|error| {
            // The message may repeat a foreign word, of any length.
            let text = error.to_string();
            let text = text.chars().filter(|c| !c.is_control()).take(TEXT_MAX).collect();
            SkeletonError::Schema(text)
        })?;
        skeleton.check()?;
        Ok(skeleton.rounded())
    }

    fn rounded(mut self) -> Self {
        self.stature_mm = self.stature_mm.map(round);
        self.stature_uncertainty_mm = self.stature_uncertainty_mm.map(round);
        for joint in &mut self.joints {
            joint.position_mm = joint.position_mm.map(round);
            joint.uncertainty_mm = round(joint.uncertainty_mm);
        }
        for bone in &mut self.bones {
            bone.length_mm = round(bone.length_mm);
            bone.uncertainty_mm = round(bone.uncertainty_mm);
            bone.spread_mm = bone.spread_mm.map(round);
        }
        self
    }

    /// The document, with a line a value and a line end: what [`Self::from_json`] reads to the same skeleton, and that
    /// to the same document.
    #[must_use]
    pub fn to_json(&self) -> String {
        // There is no map and no number in it that JSON could not hold.
        serde_json::to_string_pretty(self).map(|text| text + "\n").unwrap_or_default()
    }

    fn check(&self) -> Result<(), SkeletonError> {
        expect(self.format == FORMAT, "format", "is not `mocapd-skeleton`")?;
        expect(self.version == 1, "version", "is not 1: a later mocapd wrote it")?;
        let is_countable = (1..=LIST_MAX).contains(&self.sources.len());
        expect(is_countable, "sources", "has none, or more than 100")?;
        for (i, source) in self.sources.iter().enumerate() {
            let of = |key: &str| format!("sources[{i}].{key}");
            expect(is_text(&source.name), of("name"), "is empty, or too long")?;
            let hex = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
            let is_hash = source.sha256.len() == 64 && source.sha256.bytes().all(hex);
            expect(is_hash, of("sha256"), "has not 64 hexadecimal digits")?;
            let unit = Unit::from_name(&source.unit).map(|unit| unit.to_string());
            expect(unit.as_ref() == Some(&source.unit), of("unit"), "is not m, cm, mm or in")?;
        }
        let is_stature = self.stature_mm.is_none_or(|mm| STATURE_MM.contains(&mm));
        expect(is_stature, "stature_mm", "is not between 300 and 3000")?;
        let sigma = self.stature_uncertainty_mm.unwrap_or_default();
        expect(is_spread(sigma), "stature_uncertainty_mm", "is not between 0 and 2000")?;
        for (i, joint) in self.joints.iter().enumerate() {
            self.check_joint(joint, i)?;
        }
        for (i, bone) in self.bones.iter().enumerate() {
            self.check_bone(bone, i)?;
        }
        let are_notes = self.notes.len() <= LIST_MAX && self.notes.iter().all(|note| is_text(note));
        expect(are_notes, "notes", "has more than 100, an empty one, or one too long")
    }

    fn check_joint(&self, joint: &SkeletonJoint, i: usize) -> Result<(), SkeletonError> {
        let of = |key: &str| format!("joints[{i}].{key}");
        expect(joint_from_name(&joint.name).is_some(), of("name"), "is none of the 15 joints")?;
        let is_new = self.joints.iter().take(i).all(|other| other.name != joint.name);
        expect(is_new, of("name"), "stands twice")?;
        let is_near = joint.position_mm.iter().all(|mm| mm.abs() <= POSITION_MAX_MM);
        expect(is_near, of("position_mm"), "is more than 1000 km from the origin")?;
        expect(is_spread(joint.uncertainty_mm), of("uncertainty_mm"), "is not between 0 and 2000")
    }

    fn check_bone(&self, bone: &Bone, i: usize) -> Result<(), SkeletonError> {
        let of = |key: &str| format!("bones[{i}].{key}");
        let ends = BONES.iter().find(|ends| ends.name == bone.name);
        expect(ends.is_some(), of("name"), "is none of the 14 bones")?;
        let is_new = self.bones.iter().take(i).all(|other| other.name != bone.name);
        expect(is_new, of("name"), "stands twice")?;
        let parent = ends.map(|ends| ends.parent);
        expect(
            joint_from_name(&bone.parent) == parent,
            of("parent"),
            "is not where this bone begins",
        )?;
        let child = ends.map(|ends| ends.child);
        expect(joint_from_name(&bone.child) == child, of("child"), "is not where this bone ends")?;
        let has = |name: &str| self.joints.iter().any(|joint| joint.name == name);
        let has_ends = has(&bone.parent) && has(&bone.child);
        expect(has_ends, of("name"), "has an end that is not among the joints")?;
        let is_length = (0.001..=LENGTH_MAX_MM).contains(&bone.length_mm);
        expect(is_length, of("length_mm"), "is not between 0.001 and 2000")?;
        expect(is_spread(bone.uncertainty_mm), of("uncertainty_mm"), "is not between 0 and 2000")?;
        let spread = bone.spread_mm.unwrap_or_default();
        expect(is_spread(spread), of("spread_mm"), "is not between 0 and 2000")?;
        let is_counted = (1..=self.sources.len()).contains(&(bone.scans as usize));
        expect(is_counted, of("scans"), "is 0, or more than there are sources")
    }
}

fn expect(
    holds: bool,
    place: impl Into<String>,
    reason: &'static str,
) -> Result<(), SkeletonError> {
    if holds { Ok(()) } else { Err(SkeletonError::Value { place: place.into(), reason }) }
}

/// A standard deviation, in millimetres.
fn is_spread(mm: f64) -> bool {
    (0.0..=LENGTH_MAX_MM).contains(&mm)
}

/// To a tenth of a micrometre: numbers this short are read back to the last bit by every reader of JSON.
pub(super) fn round(mm: f64) -> f64 {
    (mm * 1e4).round() / 1e4
}

fn is_text(text: &str) -> bool {
    !text.is_empty() && text.chars().count() <= TEXT_MAX && !text.contains(char::is_control)
}

//! JSON of anybody to a skeleton, and back.

use super::names::{BONES, joint_from_name};
use super::{Bone, Skeleton};
use crate::{Joint, Unit};

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
        let wrong = |place: String, reason| Err(SkeletonError::Value { place, reason });
        if self.format != FORMAT {
            return wrong("format".to_owned(), "is not `mocapd-skeleton`");
        }
        if self.version != 1 {
            return wrong("version".to_owned(), "is not 1: a later mocapd wrote it");
        }
        if !(1..=LIST_MAX).contains(&self.sources.len()) {
            return wrong("sources".to_owned(), "has none, or more than 100");
        }
        for (i, source) in self.sources.iter().enumerate() {
            let hex = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
            if !is_text(&source.name) {
                return wrong(format!("sources[{i}].name"), "is empty, or too long");
            }
            if source.sha256.len() != 64 || !source.sha256.bytes().all(hex) {
                return wrong(format!("sources[{i}].sha256"), "has not 64 hexadecimal digits");
            }
            if Unit::from_name(&source.unit).is_none_or(|unit| unit.to_string() != source.unit) {
                return wrong(format!("sources[{i}].unit"), "is not m, cm, mm or in");
            }
        }
        if self.stature_mm.is_some_and(|mm| !STATURE_MM.contains(&mm)) {
            return wrong("stature_mm".to_owned(), "is not between 300 and 3000");
        }
        if self.stature_uncertainty_mm.is_some_and(|mm| !(0.0..=LENGTH_MAX_MM).contains(&mm)) {
            return wrong("stature_uncertainty_mm".to_owned(), "is not between 0 and 2000");
        }
        self.check_joints()?;
        for (i, bone) in self.bones.iter().enumerate() {
            self.check_bone(i, bone)?;
        }
        if self.notes.len() > LIST_MAX || !self.notes.iter().all(|note| is_text(note)) {
            return wrong("notes".to_owned(), "has more than 100, an empty one, or one too long");
        }
        Ok(())
    }

    fn check_joints(&self) -> Result<(), SkeletonError> {
        let mut seen: Vec<Joint> = Vec::new();
        for (i, joint) in self.joints.iter().enumerate() {
            let wrong = |key: &str, reason| {
                Err(SkeletonError::Value { place: format!("joints[{i}].{key}"), reason })
            };
            match joint_from_name(&joint.name) {
                None => return wrong("name", "is none of the 15 joints"),
                Some(known) if seen.contains(&known) => return wrong("name", "stands twice"),
                Some(known) => seen.push(known),
            }
            if !joint.position_mm.iter().all(|mm| mm.abs() <= POSITION_MAX_MM) {
                return wrong("position_mm", "is more than 1000 km from the origin");
            }
            if !(0.0..=LENGTH_MAX_MM).contains(&joint.uncertainty_mm) {
                return wrong("uncertainty_mm", "is not between 0 and 2000");
            }
        }
        Ok(())
    }

    fn check_bone(&self, i: usize, bone: &Bone) -> Result<(), SkeletonError> {
        let wrong = |key: &str, reason| {
            Err(SkeletonError::Value { place: format!("bones[{i}].{key}"), reason })
        };
        let Some((_, parent, child)) = BONES.iter().find(|(name, ..)| *name == bone.name) else {
            return wrong("name", "is none of the 14 bones");
        };
        if self.bones.iter().take(i).any(|other| other.name == bone.name) {
            return wrong("name", "stands twice");
        }
        if joint_from_name(&bone.parent) != Some(*parent) {
            return wrong("parent", "is not where this bone begins");
        }
        if joint_from_name(&bone.child) != Some(*child) {
            return wrong("child", "is not where this bone ends");
        }
        let has = |name: &str| self.joints.iter().any(|joint| joint.name == name);
        if !has(&bone.parent) || !has(&bone.child) {
            return wrong("name", "has an end that is not among the joints");
        }
        if !(0.001..=LENGTH_MAX_MM).contains(&bone.length_mm) {
            return wrong("length_mm", "is not between 0.001 and 2000");
        }
        if !(0.0..=LENGTH_MAX_MM).contains(&bone.uncertainty_mm) {
            return wrong("uncertainty_mm", "is not between 0 and 2000");
        }
        if bone.spread_mm.is_some_and(|mm| !(0.0..=LENGTH_MAX_MM).contains(&mm)) {
            return wrong("spread_mm", "is not between 0 and 2000");
        }
        if bone.scans == 0 || bone.scans as usize > self.sources.len() {
            return wrong("scans", "is 0, or more than there are sources");
        }
        Ok(())
    }
}

/// To a tenth of a micrometre: numbers this short are read back to the last bit by every reader of JSON.
pub(super) fn round(mm: f64) -> f64 {
    (mm * 1e4).round() / 1e4
}

fn is_text(text: &str) -> bool {
    !text.is_empty() && text.chars().count() <= TEXT_MAX && !text.contains(char::is_control)
}

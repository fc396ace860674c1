//! `skeleton.json`, as far as the house needs it: joints, bones, and where they are from.

use anyhow::{Context, ensure};
use mocapd_report::limbs::{Bone, Limb, limbs};
use mocapd_take::record::Subject;
use serde::{Deserialize, Serialize};

use super::check_kind;
use crate::live::LiveLimb;

/// Joints and bones: more than any body has.
const PARTS_MAX: usize = 256;

/// A skeleton from scans of the body.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Skeleton {
    /// `default`, or `paper` for the published method.
    #[serde(default)]
    pub method: String,
    /// The scans.
    #[serde(default)]
    pub sources: Vec<SourceScan>,
    /// How tall the scan is, mm.
    pub stature_mm: Option<f64>,
    /// Whether left and right could be told.
    #[serde(default)]
    pub sides_told: bool,
    /// The joint centres.
    pub joints: Vec<Joint>,
    /// What is between them.
    pub bones: Vec<ScannedBone>,
}

/// A scan that it was made of.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
pub struct SourceScan {
    /// Its file's name.
    pub name: String,
    /// The file's SHA-256, in hexadecimal digits.
    pub sha256: String,
}

/// A joint centre.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Joint {
    /// `l_shoulder` and so on.
    pub name: String,
    /// How far off it may be, mm.
    pub uncertainty_mm: Option<f64>,
}

/// A bone as the document has it.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
pub struct ScannedBone {
    /// `l_upper_arm` and so on.
    pub name: String,
    /// The joint nearer to the pelvis.
    pub parent: String,
    /// The other one.
    pub child: String,
    /// Its length, mm.
    pub length_mm: f64,
    /// How far off that may be, mm.
    pub uncertainty_mm: Option<f64>,
    /// How far the lengths of several scans lie apart, mm.
    pub spread_mm: Option<f64>,
    /// How many scans it was measured on.
    #[serde(default)]
    pub scans: u64,
}

impl Skeleton {
    /// From the bytes of a document.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(data: &[u8]) -> anyhow::Result<Self> {
        const FORMAT: &str = "mocapd-skeleton";
        check_kind(data, FORMAT, "body")?;
        let skeleton: Self =
            serde_json::from_slice(data).with_context(|| format!("a damaged {FORMAT}"))?;
        skeleton.check().with_context(|| format!("a damaged {FORMAT}"))?;
        Ok(skeleton)
    }

    /// A take's own; `None` where it has none.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn of_take(subject: Option<&Subject>) -> anyhow::Result<Option<Self>> {
        let document = subject.and_then(|subject| subject.document(Subject::SKELETON));
        document.map(Self::parse).transpose().context("the take's skeleton")
    }

    fn check(&self) -> anyhow::Result<()> {
        let (n_joints, n_bones) = (self.joints.len(), self.bones.len());
        ensure!(
            n_joints <= PARTS_MAX && n_bones <= PARTS_MAX,
            "{n_joints} joints and {n_bones} bones are more than a body has ({PARTS_MAX})"
        );
        for (i, joint) in self.joints.iter().enumerate() {
            let is_twice = self.joints[..i].iter().any(|before| before.name == joint.name);
            ensure!(!is_twice, "the joint {} comes twice", joint.name);
        }
        let is_size = |mm: f64| mm.is_finite() && (0.0..=10_000.0).contains(&mm);
        for bone in &self.bones {
            let is_joint = |name: &str| self.joints.iter().any(|joint| joint.name == name);
            ensure!(
                is_joint(&bone.parent) && is_joint(&bone.child) && bone.parent != bone.child,
                "the bone {} is between {} and {}, which are not two of its joints",
                bone.name,
                bone.parent,
                bone.child
            );
            ensure!(
                is_size(bone.length_mm)
                    && bone.length_mm > 0.0
                    && bone.uncertainty_mm.is_none_or(is_size),
                "the bone {} has a length of {} mm, give or take {} mm",
                bone.name,
                bone.length_mm,
                bone.uncertainty_mm.unwrap_or_default()
            );
        }
        Ok(())
    }

    /// Its bones, for who measures them in a take.
    #[must_use]
    pub fn to_bones(&self) -> Vec<Bone> {
        let bone = |bone: &ScannedBone| Bone {
            name: bone.name.clone(),
            parent: bone.parent.clone(),
            child: bone.child.clone(),
            length_mm: bone.length_mm,
            uncertainty_mm: bone.uncertainty_mm.unwrap_or_default(),
        };
        self.bones.iter().map(bone).collect()
    }
}

/// The limbs of the subject's skeleton between these slots. It was checked when it was read: here nothing is said of it.
#[must_use]
pub fn live_limbs(subject: Option<&Subject>, labels: &[String]) -> Vec<LiveLimb> {
    let Ok(Some(skeleton)) = Skeleton::of_take(subject) else { return Vec::new() };
    let named = &labels[..labels.len().min(usize::from(u16::MAX) + 1)];
    let name = subject.map_or("", |subject| subject.name.as_str());
    let (found, _) = limbs(&skeleton.to_bones(), named, name);
    let slot = |column: usize| u16::try_from(column).unwrap_or_default();
    let limb = |limb: &Limb| LiveLimb {
        ends: limb.ends.map(slot),
        length_mm: limb.bone.length_mm,
        off_mm: limb.bone.off_mm(),
    };
    found.iter().map(limb).collect()
}

/// Lines by label, and those of limbs that are not among them.
#[must_use]
pub fn with_limbs(mut bones: Vec<[u16; 2]>, limbs: &[LiveLimb]) -> Vec<[u16; 2]> {
    for LiveLimb { ends: [a, b], .. } in limbs {
        if !bones.contains(&[*a, *b]) && !bones.contains(&[*b, *a]) {
            bones.push([*a, *b]);
        }
    }
    bones
}

//! One mesh, its known joints and the estimated ones.

use std::collections::BTreeMap;

use mocapd_body::skeleton::Method;
use mocapd_body::{Joint, Joints, Mesh, ScanAnalysis, Side};

use crate::paper::ByPaper;
use crate::read::Truth;
pub(crate) use crate::score::distance;

/// The joints of a limb, from the trunk outwards, with their names in the ground truth.
pub(crate) const KINDS: [&str; 6] = ["shoulder", "elbow", "wrist", "hip", "knee", "ankle"];

/// A mesh with known joints, and the results on it.
pub(crate) struct Case {
    pub(crate) name: String,
    pub(crate) mesh: Mesh,
    pub(crate) stature: f64,
    pub(crate) truth: BTreeMap<String, [f64; 3]>,
    /// The joints, or the reason for the refusal.
    pub(crate) found: Result<Joints, String>,
    /// The results of (Yu et al. 2008).
    pub(crate) paper: ByPaper,
    /// Whether the sides of `found` had to be exchanged to agree with the ground truth.
    pub(crate) swapped: bool,
}

impl Case {
    /// Measures a mesh; `None` if its joints are not known.
    pub(crate) fn measure(mesh: Mesh, truth: &Truth) -> Option<Self> {
        let joints = truth.joints.clone()?;
        let found = skeleton(&mesh);
        let mut case = Self {
            name: truth.name.clone(),
            paper: ByPaper::measure(&mesh, truth),
            mesh,
            stature: truth.stature_m,
            truth: joints,
            found,
            swapped: false,
        };
        let sum = |case: &Self| case.errors().map(|(_, error)| error).sum::<f64>();
        let straight = sum(&case);
        case.swapped = true;
        if sum(&case) >= straight {
            case.swapped = false;
        }
        Some(case)
    }

    /// An estimated joint by its name in the ground truth, after exchanging sides where necessary.
    pub(crate) fn joint(&self, kind: &str, left: bool) -> Option<[f64; 3]> {
        let side = if left != self.swapped { Side::Left } else { Side::Right };
        let joint = match kind {
            "shoulder" => Joint::Shoulder(side),
            "elbow" => Joint::Elbow(side),
            "wrist" => Joint::Wrist(side),
            "hip" => Joint::Hip(side),
            "knee" => Joint::Knee(side),
            "ankle" => Joint::Ankle(side),
            "neck" => Joint::Throat,
            "head_top" => Joint::Head,
            _ => return None,
        };
        Some(self.found.as_ref().ok()?.estimates.get(&joint)?.position)
    }

    pub(crate) fn sigma(&self, kind: &str, left: bool) -> Option<f64> {
        let at = self.joint(kind, left)?;
        let estimates = &self.found.as_ref().ok()?.estimates;
        estimates.values().find(|one| one.position == at).map(|one| one.sigma)
    }

    fn true_joint(&self, kind: &str, left: bool) -> Option<[f64; 3]> {
        self.truth.get(&format!("{kind}.{}", if left { "L" } else { "R" })).copied()
    }

    /// The errors of the twelve joints, in per cent of stature, with the index of the kind.
    pub(crate) fn errors(&self) -> impl Iterator<Item = (usize, f64)> {
        KINDS.iter().enumerate().flat_map(move |(index, kind)| {
            [true, false].into_iter().filter_map(move |left| {
                let error = distance(self.joint(kind, left)?, self.true_joint(kind, left)?);
                Some((index, 100.0 * error / self.stature))
            })
        })
    }

    /// The errors over their standard deviations.
    pub(crate) fn ratios(&self) -> impl Iterator<Item = f64> {
        KINDS.iter().flat_map(move |kind| {
            [true, false].into_iter().filter_map(move |left| {
                let error = distance(self.joint(kind, left)?, self.true_joint(kind, left)?);
                Some(error / self.sigma(kind, left)?)
            })
        })
    }

    /// The error of a joint on the midline, in per cent of stature.
    pub(crate) fn midline_error(&self, kind: &str) -> Option<f64> {
        let error = distance(self.joint(kind, true)?, *self.truth.get(kind)?);
        Some(100.0 * error / self.stature)
    }

    /// Relative errors of upper arms, forearms, thighs and shanks.
    pub(crate) fn lengths(&self) -> impl Iterator<Item = (usize, f64)> {
        [(0, 1), (1, 2), (3, 4), (4, 5)].into_iter().enumerate().flat_map(move |(limb, (a, b))| {
            [true, false].into_iter().filter_map(move |left| {
                let found = distance(self.joint(KINDS[a], left)?, self.joint(KINDS[b], left)?);
                let truth =
                    distance(self.true_joint(KINDS[a], left)?, self.true_joint(KINDS[b], left)?);
                Some((limb, found / truth - 1.0))
            })
        })
    }
}

/// The whole pipeline from a mesh in memory.
pub(crate) fn skeleton(mesh: &Mesh) -> Result<Joints, String> {
    let analysis =
        ScanAnalysis::new(mesh, Method::Default).map_err(|reason| reason.code().to_owned())?;
    Ok(analysis.joints)
}

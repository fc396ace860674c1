//! Limbs whose ends are markers: how long a scan says they are, and how long they are in a take.
//!
//! A limb keeps its length however fast it moves. So a length that changes tells of labels that changed places
//! ([`swaps`]), or of a marker that slid.

pub mod lengths;
pub mod swaps;

use std::collections::HashMap;

use mocapd_body::skeleton::Bone;
use mocapd_take::motion::Motion;

use self::lengths::Body;
pub use self::{
    lengths::{Lengths, Outside},
    swaps::Swap,
};
use crate::labels::{SubjectMarkers, subjects};

/// How much of a scan's length a marker on the skin may be off before it is shown.
pub const OFF_PART: f64 = 0.1;

/// A bone both of whose joints are markers.
#[derive(Debug, Clone, PartialEq)]
pub struct Limb {
    /// The bone.
    pub bone: Bone,
    /// The columns of its parent and of its child.
    pub ends: [usize; 2],
}

impl Limb {
    /// Whether a length is off the scan's by more than its uncertainty, and by more than [`OFF_PART`] of it.
    #[must_use]
    pub fn is_off(&self, length_mm: f64) -> bool {
        (length_mm - self.bone.length_mm).abs() > self.off_mm()
    }

    /// How far off a length may be before it is, mm.
    #[must_use]
    pub fn off_mm(&self) -> f64 {
        self.bone.uncertainty_mm.unwrap_or_default().max(OFF_PART * self.bone.length_mm)
    }
}

/// The bones whose joints labels name, and the columns of all markers of that subject.
///
/// Where labels name several subjects (`Ann:LKNE`), it is the one of this name, or else the one with most joints.
#[must_use]
pub fn limbs<L: AsRef<str>>(bones: &[Bone], labels: &[L], name: &str) -> (Vec<Limb>, Vec<usize>) {
    let mut best = (Vec::new(), Vec::new());
    for subject in subjects(labels.iter().map(AsRef::as_ref)) {
        let joints = subject.joints();
        let found = of_joints(bones, &joints);
        let is_named = !name.is_empty() && subject.name.eq_ignore_ascii_case(name);
        if is_named && !found.is_empty() {
            return (found, columns(&subject));
        }
        if found.len() > best.0.len() {
            best = (found, columns(&subject));
        }
    }
    best
}

fn of_joints(bones: &[Bone], joints: &HashMap<String, usize>) -> Vec<Limb> {
    let limb = |bone: &Bone| {
        let ends = [*joints.get(&bone.parent)?, *joints.get(&bone.child)?];
        (ends[0] != ends[1]).then(|| Limb { bone: bone.clone(), ends })
    };
    bones.iter().filter_map(limb).collect()
}

fn columns(subject: &SubjectMarkers<'_>) -> Vec<usize> {
    let mut columns: Vec<usize> = subject.sites.values().copied().collect();
    columns.sort_unstable();
    columns
}

/// What the limbs of a take say of its labels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Check {
    /// By limb.
    pub lengths: Vec<Lengths>,
    /// Markers that changed places, in the order of their first frames.
    pub swaps: Vec<Swap>,
    /// Where a limb leaves its band and no two labels mend it.
    pub outside: Vec<Outside>,
}

/// Measures the limbs of a take, and looks for swaps among the markers in `columns`.
#[must_use]
pub fn check(motion: &Motion, limbs: &[Limb], columns: &[usize]) -> Check {
    let mut body = Body::new(motion, limbs, columns);
    let lengths: Vec<Lengths> = (0..limbs.len()).map(|limb| lengths::of(&body, limb)).collect();
    body.set_bands(&lengths);
    let mut found = swaps::all(&mut body);
    found.sort_by_key(|swap| (swap.rows.start, swap.markers));
    // What is left when the labels are back in their places.
    let outside = lengths::outside(&body);
    Check { lengths, swaps: found, outside }
}

#[cfg(test)]
mod tests;

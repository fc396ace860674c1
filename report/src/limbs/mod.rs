//! Limb lengths between markers, compared with those of a body scan.
//!
//! The length of a limb is constant however fast it moves, so a changing length reveals swapped labels ([`swaps`]) or a
//! marker that slid.

pub mod lengths;
pub mod swaps;

use std::collections::HashMap;

use mocapd_body::skeleton::Bone;
use mocapd_take::motion::Motion;

use self::lengths::SubjectMotion;
pub use self::{
    lengths::{Excursion, LimbStats},
    swaps::Swap,
};
use crate::labels::{SubjectMarkers, subjects};

/// Smallest deviation from the scan's length that is reported, as a fraction of it: markers are on the skin, not at the
/// joint centres.
pub const OFF_FRACTION: f64 = 0.1;

/// A bone with a marker at each of its joints.
#[derive(Debug, Clone, PartialEq)]
pub struct Limb {
    /// The bone.
    pub bone: Bone,
    /// The columns of the markers at its parent and child joints.
    pub ends: [usize; 2],
}

impl Limb {
    /// Whether a length deviates from the scan's by more than [`off_mm`](Self::off_mm).
    #[must_use]
    pub fn is_off(&self, length_mm: f64) -> bool {
        (length_mm - self.bone.length_mm).abs() > self.off_mm()
    }

    /// The tolerated deviation from the scan's length, mm: its uncertainty, but at least [`OFF_FRACTION`] of the
    /// length.
    #[must_use]
    pub fn off_mm(&self) -> f64 {
        self.bone.uncertainty_mm.unwrap_or_default().max(OFF_FRACTION * self.bone.length_mm)
    }
}

/// The limbs of a subject, and the columns of all of its markers.
///
/// If labels name several subjects (`Ann:LKNE`), the one called `name` is taken, else the one with most limbs.
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

/// The result of a check of limb lengths.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LimbCheck {
    /// The statistics of each limb.
    pub lengths: Vec<LimbStats>,
    /// Swapped labels, in the order of their first frames.
    pub swaps: Vec<Swap>,
    /// Where a limb leaves its band for another reason than a swap.
    pub outside: Vec<Excursion>,
}

/// Measures the limbs of a take, and searches for swapped labels among the markers in `columns`.
#[must_use]
pub fn check(motion: &Motion, limbs: &[Limb], columns: &[usize]) -> LimbCheck {
    let mut body = SubjectMotion::new(motion, limbs, columns);
    let lengths: Vec<LimbStats> = (0..limbs.len()).map(|limb| lengths::of(&body, limb)).collect();
    body.set_bands(&lengths);
    let mut found = swaps::all(&mut body);
    found.sort_by_key(|swap| (swap.rows.start, swap.markers));
    // Measured with the swaps undone.
    let outside = lengths::outside(&body);
    LimbCheck { lengths, swaps: found, outside }
}

#[cfg(test)]
mod tests;

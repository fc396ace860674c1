//! Combination of several scans into one skeleton.

use super::functional::{self, Centre, LENGTH_MAX_MM};
use super::json::{POSITION_MAX_MM, round};
use super::{
    BONES, Bone, BoneEnds, Length, Method, ScanJoints, Skeleton, SkeletonJoint, counterpart,
    joint_name, joints,
};
use crate::mesh::distance;
use crate::{Estimate, Joint, Joints};

/// Maximum number of sources, and of notes.
const LIST_MAX: usize = 100;
/// Maximum number of characters of a name or a note.
pub(super) const TEXT_MAX: usize = 300;
/// Plausible statures.
const STATURE_MM: std::ops::RangeInclusive<f64> = 300.0..=3000.0;

/// Minimum standard deviation of a length, in millimetres, since a scan shows only skin. It keeps an overconfident
/// scan from outweighing the others.
const FLOOR_MM: f64 = 1.0;

/// Plausible bone lengths: not zero, and no longer than in any person.
const LENGTHS_MM: std::ops::RangeInclusive<f64> = FLOOR_MM..=LENGTH_MAX_MM;

/// Largest relative difference between the longest and the shortest length of a limb over all poses of one person:
/// measured were 0.07 for thighs and shanks, 0.14 for upper arms and forearms.
const SPREAD_MAX: [(&str, f64); 4] =
    [("thigh", 0.09), ("shank", 0.09), ("upper_arm", 0.16), ("forearm", 0.16)];

pub(super) fn combine(method: Method, scans: &[ScanJoints]) -> Option<Skeleton> {
    let mut in_mm: Vec<Joints> = scans.iter().take(LIST_MAX).map(millimetres).collect();
    let mut notes: Vec<String> = scans.iter().flat_map(|scan| scan.notes.iter().cloned()).collect();
    let found: usize = scans.iter().map(|scan| scan.joints.estimates.len()).sum();
    let usable: usize = in_mm.iter().map(|joints| joints.estimates.len()).sum();
    if usable < found {
        notes.push(format!("left out joints without a finite position: {}", found - usable));
    }
    let sides_told = in_mm.iter().all(|joints| joints.sides_told);
    let centres = functional::centres(&in_mm, &mut notes);
    let first = in_mm.first()?.clone();
    let mut bones: Vec<Bone> = Vec::new();
    for ends in BONES {
        let of_scan = |joints: &Joints| length(joints, ends);
        let (lengths, odd): (Vec<_>, Vec<_>) =
            in_mm.iter().filter_map(of_scan).partition(|length| LENGTHS_MM.contains(&length.mm));
        let name = ends.name;
        if let Some(Length { mm, .. }) = odd.first() {
            notes.push(format!("{name}: left out, {mm:.0} mm is not a plausible length"));
        }
        // A bone whose ends are missing from the first scan could not be drawn.
        if lengths.is_empty() || length(&first, ends).is_none() {
            continue;
        }
        let mut bone = mean_bone(ends, &lengths);
        if let Some(centre) = centres.iter().find(|centre| centre.child == ends.child) {
            bone.length_mm = round(centre.radius.mm);
            bone.uncertainty_mm = Some(round(centre.radius.sigma_mm));
        }
        let most = SPREAD_MAX.iter().find(|(limb, _)| name.ends_with(limb)).map(|(_, most)| *most);
        let spread = relative_spread(&lengths);
        if let Some(spread) = spread.filter(|spread| most.is_some_and(|most| *spread > most)) {
            let why = "the scans are of several people, or a joint is wrong in one of them";
            let percent = 100.0 * spread;
            notes.push(format!("{name}: differs by {percent:.0} % between scans: {why}"));
        }
        bones.push(bone);
    }
    if in_mm.len() > 1 && !sides_told {
        notes.push("left and right are unknown in some scan: each pair of limbs has the mean of both sides".to_owned());
        average_sides(&mut bones);
    }
    // The most certain scan has the largest weight in every bone.
    let size_sigma = in_mm.iter().map(|joints| joints.size_sigma).fold(f64::INFINITY, f64::min);
    let stature = stature(&bones, size_sigma).filter(|_| method == Method::Default);
    let joints = skeleton_joints(in_mm.first_mut()?, &centres);
    notes.iter_mut().for_each(|note| *note = note.chars().take(TEXT_MAX).collect());
    notes.retain(|note| !note.is_empty());
    notes.truncate(LIST_MAX);
    let sources = scans.iter().take(LIST_MAX).map(|scan| scan.source.clone()).collect();
    Some(Skeleton {
        method: method.name().to_owned(),
        sources,
        stature_mm: stature.map(|stature| round(stature.mm)),
        stature_uncertainty_mm: stature.map(|stature| round(stature.sigma_mm)),
        sides_told,
        joints,
        bones,
        notes,
    })
}

fn millimetres(scan: &ScanJoints) -> Joints {
    let mm = scan.unit.mm();
    let convert = |(joint, estimate): (&Joint, &Estimate)| {
        let position = estimate.position.map(|part| part * mm);
        (*joint, Estimate { position, sigma: (estimate.sigma * mm).clamp(0.0, LENGTH_MAX_MM) })
    };
    let usable = |(_, estimate): &(Joint, Estimate)| {
        estimate.position.iter().all(|mm| mm.abs() <= POSITION_MAX_MM) && !estimate.sigma.is_nan()
    };
    let estimates = scan.joints.estimates.iter().map(convert).filter(usable).collect();
    Joints { estimates, ..scan.joints.clone() }
}

/// Distance between the two joints of a bone.
fn length(joints: &Joints, ends: BoneEnds) -> Option<Length> {
    let (a, b) = (joints.estimates.get(&ends.parent)?, joints.estimates.get(&ends.child)?);
    // A third of the variance of an isotropic error lies along the bone.
    let sigma = (a.sigma.powi(2) + b.sigma.powi(2)).sqrt() / 3_f64.sqrt();
    let mm = distance(a.position, b.position);
    Some(Length { mm, sigma_mm: sigma.max(FLOOR_MM).hypot(joints.size_sigma * mm) })
}

/// Relative excess of the longest length over the shortest.
fn relative_spread(lengths: &[Length]) -> Option<f64> {
    let mm = || lengths.iter().map(|length| length.mm);
    let (least, most) = (mm().min_by(f64::total_cmp)?, mm().max_by(f64::total_cmp)?);
    Some(most / least - 1.0)
}

fn mean_bone(ends: BoneEnds, lengths: &[Length]) -> Bone {
    let n = lengths.len() as f64;
    let weight: f64 = lengths.iter().map(|length| length.sigma_mm.powi(-2)).sum();
    let weighted = lengths.iter().map(|length| length.mm * length.sigma_mm.powi(-2));
    let mean = weighted.sum::<f64>() / weight;
    let plain = lengths.iter().map(|length| length.mm).sum::<f64>() / n;
    let squares: f64 = lengths.iter().map(|length| (length.mm - plain).powi(2)).sum();
    let spread = (lengths.len() > 1).then(|| (squares / (n - 1.0)).sqrt());
    // The larger of the expected uncertainty and the observed spread.
    let uncertainty = weight.powf(-0.5).max(spread.unwrap_or(0.0) / n.sqrt());
    Bone {
        name: ends.name.to_owned(),
        parent: joint_name(ends.parent).to_owned(),
        child: joint_name(ends.child).to_owned(),
        length_mm: round(mean),
        uncertainty_mm: Some(round(uncertainty)),
        spread_mm: spread.map(round),
        scans: lengths.len() as u64,
    }
}

/// Replaces both bones of a pair by their mean.
fn average_sides(bones: &mut [Bone]) {
    let before = bones.to_vec();
    for bone in bones {
        let counterpart = counterpart(&bone.name);
        if let Some(counterpart) = before.iter().find(|other| Some(&*other.name) == counterpart) {
            bone.length_mm = round((bone.length_mm + counterpart.length_mm) / 2.0);
            let larger = |(a, b): (f64, f64)| a.max(b);
            bone.uncertainty_mm = bone.uncertainty_mm.zip(counterpart.uncertainty_mm).map(larger);
            bone.spread_mm = bone.spread_mm.zip(counterpart.spread_mm).map(larger);
        }
    }
}

fn skeleton_joints(first: &mut Joints, centres: &[Centre]) -> Vec<SkeletonJoint> {
    for centre in centres {
        let estimate = Estimate { position: centre.in_first.into(), sigma: centre.sigma };
        first.estimates.insert(centre.joint, estimate);
    }
    let found = joints().filter_map(|joint| Some((joint, first.estimates.get(&joint)?)));
    found
        .map(|(joint, estimate)| SkeletonJoint {
            name: joint_name(joint).to_owned(),
            position_mm: Some(estimate.position.map(round)),
            uncertainty_mm: Some(round(estimate.sigma)),
        })
        .collect()
}

/// Ratio of stature to the path from the crown along throat, pelvis, thigh and shank: the mean over the two average
/// shapes of `MakeHuman` in 13 poses, with the joints of the default method. It accounts for the feet and for what the
/// path leaves out.
const STATURE_OF_BONES: f64 = 1.045;
/// Relative standard deviation of that ratio: 0.013 on these two shapes, at most 0.018 on others.
const STATURE_SD: f64 = 0.018;

/// The bones' combined standard deviation relative to stature is 0.031 to 0.035 if no joint is in doubt. Above this
/// value stature is no more certain than the bones.
const BONES_UNCERTAIN: f64 = 0.045;

/// If one side's bone is more certain than the other's by this factor, it counts alone.
const SIGMA_RATIO: f64 = 1.5;

/// Stature in any pose; none if a bone is missing or the result is implausible. `size_sigma` is the relative error
/// common to all bones, which their number does not reduce.
fn stature(bones: &[Bone], size_sigma: f64) -> Option<Length> {
    let alone = |name: &str| bones.iter().find(|bone| bone.name == name).map(Bone::length);
    let mean = |a: &str, b: &str| match (alone(a), alone(b)) {
        // If a limb is cut off, the other side is worth more than the mean.
        (Some(a), Some(b)) if a.sigma_mm > SIGMA_RATIO * b.sigma_mm => Some(b),
        (Some(a), Some(b)) if b.sigma_mm > SIGMA_RATIO * a.sigma_mm => Some(a),
        (Some(a), Some(b)) => Some(Length {
            mm: f64::midpoint(a.mm, b.mm),
            sigma_mm: f64::midpoint(a.sigma_mm, b.sigma_mm),
        }),
        (one, other) => one.or(other),
    };
    let path = [
        alone("head_throat")?,
        alone("throat_pelvis")?,
        mean("l_thigh", "r_thigh")?,
        mean("l_shank", "r_shank")?,
    ];
    let stature_mm = STATURE_OF_BONES * path.iter().map(|bone| bone.mm).sum::<f64>();
    let of_bones = path.iter().map(|bone| bone.sigma_mm.powi(2)).sum::<f64>().sqrt() / stature_mm;
    let sigma = if of_bones > BONES_UNCERTAIN { of_bones } else { STATURE_SD }.hypot(size_sigma);
    STATURE_MM
        .contains(&stature_mm)
        .then_some(Length { mm: stature_mm, sigma_mm: sigma * stature_mm })
}

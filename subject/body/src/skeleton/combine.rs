//! One skeleton out of the joints of several scans.

use super::functional::{self, Centre};
use super::json::{FORMAT, LENGTH_MAX_MM, LIST_MAX, POSITION_MAX_MM, TEXT_MAX, round};
use super::names::{BONES, joint_name, joints};
use super::stature::stature;
use super::{Bone, Method, ScanJoints, Skeleton, SkeletonJoint};
use crate::geometry::{distance, scale};
use crate::{Estimate, Joint, Joints, Side};

/// What no joint is known better than, in millimetres: scans are of skin. It keeps a scan that is too sure of itself from
/// outweighing the others.
const FLOOR_MM: f64 = 1.0;

/// Bones: two joints in one place are none, and nobody has longer ones.
const LENGTHS_MM: std::ops::RangeInclusive<f64> = FLOOR_MM..=LENGTH_MAX_MM;

/// How much longer the longest of a limb's lengths is than the shortest in all poses of one person, at most, as a part:
/// measured were 0.07 of thighs and shanks, and 0.14 of upper arms and forearms.
const APART_MOST: [(&str, f64); 4] =
    [("thigh", 0.09), ("shank", 0.09), ("upper_arm", 0.16), ("forearm", 0.16)];

pub(super) fn combine(method: Method, scans: &[ScanJoints]) -> Option<Skeleton> {
    let mut in_mm: Vec<Joints> = scans.iter().take(LIST_MAX).map(millimetres).collect();
    let mut notes: Vec<String> = scans.iter().flat_map(|scan| scan.notes.iter().cloned()).collect();
    let found: usize = scans.iter().map(|scan| scan.joints.estimates.len()).sum();
    let usable: usize = in_mm.iter().map(|joints| joints.estimates.len()).sum();
    if usable < found {
        notes.push(format!("{} joints have no position that can be written", found - usable));
    }
    let sides_told = in_mm.iter().all(|joints| joints.sides_told);
    let centres = functional::centres(&in_mm, &mut notes);
    let first = in_mm.first()?.clone();
    let mut bones: Vec<Bone> = Vec::new();
    for (name, parent, child) in BONES {
        let of_scan = |joints: &Joints| length(joints, parent, child);
        let (lengths, odd): (Vec<_>, Vec<_>) =
            in_mm.iter().filter_map(of_scan).partition(|(mm, _)| LENGTHS_MM.contains(mm));
        if let Some((mm, _)) = odd.first() {
            notes.push(format!("{name}: {mm:.0} mm is no length of a body: left out"));
        }
        // A bone without its ends in the first scan could not be drawn.
        if lengths.is_empty() || length(&first, parent, child).is_none() {
            continue;
        }
        let mut bone = mean_bone(name, parent, child, &lengths);
        if let Some(centre) = centres.iter().find(|centre| centre.child == child) {
            bone.length_mm = round(centre.radius);
            bone.uncertainty_mm = round(centre.radius_sigma);
        }
        let most = APART_MOST.iter().find(|(limb, _)| name.ends_with(limb)).map(|(_, most)| *most);
        if let Some(apart) = apart(&lengths).filter(|apart| most.is_some_and(|most| *apart > most))
        {
            let why = "they are of several people, or a joint is wrong in one of them";
            notes.push(format!(
                "{name}: {:.0} % longer in one scan than in another: {why}",
                100.0 * apart
            ));
        }
        bones.push(bone);
    }
    if in_mm.len() > 1 && !sides_told {
        notes.push("left and right are not told in every scan: each pair of limbs has the mean of both sides".to_owned());
        level_sides(&mut bones);
    }
    // The surest scan has the most weight in every bone.
    let size_sigma = in_mm.iter().map(|joints| joints.size_sigma).fold(f64::INFINITY, f64::min);
    let stature = stature(&bones, size_sigma).filter(|_| method == Method::Default);
    let joints = skeleton_joints(in_mm.first_mut()?, &centres);
    notes.iter_mut().for_each(|note| *note = note.chars().take(TEXT_MAX).collect());
    notes.retain(|note| !note.is_empty());
    notes.truncate(LIST_MAX);
    let sources = scans.iter().take(LIST_MAX).map(|scan| scan.source.clone()).collect();
    let format = FORMAT.to_owned();
    Some(Skeleton {
        format,
        version: 1,
        method,
        sources,
        stature_mm: stature.map(|(mm, _)| round(mm)),
        stature_uncertainty_mm: stature.map(|(_, mm)| round(mm)),
        sides_told,
        joints,
        bones,
        notes,
    })
}

fn millimetres(scan: &ScanJoints) -> Joints {
    let mm = scan.unit.mm();
    let convert = |(joint, estimate): (&Joint, &Estimate)| {
        let position = scale(estimate.position, mm);
        (*joint, Estimate { position, sigma: (estimate.sigma * mm).clamp(0.0, LENGTH_MAX_MM) })
    };
    let usable = |(_, estimate): &(Joint, Estimate)| {
        estimate.position.iter().all(|mm| mm.abs() <= POSITION_MAX_MM) && !estimate.sigma.is_nan()
    };
    let estimates = scan.joints.estimates.iter().map(convert).filter(usable).collect();
    Joints { estimates, ..scan.joints.clone() }
}

/// Distance of two joints, and its standard deviation.
fn length(joints: &Joints, parent: Joint, child: Joint) -> Option<(f64, f64)> {
    let (a, b) = (joints.estimates.get(&parent)?, joints.estimates.get(&child)?);
    // Of an error in all directions, a third of the square lies along the bone.
    let sigma = (a.sigma.powi(2) + b.sigma.powi(2)).sqrt() / 3_f64.sqrt();
    let length = distance(a.position, b.position);
    Some((length, sigma.max(FLOOR_MM).hypot(joints.size_sigma * length)))
}

/// How much longer the longest is than the shortest.
fn apart(lengths: &[(f64, f64)]) -> Option<f64> {
    let mm = || lengths.iter().map(|(mm, _)| *mm);
    let (least, most) = (mm().min_by(f64::total_cmp)?, mm().max_by(f64::total_cmp)?);
    Some(most / least - 1.0)
}

fn mean_bone(name: &str, parent: Joint, child: Joint, lengths: &[(f64, f64)]) -> Bone {
    let n = lengths.len() as f64;
    let weight: f64 = lengths.iter().map(|(_, sigma)| sigma.powi(-2)).sum();
    let mean = lengths.iter().map(|(mm, sigma)| mm * sigma.powi(-2)).sum::<f64>() / weight;
    let plain = lengths.iter().map(|(mm, _)| mm).sum::<f64>() / n;
    let squares: f64 = lengths.iter().map(|(mm, _)| (mm - plain).powi(2)).sum();
    let spread = (lengths.len() > 1).then(|| (squares / (n - 1.0)).sqrt());
    // What is expected, or what was seen between scans, whichever is more.
    let uncertainty = weight.powf(-0.5).max(spread.unwrap_or(0.0) / n.sqrt());
    Bone {
        name: name.to_owned(),
        parent: joint_name(parent).to_owned(),
        child: joint_name(child).to_owned(),
        length_mm: round(mean),
        uncertainty_mm: round(uncertainty),
        spread_mm: spread.map(round),
        scans: lengths.len() as u32,
    }
}

/// Both bones of a pair become their mean.
fn level_sides(bones: &mut [Bone]) {
    let other = |name: &str| {
        let (side, rest) = super::names::pair(name)?;
        Some(format!("{}_{rest}", if side == 'l' { 'r' } else { 'l' }))
    };
    let sided = |name: &str| {
        other(name).or_else(|| match name {
            "throat_l_shoulder" => Some("throat_r_shoulder".to_owned()),
            "throat_r_shoulder" => Some("throat_l_shoulder".to_owned()),
            "pelvis_l_hip" => Some("pelvis_r_hip".to_owned()),
            "pelvis_r_hip" => Some("pelvis_l_hip".to_owned()),
            _ => None,
        })
    };
    let before = bones.to_vec();
    for bone in bones {
        let twin = sided(&bone.name).and_then(|twin| before.iter().find(|b| b.name == twin));
        if let Some(twin) = twin {
            bone.length_mm = round((bone.length_mm + twin.length_mm) / 2.0);
            bone.uncertainty_mm = round(bone.uncertainty_mm.max(twin.uncertainty_mm));
            bone.spread_mm = bone.spread_mm.zip(twin.spread_mm).map(|(a, b)| a.max(b));
        }
    }
}

fn skeleton_joints(first: &mut Joints, centres: &[Centre]) -> Vec<SkeletonJoint> {
    for centre in centres {
        let estimate = Estimate { position: centre.in_first, sigma: centre.sigma };
        first.estimates.insert(centre.joint, estimate);
    }
    let found = joints().filter_map(|joint| Some((joint, first.estimates.get(&joint)?)));
    found
        .map(|(joint, estimate)| SkeletonJoint {
            name: joint_name(joint).to_owned(),
            position_mm: estimate.position.map(round),
            uncertainty_mm: round(estimate.sigma),
        })
        .collect()
}

/// Both sides.
pub(super) const SIDES: [Side; 2] = [Side::Left, Side::Right];

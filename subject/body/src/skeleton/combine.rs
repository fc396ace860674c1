//! Combination of several scans into one skeleton, with functional joint centres: the centres of rotation of limbs,
//! from several poses.
//!
//! In the frame of the trunk, the elbow moves on a sphere about the shoulder, and the knee on one about the hip. A
//! sphere fitted to several poses gives the centre, which no single surface shows.

use nalgebra::{Matrix4, Vector4};

use super::{
    BONES, Bone, BoneEnds, Length, Method, POSITION_MAX_MM, ScanJoints, Skeleton, SkeletonJoint,
    counterpart, joint_name, joints, round,
};
use crate::{
    Estimate, Joint, Joints, Side,
    mesh::{Point, axes, distance, mean, unit},
};

/// Longest bone: more than any person's trunk.
const LENGTH_MAX_MM: f64 = 2000.0;
/// Minimum number of scans.
const SCANS_MIN: usize = 3;
/// Minimum range of motion of the limb, in degrees.
const SWING_MIN_DEGREES: f64 = 40.0;
/// Minimum standard deviation of an elbow or knee in the frame of the trunk, in millimetres, since the trunk bends.
const FROM_TRUNK_SIGMA_MIN_MM: f64 = 8.0;
/// Iterations of the fit, which converges within five.
const STEPS: usize = 20;
/// A functional centre replaces the estimate of single scans if its standard deviation is smaller by this factor.
const GAIN: f64 = 0.8;

/// A functional centre.
#[derive(Debug)]
pub(super) struct Centre {
    /// Shoulder or hip.
    pub(super) joint: Joint,
    /// Elbow or knee.
    pub(super) child: Joint,
    /// Position in the frame of the first scan, in millimetres.
    in_first: Point,
    sigma: f64,
    /// Length of the bone.
    radius: Length,
}

/// The functional centres of shoulders and hips. `notes` record each result, or why there is none.
pub(super) fn centres(scans: &[Joints], notes: &mut Vec<String>) -> Vec<Centre> {
    if scans.len() < 2 {
        return Vec::new();
    }
    if !scans.iter().all(|scan| scan.sides_told) {
        notes.push("no functional centres: left and right are unknown in some scan".to_owned());
        return Vec::new();
    }
    let mut centres = Vec::new();
    for side in Side::BOTH {
        for (joint, child) in
            [(Joint::Shoulder(side), Joint::Elbow(side)), (Joint::Hip(side), Joint::Knee(side))]
        {
            let name = joint_name(joint);
            match centre(scans, joint, child) {
                Ok(centre) => {
                    notes.push(format!("{name}: centre of rotation of {}", joint_name(child)));
                    centres.push(centre);
                }
                Err(reason) => notes.push(format!("{name}: no functional centre, {reason}")),
            }
        }
    }
    centres
}

/// Frame of the trunk: origin at the throat, x to the left, y up the trunk, z forward.
struct Trunk {
    origin: Point,
    axes: [Point; 3],
}

impl Trunk {
    fn of(scan: &Joints) -> Option<Self> {
        let origin = scan.point(Joint::Throat)?;
        let [left, right] = Side::BOTH.map(|side| scan.point(Joint::Hip(side)));
        let (left, right) = left.zip(right)?;
        Some(Self { origin, axes: axes(origin - mean([left, right])?, left - right)? })
    }

    fn to_local(&self, p: Point) -> Point {
        self.axes.map(|axis| axis.dot(&(p - self.origin))).into()
    }

    fn to_world(&self, p: Point) -> Point {
        let [left, up, forward] = [0, 1, 2].map(|k| self.axes[k] * p[k]);
        self.origin + (left + (up + forward))
    }
}

/// A joint and its child in the frame of one scan's trunk.
struct JointPair {
    joint: LocatedJoint,
    child: LocatedJoint,
}

struct LocatedJoint {
    at: Point,
    sigma: f64,
}

fn centre(scans: &[Joints], joint: Joint, child: Joint) -> Result<Centre, String> {
    let first = scans.first().and_then(Trunk::of).ok_or("the first scan has no trunk")?;
    let pair = |scan: &Joints| {
        let trunk = Trunk::of(scan)?;
        let of = |joint: Joint| {
            let estimate = scan.estimates.get(&joint)?;
            let at = trunk.to_local(estimate.position.into());
            Some(LocatedJoint { at, sigma: estimate.sigma.hypot(FROM_TRUNK_SIGMA_MIN_MM) })
        };
        Some(JointPair { joint: of(joint)?, child: of(child)? })
    };
    let pairs: Vec<JointPair> = scans.iter().filter_map(pair).collect();
    if pairs.len() < SCANS_MIN {
        return Err(format!("{} scans show it, at least {SCANS_MIN} are needed", pairs.len()));
    }
    let n = pairs.len() as f64;
    let prior = mean(pairs.iter().map(|pair| pair.joint.at)).ok_or("no scan shows it")?;
    // Errors of the estimates are correlated between scans, so their mean is hardly better than one of them.
    let prior_sigma = pairs.iter().map(|pair| pair.joint.sigma).sum::<f64>() / n;
    let degrees = swing(&pairs, prior).to_degrees();
    if degrees < SWING_MIN_DEGREES {
        return Err(format!(
            "its range of motion is {degrees:.0} degrees, at least {SWING_MIN_DEGREES} are needed"
        ));
    }
    let fit = SphereFit::new(&pairs, prior, prior_sigma).ok_or("no sphere fits")?;
    if !(fit.radius.mm < LENGTH_MAX_MM && fit.radius.sigma_mm < fit.radius.mm) {
        return Err("no sphere of a limb's size fits".to_owned());
    }
    if fit.sigma > GAIN * prior_sigma {
        return Err("the poses lie almost in one plane".to_owned());
    }
    Ok(Centre {
        joint,
        child,
        in_first: first.to_world(fit.centre),
        sigma: fit.sigma,
        radius: fit.radius,
    })
}

/// Largest angle between two directions, in radians.
fn swing(pairs: &[JointPair], from: Point) -> f64 {
    let directions: Vec<Point> = pairs.iter().map(|pair| unit(pair.child.at - from)).collect();
    let pairs = directions
        .iter()
        .enumerate()
        .flat_map(|(i, a)| directions.iter().skip(i + 1).map(|b| a.dot(b).clamp(-1.0, 1.0).acos()));
    pairs.fold(0.0, f64::max)
}

/// A sphere through the child joints with a prior on its centre: Gauss-Newton least squares in centre and radius.
struct SphereFit {
    centre: Point,
    sigma: f64,
    radius: Length,
}

impl SphereFit {
    fn new(pairs: &[JointPair], prior: Point, prior_sigma: f64) -> Option<Self> {
        let n = pairs.len() as f64;
        let mut centre = prior;
        let mut radius = pairs.iter().map(|pair| distance(pair.child.at, prior)).sum::<f64>() / n;
        // Each of three directions has a third of the variance.
        let stiffness = 3.0 / prior_sigma.powi(2);
        let mut inverse = Matrix4::zeros();
        for _ in 0..STEPS {
            let offset = prior - centre;
            let mut normal =
                Matrix4::from_diagonal(&Vector4::new(stiffness, stiffness, stiffness, 0.0));
            let mut right = Vector4::new(offset[0], offset[1], offset[2], 0.0) * stiffness;
            for pair in pairs {
                let LocatedJoint { at, sigma } = pair.child;
                let toward = unit(centre - at);
                let row = Vector4::new(toward[0], toward[1], toward[2], -1.0);
                let weight = 3.0 / sigma.powi(2);
                normal += row * row.transpose() * weight;
                right += row * (weight * (radius - distance(centre, at)));
            }
            inverse = normal.try_inverse()?;
            let step: Vector4<f64> = inverse * right;
            centre += step.xyz();
            radius += step[3];
        }
        let sigma = (inverse[(0, 0)] + inverse[(1, 1)] + inverse[(2, 2)]).sqrt();
        let radius_sigma = inverse[(3, 3)].sqrt();
        let finite =
            sigma.is_finite() && radius.is_finite() && centre.iter().all(|c| c.is_finite());
        let radius = Length { mm: radius, sigma_mm: radius_sigma };
        (finite && radius.mm > 0.0).then_some(Self { centre, sigma, radius })
    }
}

/// Maximum number of sources, and of notes.
const LIST_MAX: usize = 100;
/// Maximum number of characters of a name or a note.
pub(super) const TEXT_MAX: usize = 300;
/// Plausible statures.
const STATURE_MM: std::ops::RangeInclusive<f64> = 300.0..=3000.0;

/// Minimum standard deviation of a length, in millimetres, since a scan shows only skin. It keeps an overconfident
/// scan from outweighing the others.
const LENGTH_SIGMA_MIN_MM: f64 = 1.0;

/// Plausible bone lengths: not zero, and no longer than in any person.
const LENGTHS_MM: std::ops::RangeInclusive<f64> = LENGTH_SIGMA_MIN_MM..=LENGTH_MAX_MM;

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
    let centres = centres(&in_mm, &mut notes);
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
    Some(Length { mm, sigma_mm: sigma.max(LENGTH_SIGMA_MIN_MM).hypot(joints.size_sigma * mm) })
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

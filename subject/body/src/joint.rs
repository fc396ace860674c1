//! Joint centres of a scan, with their standard deviations and their plausibility.
//!
//! Where limbs have fused, geodesic distances cut across the contact, and the resulting joints are anatomically
//! impossible: shoulders in the belly, a trunk twice as long as the legs. [`Plausibility`] compares lengths with the
//! length of a leg. These ratios hardly differ from person to person; a value far outside means a faulty scan, not an
//! unusual subject.

use std::{collections::BTreeMap, ops::RangeInclusive};

use super::{Mesh, Note, mesh::distance};
use crate::mesh::Point;

/// A side of the body. If left and right could not be determined ([`Joints::sides_told`]), one value still stands for
/// one side throughout, but which one is unknown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Side {
    /// The subject's left.
    Left,
    /// The subject's right.
    Right,
}

impl Side {
    /// Both sides.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];
}

/// The 15 sites of Shi et al. 2012 (doi 10.3969/j.issn.0372-2112.2012.01.021).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Joint {
    /// Top of the head.
    Head,
    /// Base of the neck.
    Throat,
    /// Midway between the hips.
    Pelvis,
    /// Glenohumeral joint.
    Shoulder(Side),
    /// Elbow, between upper arm and forearm.
    Elbow(Side),
    /// Wrist, between forearm and hand.
    Wrist(Side),
    /// Hip: centre of the femoral head.
    Hip(Side),
    /// Knee, between thigh and shank.
    Knee(Side),
    /// Ankle, between shank and foot.
    Ankle(Side),
}

/// The estimated position of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// x, y, z in the mesh's frame and unit.
    pub position: [f64; 3],
    /// Expected standard deviation of the distance to the true centre, in the mesh's unit.
    pub sigma: f64,
}

/// The joints of one scan, in the mesh's frame and unit.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Joints {
    /// The joints that were found.
    pub estimates: BTreeMap<Joint, Estimate>,
    /// Whether `Side::Left` is the subject's left. If false, the sides may be exchanged as a whole.
    pub sides_told: bool,
    /// Relative standard deviation common to all lengths, on top of each joint's own; 0 if the size of the body is not
    /// in doubt.
    pub size_sigma: f64,
}

impl Joints {
    /// The position of a joint.
    pub(crate) fn point(&self, joint: Joint) -> Option<Point> {
        self.estimates.get(&joint).map(|estimate| estimate.position.into())
    }
}

/// Ratio of throat-to-pelvis to thigh plus shank: 0.54 to 0.76 on bodies with free limbs, more on a child.
const TRUNK: RangeInclusive<f64> = 0.4..=1.2;
/// Ratio of throat-to-shoulder to the leg: 0.19 to 0.30, up to 0.385 on generated bodies of capsules.
const SHOULDER: RangeInclusive<f64> = 0.14..=0.40;
/// Ratio of upper arm plus forearm to the leg: 0.57 to 0.63, 0.68 by the table of Drillis and Contini 1966, from 0.48
/// on generated bodies.
const ARM: RangeInclusive<f64> = 0.475..=0.85;

/// Which joints are plausible.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Plausibility {
    /// All joints.
    Whole,
    /// All but shoulders and elbows: the arms are not where they were expected.
    WithoutArms,
    /// None: the lengths of trunk and legs contradict each other.
    Nothing,
}

impl Plausibility {
    /// Checks joints in any unit. Missing joints pass.
    #[must_use]
    pub fn of(joints: &Joints) -> Self {
        let Some(leg) = limb(joints, [Joint::Hip, Joint::Knee, Joint::Ankle]) else {
            return Self::Whole;
        };
        let fits = |length: Option<f64>, parts: RangeInclusive<f64>| {
            length.is_none_or(|length| parts.contains(&(length / leg)))
        };
        let shoulder =
            |side: Side| fits(between(joints, Joint::Throat, Joint::Shoulder(side)), SHOULDER);
        if !fits(between(joints, Joint::Throat, Joint::Pelvis), TRUNK) {
            return Self::Nothing;
        }
        let arm = limb(joints, [Joint::Shoulder, Joint::Elbow, Joint::Wrist]);
        let arms = fits(arm, ARM) && shoulder(Side::Left) && shoulder(Side::Right);
        if arms { Self::Whole } else { Self::WithoutArms }
    }
}

/// Length of a limb of three joints: the mean of both sides, or the one side that is complete.
fn limb(joints: &Joints, [root, middle, end]: [fn(Side) -> Joint; 3]) -> Option<f64> {
    let of = |side: Side| {
        Some(between(joints, root(side), middle(side))? + between(joints, middle(side), end(side))?)
    };
    match (of(Side::Left), of(Side::Right)) {
        (Some(left), Some(right)) => Some(f64::midpoint(left, right)),
        (one, other) => one.or(other),
    }
}

fn between(joints: &Joints, from: Joint, to: Joint) -> Option<f64> {
    Some(distance(joints.point(from)?, joints.point(to)?))
}

// Where limbs have fused with the trunk, as when a subject crouches with the arms around the knees, all geodesic
// distances are too short by the same factor. The body comes out too small and nothing in the distances shows it; its
// volume is unaffected.

/// Cube root of a body's volume over its body scale. An adult of 1.72 m and 24 kg/m^2 at a density of 1.0 has 0.241 of
/// stature, and stature is 0.98 of the scale.
const VOLUME_ROOT: f64 = 0.235;
/// In contact, a larger logarithmic excess over that ratio puts the size in doubt: 1.27 times the mean weight, a body
/// mass index above 30.
const STOUT_IN_CONTACT: f64 = 0.08;
/// Without a sign of contact: a body mass index above 50.
const STOUT: f64 = 0.25;

/// Relative amount by which the body may be taller than its geodesic distances say; none if its volume matches its
/// size.
pub(super) fn size_shortfall(mesh: &Mesh, scale: f64, in_contact: bool) -> Option<f64> {
    let stout = (mesh.volume().max(0.0).cbrt() / (scale * VOLUME_ROOT)).ln();
    let most = if in_contact { STOUT_IN_CONTACT } else { STOUT };
    // A stout body in contact may be stout or too short: nothing distinguishes the two.
    (stout > most).then_some(stout)
}

/// Widens the standard deviations of all joints for a body that may be taller by the factor `by`.
pub(super) fn widen_sigmas(joints: &mut Joints, scale: f64, by: f64) -> Note {
    joints.size_sigma = by;
    for (joint, Estimate { sigma, .. }) in &mut joints.estimates {
        *sigma = sigma.hypot(by * from_end(*joint) * scale);
    }
    let text = format!(
        "the body has more volume than people of its measured size, as where limbs have fused with the trunk: stature and \
         all lengths may be up to {:.0} % larger; scan with limbs apart",
        100.0 * by
    );
    Note::new("size-unsure", text)
}

/// Geodesic distance of a joint from the extremity it is measured from, in body scales: an error of the scale moves the
/// joint by that much.
fn from_end(joint: Joint) -> f64 {
    match joint {
        Joint::Head => 0.03,
        Joint::Wrist(_) => 0.10,
        Joint::Ankle(_) => 0.13,
        Joint::Throat => 0.20,
        Joint::Elbow(_) => 0.25,
        Joint::Knee(_) => 0.35,
        Joint::Shoulder(_) => 0.40,
        Joint::Hip(_) | Joint::Pelvis => 0.56,
    }
}

//! Whether joints lie as a body can have them, and whether a body is as tall as the ways along its surface say.
//!
//! Where limbs have grown together, distances lead across, and what is built upon them is no body's: shoulders in the
//! belly, a trunk twice as long as the legs. What is measured here are parts of the length of a leg, which hardly differ
//! from person to person: far from what they are, something is wrong with the scan, and not with the subject.

use std::ops::RangeInclusive;

use super::mesh::distance;
use super::{Estimate, Joint, Joints, Mesh, Note, Side};

/// Thigh and shank are one. From throat to pelvis: 0.54 to 0.76 on bodies whose limbs are free, more on a child.
const TRUNK: RangeInclusive<f64> = 0.4..=1.2;
/// From throat to shoulder: 0.19 to 0.30, and up to 0.385 on generated bodies of capsules.
const SHOULDER: RangeInclusive<f64> = 0.14..=0.40;
/// Upper arm and forearm: 0.57 to 0.63, 0.68 by the table of Drillis and Contini 1966, and from 0.48 on generated bodies.
const ARM: RangeInclusive<f64> = 0.475..=0.85;

/// What of a body's joints can be believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Plausibility {
    /// All of them.
    Whole,
    /// All but shoulders and elbows: the arms are not where they were looked for.
    WithoutArms,
    /// None: lengths of trunk and legs do not go together.
    Nothing,
}

impl Plausibility {
    /// Of joints in any unit; those that are missing are not doubted.
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

/// The length of a limb of three joints: the mean of both sides, or that of the one that has all three.
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

// Where limbs have grown together with the trunk, as of somebody who crouches with the arms around the knees, ways lead across
// and are too short, all of them together: the body comes out shorter than it is, and nothing in the ways shows it. Its volume
// is as it was.

/// The cube root of a body's volume over its body scale: of an adult of 1.72 m and 24 kg/m^2 at a density of 1.0, 0.241 of
/// stature, which is 0.98 of the scale.
const VOLUME_ROOT: f64 = 0.235;
/// In contact a body that is stouter than that by more, as a logarithm, is in doubt: by a weight of 1.27 times the mean, a
/// body mass index above 30.
const STOUT_IN_CONTACT: f64 = 0.08;
/// Without a sign of contact: a body mass index above 50.
const STOUT: f64 = 0.25;

/// By how much the body may be taller than its ways say, as a part of them; nothing where its volume is that of its size.
pub(super) fn size_shortfall(mesh: &Mesh, scale: f64, in_contact: bool) -> Option<f64> {
    let stout = (mesh.volume().max(0.0).cbrt() / (scale * VOLUME_ROOT)).ln();
    let most = if in_contact { STOUT_IN_CONTACT } else { STOUT };
    // A stout body in contact may be stout, or too short: nothing tells which.
    (stout > most).then_some(stout)
}

/// Makes the joints as unsure as a body is that may be taller by such a part.
pub(super) fn widen_sigmas(joints: &mut Joints, scale: f64, by: f64) -> Note {
    joints.size_sigma = by;
    for (joint, Estimate { sigma, .. }) in &mut joints.estimates {
        *sigma = sigma.hypot(by * from_end(*joint) * scale);
    }
    let text = format!(
        "the body is stouter than people of the size that its surface tells, as where limbs have grown together with the \
         trunk: it may be taller by {:.0} %, and all lengths with it; scan with limbs apart",
        100.0 * by
    );
    Note::new("size-unsure", text)
}

/// How far a joint is from the end that it is measured from, in body scales: so much of a wrong scale shows in its place.
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

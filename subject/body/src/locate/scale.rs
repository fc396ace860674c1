//! Body scale, independent of unit and pose, and detection of limbs that have fused, which shortens distances.

use super::section::{Sections, between};
use super::{FOOT, Fields};

/// Distance between the feet on an upright body, in body scales.
const FOOT_TO_FOOT: f64 = 1.09;
/// Sum of the distances between all ten pairs of extremities, in body scales.
pub(super) const ALL_PAIRS: f64 = 10.3;

/// Range of the ratio of both estimates on free bodies: the learned ones have 0.93 to 1.09.
const FREE_RATIO: [f64; 2] = [0.90, 1.13];
/// Beyond this ratio the distances are not those of one body.
const RATIO_MAX: f64 = 1.6;

/// The body scale and the agreement of its two estimates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BodyScale {
    /// Length in the mesh's unit: about the stature.
    pub(super) length: f64,
    /// Ratio of the estimate from the feet to that from all pairs: 1 if the limbs are free.
    pub(super) feet_to_all: f64,
}

impl BodyScale {
    /// The mean of two estimates, each a geodesic length divided by its value on a body of average build. The distance
    /// between the feet changes by 5 % with the pose, the sum over all pairs by 3 %; girth hardly affects either.
    ///
    /// Contact shortens distances and never lengthens them: if the estimates disagree, the longer counts.
    ///
    /// None if an extremity is unreachable, two coincide, or the estimates are not those of a body.
    pub(super) fn new(fields: &Fields<'_>) -> Option<Self> {
        let feet = fields.between(FOOT[0], FOOT[1])? / FOOT_TO_FOOT;
        let all = fields.pairwise().map(|d| Some(d.filter(|d| *d > 0.0)? / ALL_PAIRS));
        let all = all.sum::<Option<f64>>()?;
        let feet_to_all = feet / all;
        let found = Self { length: f64::midpoint(feet, all), feet_to_all };
        let length = if found.disagrees() { feet.max(all) } else { found.length };
        let is_body = (1.0 / RATIO_MAX..RATIO_MAX).contains(&feet_to_all) && length.is_finite();
        is_body.then_some(Self { length, feet_to_all })
    }

    /// Whether some distances are too short for the others.
    pub(super) fn disagrees(self) -> bool {
        !(FREE_RATIO[0]..=FREE_RATIO[1]).contains(&self.feet_to_all)
    }
}

/// Largest ratio of an arm's longest curve to its shortest, without hand and armpit: free bodies that were learned
/// from, stout builds included, have at most 2.7.
const ARM_MAX: f64 = 4.0;
/// Largest ratio of a leg's longest curve to its shortest, without foot and groin: at most 2.5, and 3.2 on squatting
/// generated bodies of capsules.
const LEG_MAX: f64 = 3.4;
/// Levels of the arm's longest and shortest curve, in body scales.
const ARM: [[f64; 2]; 2] = [[0.17, 0.33], [0.12, 0.25]];
/// Levels of the leg's longest and shortest curve, in body scales.
const LEG: [[f64; 2]; 2] = [[0.20, 0.50], [0.17, 0.30]];

/// Limbs in contact, whose joints are uncertain.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Touching {
    /// Left and right arm.
    pub arms: [bool; 2],
    /// Left and right leg: both or neither.
    pub legs: [bool; 2],
    /// Whether some geodesic distance is too short, so the body scale and every joint are in doubt.
    pub scale: bool,
}

impl Touching {
    /// From the curves of each limb; none for a cut limb.
    pub(super) fn new(
        scale: BodyScale,
        arms: [Option<&Sections>; 2],
        legs: [Option<&Sections>; 2],
    ) -> Self {
        // Only the distance between the feet can be too short for all others if the feet touch. If it is too long for
        // them, the others cross arms.
        let feet = scale.disagrees() && scale.feet_to_all < 1.0;
        let across = scale.disagrees() && !feet;
        Self {
            arms: arms.map(|arm| across || arm.is_some_and(|arm| widening(arm, ARM) > ARM_MAX)),
            // A leg most often touches the other one.
            legs: [feet || legs.into_iter().flatten().any(|leg| widening(leg, LEG) > LEG_MAX); 2],
            scale: scale.disagrees(),
        }
    }

    /// Whether anything is in doubt.
    #[must_use]
    pub fn any(&self) -> bool {
        self.scale || self.arms.contains(&true) || self.legs.contains(&true)
    }
}

/// Ratio of the longest curve within some levels to the shortest within others.
fn widening(limb: &Sections, [longest, shortest]: [[f64; 2]; 2]) -> f64 {
    let lengths = |levels| between(&limb.perimeter, levels).map(|(_, length)| length);
    let most = lengths(longest).fold(0.0, f64::max);
    most / lengths(shortest).fold(f64::INFINITY, f64::min).max(f64::MIN_POSITIVE)
}

//! How large the body is, in no unit and whatever the pose; and where limbs have grown together, which makes ways too short.

use super::section::{Sections, between};
use super::{FOOT, Fields};

/// How long, in body scales, the way between the feet is on an upright body.
const FOOT_TO_FOOT: f64 = 1.09;
/// How long all ways between two of the five ends are together, each counted once.
pub(super) const ALL_PAIRS: f64 = 10.3;

/// The two lengths say the same to within this on free bodies: those that were learned from have 0.93 to 1.09.
const FREE_RATIO: [f64; 2] = [0.90, 1.13];
/// Beyond this they are no ways of one body.
const RATIO_MAX: f64 = 1.6;

/// The body scale, and what is told by how it came out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BodyScale {
    /// In the mesh's unit: about the stature.
    pub(super) length: f64,
    /// The way between the feet over all ways, each in the scale that it gives: 1 on a body whose limbs are free.
    pub(super) feet_to_all: f64,
}

impl BodyScale {
    /// The mean of two lengths of the surface, each divided by what it is to the stature on a body of average build. The way
    /// between the feet changes by 5 % with the pose, the sum of all ten ways by 3 %, and both hardly with the girth.
    ///
    /// Where limbs touch, ways become shorter and never longer: if the two disagree, the longer counts.
    ///
    /// Nothing where an end cannot be reached from another, two are the same, or the two lengths are no body's.
    pub(super) fn new(fields: &Fields<'_>) -> Option<Self> {
        let feet = fields.between(FOOT[0], FOOT[1])? / FOOT_TO_FOOT;
        let all = fields.pairwise().map(|way| Some(way.filter(|way| *way > 0.0)? / ALL_PAIRS));
        let all = all.sum::<Option<f64>>()?;
        let feet_to_all = feet / all;
        let found = Self { length: f64::midpoint(feet, all), feet_to_all };
        let length = if found.disagrees() { feet.max(all) } else { found.length };
        let is_body = (1.0 / RATIO_MAX..RATIO_MAX).contains(&feet_to_all) && length.is_finite();
        is_body.then_some(Self { length, feet_to_all })
    }

    /// Whether some of the ways are too short for the others.
    pub(super) fn disagrees(self) -> bool {
        !(FREE_RATIO[0]..=FREE_RATIO[1]).contains(&self.feet_to_all)
    }
}

/// The longest curve of an arm over its shortest, hand and armpit left out: on free bodies that were learned from, the
/// stoutest builds of them included, 2.7 at most.
const ARM_MOST: f64 = 4.0;
/// The same of a leg, foot and groin left out: 2.5 at most, and 3.2 on generated bodies of capsules that squat.
const LEG_MOST: f64 = 3.4;
/// Levels of the arm among which the longest curve is looked for, in body scales, and the shortest.
const ARM: [[f64; 2]; 2] = [[0.17, 0.33], [0.12, 0.25]];
/// Levels of the leg.
const LEG: [[f64; 2]; 2] = [[0.20, 0.50], [0.17, 0.30]];

/// What cannot be told well, because it touches something.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Touching {
    /// The arm on either side.
    pub arms: [bool; 2],
    /// The leg on either side; both or none.
    pub legs: [bool; 2],
    /// Some way along the surface is too short, so that the body scale is in doubt, and every joint with it.
    pub scale: bool,
}

impl Touching {
    /// By the curves round each limb; none of one that ends early.
    pub(super) fn new(
        scale: BodyScale,
        arms: [Option<&Sections>; 2],
        legs: [Option<&Sections>; 2],
    ) -> Self {
        // Only feet that are too near to each other make the way between them too short for all others; and where it is too
        // long for them, the others lead across arms.
        let feet = scale.disagrees() && scale.feet_to_all < 1.0;
        let across = scale.disagrees() && !feet;
        Self {
            arms: arms.map(|arm| across || arm.is_some_and(|arm| widening(arm, ARM) > ARM_MOST)),
            // What one leg touches is most often the other.
            legs: [feet || legs.into_iter().flatten().any(|leg| widening(leg, LEG) > LEG_MOST); 2],
            scale: scale.disagrees(),
        }
    }

    /// Whether anything is in doubt.
    #[must_use]
    pub fn any(&self) -> bool {
        self.scale || self.arms.contains(&true) || self.legs.contains(&true)
    }
}

/// The longest curve within some levels over the shortest within others.
fn widening(limb: &Sections, [longest, shortest]: [[f64; 2]; 2]) -> f64 {
    let lengths = |levels| between(&limb.perimeter, levels).map(|(_, length)| length);
    let most = lengths(longest).fold(0.0, f64::max);
    most / lengths(shortest).fold(f64::INFINITY, f64::min).max(f64::MIN_POSITIVE)
}

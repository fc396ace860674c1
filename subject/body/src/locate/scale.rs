//! How large the body is, in no unit and whatever the pose.

use super::{FOOT, Fields};

/// How long, in body scales, the way between the feet is on an upright body.
const FEET: f64 = 1.09;
/// How long all ways between two of the five ends are together, each counted once.
const ALL: f64 = 10.3;

/// The two lengths say the same to within this on free bodies: those that were learned from have 0.93 to 1.09.
const SAME: [f64; 2] = [0.90, 1.13];
/// Beyond this they are no ways of one body.
const MOST_APART: f64 = 1.6;

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
        let feet = fields.between(FOOT[0], FOOT[1])? / FEET;
        let mut all = 0.0;
        for one in 0..5 {
            for other in 0..one {
                all += fields.between(one, other).filter(|way| *way > 0.0)? / ALL;
            }
        }
        let feet_to_all = feet / all;
        let found = Self { length: f64::midpoint(feet, all), feet_to_all };
        let length = if found.disagrees() { feet.max(all) } else { found.length };
        let is_body = (1.0 / MOST_APART..MOST_APART).contains(&feet_to_all) && length.is_finite();
        is_body.then_some(Self { length, feet_to_all })
    }

    /// Whether some of the ways are too short for the others.
    pub(super) fn disagrees(self) -> bool {
        !(SAME[0]..=SAME[1]).contains(&self.feet_to_all)
    }
}

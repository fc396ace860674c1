//! Where limbs have grown together: the level-set curves of one then go round another too.

use super::scale::BodyScale;
use super::section::{Sections, level};

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
    let within = |[low, high]: [f64; 2]| {
        let curves = limb.perimeter.iter().enumerate();
        curves.filter(move |(at, _)| (low..high).contains(&level(*at))).map(|(_, length)| *length)
    };
    let most = within(longest).fold(0.0, f64::max);
    most / within(shortest).fold(f64::INFINITY, f64::min).max(f64::MIN_POSITIVE)
}

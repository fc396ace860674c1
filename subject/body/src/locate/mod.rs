//! Joint centres from the shape of a body's surface and the distances along it: the default method.
//!
//! What (Yu et al. 2008) begins with one distance field from the head, this does with five, one from each end of the body:
//! near a limb's own end the level-set curves go straight round the limb, whatever the pose.
//!
//! 1. [`refine_ends`]: the ends are brought to where they are on every body.
//! 2. The level-set curves of each field, and along each limb the marks that every limb has: the end of the hand,
//!    the widening into the trunk, the bend of the centre line.
//! 3. [`Landmarks`]: the middles of curves at fixed places between the marks.
//! 4. A joint is a weighted mean of landmarks. The weights add up to one, so that the joint moves, turns and grows with
//!    the body; `benches/subject/learn.py` learned them.
//! 5. Bones of the two sides are brought to one length, and that towards the average body's.
//! 6. Left and right, by the feet.

mod fields;
mod joints;
mod landmark;
mod limb;
mod missing;
mod model;
mod scale;
mod section;
#[cfg(test)]
mod tests;

pub use fields::{FOOT, Fields, HAND, HEAD, RefinedEnds, refine_ends};
pub use joints::joints;
pub use landmark::{ARM_LANDMARKS, HEAD_LANDMARKS, Half, LEG_LANDMARKS, Landmarks};
pub use missing::Neck;
pub use scale::Touching;
pub use section::Sections;

//! The default method: joint centres from the shape of a body's surface and the geodesic distances along it.
//!
//! (Yu et al. 2008) cut the body by one distance field, from the head. This method uses five, one from each extremity:
//! near its own end a limb is cut straight across, in any pose.
//!
//! 1. [`refine_ends`] moves the extremities to places that exist on every body.
//! 2. The level-set curves of each field give marks along every limb: the end of the hand, the widening into the trunk,
//!    the bend of the centre line.
//! 3. [`Landmarks`] are the centres of curves at fixed places between the marks.
//! 4. A joint is a weighted mean of landmarks. The weights add up to one, so the joint moves, turns and grows with the
//!    body; `benches/subject/learn.py` learned them.
//! 5. Bones of the two sides are given one length, and the upper ones are drawn towards the average body's.
//! 6. The feet determine left and right.

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

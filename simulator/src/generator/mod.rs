//! A standing long jump, generated: the motion of Shi et al. 2012 without their data.
//!
//! Axes: x forward at the start, y left, z up; the floor is z = 0. Joint curves are keyed (`plan`), legs are
//! bent onto planted feet (`body`), flight is a parabola, and the subject walks back, so that a take of any
//! length stays in a volume of about 6 m. Nothing depends on the machine: a seed gives the same bits everywhere.

mod body;
mod geometry;
mod plan;
mod rng;
mod spec;
mod subject;
mod trial;

#[cfg(test)]
mod tests;

use mocapd_take::motion::Motion;
pub use mocapd_take::phase::Phase;

pub use body::{BONES, SITES};
pub use rng::Rng;
pub use spec::{
    GenerateError, JumpSet, JumpSpec, MARKERS_MAX, Occlusion, RATE_HZ, SAMPLES_MAX, SUBJECTS_MAX,
    SetJump, TRIALS_MAX,
};

/// A generated take, and what happens in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Jump {
    /// The samples, millimetres, z up.
    pub motion: Motion,
    /// Each phase and its first frame, in order; a phase too short for a frame is left out.
    pub phases: Vec<(Phase, usize)>,
}

//! Generates standing long jumps: the motion of Shi et al. 2012 without their data.
//!
//! Axes: x forward at the start, y left, z up; the floor is z = 0. Joint angles follow keyframed curves (`plan`),
//! inverse kinematics place the legs on planted feet (`body`), and flight is a parabola. The subject walks back after
//! each jump, so a take of any length stays in a volume of about 6 m. A seed gives the same bits on every machine.

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

/// A generated motion and its phases.
#[derive(Debug, Clone, PartialEq)]
pub struct Jump {
    /// The motion, millimetres, z up.
    pub motion: Motion,
    /// Each phase and its first frame, in order; a phase shorter than a frame is omitted.
    pub phases: Vec<(Phase, usize)>,
}

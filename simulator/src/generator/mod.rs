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

pub use body::{BONES, SITES};
pub use rng::Rng;
pub use spec::{
    GenerateError, JumpSet, JumpSpec, MARKERS_MAX, Occlusion, RATE_HZ, SAMPLES_MAX, SUBJECTS_MAX,
    TRIALS_MAX,
};

/// What part of a trial a frame belongs to, as Shi et al. 2012 divide it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Phase {
    /// Standing still before the first swing.
    Standing,
    /// Preparatory swings of the arms.
    Swings,
    /// The last swing back into the crouch, with its deliberate pause.
    LastSwing,
    /// From the crouch to leaving the ground.
    TakeOff,
    /// From leaving the ground to touching it.
    Flight,
    /// Absorbing the landing and coming up.
    Settling,
    /// Slow walking.
    Walking,
}

impl Phase {
    /// In words, as tables print it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Standing => "standing",
            Self::Swings => "swings",
            Self::LastSwing => "last swing",
            Self::TakeOff => "take-off",
            Self::Flight => "flight-landing",
            Self::Settling => "settling",
            Self::Walking => "walking",
        }
    }
}

/// A generated take, and what happens in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Jump {
    /// The samples, millimetres, z up.
    pub motion: Motion,
    /// Each phase and its first frame, in order; a phase too short for a frame is left out.
    pub phases: Vec<(Phase, usize)>,
}

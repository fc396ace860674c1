//! Analysis of takes: plots, the study of (Shi et al. 2012), errors of velocities and accelerations, marker noise, and
//! limb lengths.
//!
//! This crate opens no file, prints nothing, reads no clock and starts no thread: callers pass in trajectories and the
//! bytes of takes, and get back text, tables and pictures.

pub mod column;
pub mod decoded;
pub mod derivative;
pub mod labels;
pub mod limbs;
pub mod noise;
pub mod phases;
pub mod plot;
pub mod study;
pub mod up;

/// Why an analysis failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// An argument is out of range; the message states the range.
    #[error("{0}")]
    InvalidArgument(String),
    /// The input has no data for this analysis.
    #[error("{0}")]
    Nothing(String),
    /// A take could not be read or written.
    #[error(transparent)]
    Take(#[from] mocapd_take::TakeError),
    /// The [`Coder`](study::Coder) failed, or its take does not match its input.
    #[error("{0}")]
    Coder(String),
    /// The drawing library failed.
    #[error("cannot draw: {0}")]
    Drawing(String),
}

//! What reads takes and draws or tabulates: pictures, the study of (Shi et al. 2012), and the errors that a
//! tolerance makes in velocities and accelerations.
//!
//! Nothing here opens a file, prints, reads a clock or starts a thread: trajectories and the bytes of takes come
//! from the caller, and text, tables and pictures go back.

pub mod coded;
pub mod column;
pub mod derivative;
pub mod labels;
pub mod limbs;
pub mod measures;
pub mod noise;
pub mod phases;
pub mod plot;
pub mod sites;
pub mod study;
pub mod up;

/// Why there is no report.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// What was asked for cannot be: the message says what can.
    #[error("{0}")]
    InvalidArgument(String),
    /// There is nothing to report on.
    #[error("{0}")]
    Nothing(String),
    /// A take could not be read or written.
    #[error(transparent)]
    Take(#[from] mocapd_take::TakeError),
    /// The coder refused.
    #[error("{0}")]
    Coder(String),
    /// The drawing library refused.
    #[error("cannot draw: {0}")]
    Drawing(String),
}

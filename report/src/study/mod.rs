//! The study of (Shi et al. 2012) again, on takes that are given: their two tables, what their measures leave
//! out, both readings of their second step, and the default resampler beside them.

mod measure;
mod options;
pub mod paper;
mod results;
pub mod tables;

pub use self::{
    measure::{EXHAUSTIVE_FRAMES_MAX, measure, work},
    options::{Coder, Method, Options, Piece, Trial},
    results::{Cell, Findings, Results, Sum},
};

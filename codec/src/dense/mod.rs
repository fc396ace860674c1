//! The smallest files: asynchronous dyadic cubic resampling of a group of channels, context-coded.
//!
//! docs/codec.md, `dense`, specifies it. From the ground up:
//!
//! - [`points`], fixed point, and the lattices that residuals lie on
//! - [`contexts`], what bits are expected by, and [`model`], their odds
//! - [`level_prediction`], where time puts the rows of a level; [`track`], what is known of a channel
//! - [`cross_channel`], what the residuals of other channels say; [`segment_lengths`] and [`distance_correction`],
//!   what the distances to other channels say
//! - [`first_row`] and [`residual`], the syntax of a row
//! - [`level`], the rows of one level; [`walk`], the order of all rows of a group
//! - [`candidates`], an encoder's choice among lattice points; [`encoder`] and [`decoder`]

mod candidates;
mod contexts;
mod cross_channel;
mod decoder;
mod distance_correction;
mod encoder;
mod first_row;
mod level;
mod level_prediction;
mod model;
mod points;
mod residual;
mod segment_lengths;
#[cfg(feature = "training")]
mod tally;
#[cfg(test)]
mod tests;
mod track;
mod walk;

pub(crate) use self::walk::Dense;

/// Rows of a span: its last row must be known before its first is final.
const SPAN: usize = 64;

/// Dyadic levels below the anchor: strides 32 to 1.
const LEVELS: usize = SPAN.ilog2() as usize;

/// The odds of a block that is stored raw as a whole, in 2^-16.
const STORED: u32 = 65536 - 8;

/// For the tool that makes the first odds.
#[cfg(feature = "training")]
pub mod training {
    pub use super::{encoder::tally, tally::Tally};
}

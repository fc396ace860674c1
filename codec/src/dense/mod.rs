//! `dense`: the resampler with the smallest blocks. docs/codec.md specifies its bits.
//!
//! # Method
//!
//! **Adaptive asynchronous sampling** (Shi et al., Adaptive asynchronous sampling based motion data compression, Acta
//! Electronica Sinica 40(1), 2012). Every channel keeps only the rows that its own motion needs, and the rows between
//! are interpolated. Shi et al. place spline knots freely. Here the rows lie on a dyadic grid: a block is cut into
//! spans of [`SPAN`] rows; the last row of a run in a span is its *anchor*, extrapolated in time; the rows of the
//! strides 32, 16, 8, 4, 2 and 1 follow, each predicted by a cubic through four decoded rows. A row whose prediction
//! lies inside the tolerance ball is not kept and costs one cheap decision; the ball has a volume of 4.19 cubed
//! tolerances, its inscribed cube only 1.54. A fixed grid needs no knot times, and residuals of different markers fall on the same rows, so
//! that one marker can predict another. In a prototype at 1 mm the grid coded about as many samples as a spline keeps
//! free knots, at 10.8 to 12.5 bits per sample in place of 15 to 20 per knot. Interpolation scales the quantisation
//! noise of the decoded rows by 0.8, a second difference by the square root of 6.
//!
//! **Prediction from other markers.** Markers of one body accelerate together: a residual is predicted from the
//! residuals of up to three earlier channels by least squares over running covariances, which start from a function of
//! the markers' distance as in kriging. Markers of one segment keep their distance: a row is moved along the lines to
//! up to three partners by a learnt share of the error in distance.
//!
//! **Lattice quantisation** (Conway and Sloane, Sphere packings, lattices and groups, chapter 4). The bound is a ball,
//! not a box, so residuals are vectors of a lattice whose covering radius is just below the tolerance: cubic where
//! residuals are short, body-centred cubic where they are long. The encoder takes, of the lattice points in the ball,
//! the cheapest by estimated bits, with a price on the distance where later rows depend on the point.
//!
//! **Context mixing** (the PAQ family; Mahoney, Adaptive weighing of context models for lossless data compression,
//! 2005). A residual is a series of binary decisions. One to three contexts estimate each from the residuals around it
//! in time and from the references; a mixer adds their logits with weights that adapt.
//!
//! **Range coding** (Martin, Range encoding, 1979) turns decisions and probabilities into bytes: [`crate::range`].
//!
//! Encoder and decoder run the same traversal over a [`RowCodec`](level::RowCodec), in integers and strictly ordered
//! IEEE arithmetic, so that both compute the same predictions on every machine.
//!
//! # Constants
//!
//! All constants but the encoder's prices in [`lattice`] belong to the frozen format. docs/codec.md lists what was
//! tried, measured on 18 recorded public takes (15 to 83 markers, 60 to 400 Hz) at six tolerances from 0.1 to 20 mm.
//! "Gain" in these modules is the change of the geometric mean of the ratio over all of them. A constant documented
//! without a derivation or a measurement has none on record.
//!
//! # Modules, each built on those before it
//!
//! - [`lattice`]: fixed-point positions, and the lattices of the residuals with the points around a sample
//! - [`contexts`]: the numbers of contexts and mixers; [`model`]: their probabilities and weights, and the cost of
//!   decisions
//! - [`level_prediction`]: prediction in time of anchors and levels; [`track`]: the state of one channel
//! - [`cross_channel`]: prediction from the residuals of reference channels; [`segment_lengths`] and
//!   [`distance_correction`]: prediction from the distances to partner channels
//! - [`row_syntax`]: the syntax of a row
//! - [`level`]: the rows of one level of one run; [`walk`]: the order of all rows of a group, and the decoder
//! - [`choice`]: the greedy choice of lattice points, and trials of other choices
//! - [`planner`]: choices by their later cost, and how far it looks ahead
//! - [`encoder`] makes blocks

mod choice;
mod contexts;
mod cross_channel;
mod distance_correction;
mod encoder;
mod lattice;
mod level;
mod level_prediction;
mod model;
mod planner;
mod row_syntax;
mod segment_lengths;
#[cfg(feature = "training")]
mod tally;
#[cfg(test)]
mod tests;
mod track;
mod walk;

pub use self::planner::Effort;
pub(crate) use self::{encoder::PlanningEncoder, walk::Dense};

/// Rows of a span. The last row of a span is coded before its first, so this is the latency of the decoder in rows.
/// 64 rows gain 0.6 to 1.2 % over 32; 16 rows lose 2.8 % and 128 lose 1.5 % against 64.
const SPAN: usize = 64;

/// Levels of a span between its anchors: the strides 32 to 1.
const LEVELS: usize = SPAN.ilog2() as usize;

/// Probability, in 2^-16, that a block is coded, not stored raw as a whole.
const P_CODED: u32 = 65536 - 8;

/// Statistics for the tool that makes the initial probabilities (`prior.bin`).
#[cfg(feature = "training")]
pub mod training {
    pub use super::{encoder::tally, tally::Tally};
}

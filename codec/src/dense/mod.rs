//! The smallest files: asynchronous dyadic cubic resampling of a group of channels, context-coded.
//!
//! docs/codec.md, `dense`, specifies it; [`walk`] is the order, [`row`] the syntax, [`weave`] and
//! [`lengths`] what the markers of a group say of one another.

mod ahead;
mod anchor;
mod choice;
mod classes;
mod code;
mod corners;
mod covary;
mod decoder;
mod encoder;
mod lattice;
mod layout;
mod lengths;
mod logistic;
mod model;
mod origin;
mod prior;
mod pulls;
mod row;
mod segments;
mod solve;
mod taps;
#[cfg(test)]
mod tests;
mod track;
#[cfg(feature = "training")]
pub mod training;
mod walk;
mod weave;

pub(crate) use self::{decoder::DenseDecoder, encoder::DenseEncoder};

/// Rows of a span: its last row must be known before its first is final.
const SPAN: usize = 64;

/// Dyadic levels below the anchor: strides 32 to 1.
const LEVELS: usize = SPAN.ilog2() as usize;

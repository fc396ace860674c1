//! Asynchronous dyadic cubic resampling, quantised inside the tolerance ball and context-coded.
//!
//! Each run of samples is coded in spans of up to 32 rows: the span's end first, then halving levels,
//! each row interpolated from rows already decoded. A row whose prediction lies inside the tolerance
//! ball is skipped: the rows that are not are the channel's own, adaptive sampling.

mod anchor;
mod decoder;
mod encoder;
mod grid;
mod model;
mod prior;
mod schedule;
mod walk;

pub(crate) use self::{decoder::DenseDecoder, encoder::DenseEncoder};

//! Parquet, written: a row a sample, or a row a frame.

mod file;
mod long;
mod wide;

pub(crate) use self::{long::write as write_long, wide::write as write_wide};

//! Integer coding that the resamplers share. All of it is exact, and bounded on hostile bytes.

pub(crate) mod bytes;
pub(crate) mod columns;
pub(crate) mod isa;
pub mod range;

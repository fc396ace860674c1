//! Byte and entropy coding that the resamplers share: exact integer arithmetic, bounded on hostile bytes.

pub(crate) mod bytes;
pub(crate) mod columns;
pub(crate) mod isa;
pub mod range;

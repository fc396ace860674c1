//! mocapd: records optical motion capture. The daemon's library: the `mocapd` binary, the tests and the
//! benchmarks are built on it.

pub mod ahead;
pub mod compare;
pub mod outcome;

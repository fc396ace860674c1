//! What the `mocapd` program shares with the tests: parallel decoding of a take ([`parallel_frames`]), sample-by-sample
//! comparison of two motions ([`compare`]), and exit codes ([`outcome`]).

pub mod compare;
pub mod outcome;
pub mod parallel_frames;

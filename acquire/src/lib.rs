//! From a device to a take: what reads a rig, resamples its markers and writes them.
//!
//! [`rig`] opens a device, reads it and finds it again when it was away. [`pipeline`] takes its frames through
//! lock-free rings and a pool of resamplers to a writer. [`record`] is both together for one take.

pub mod clock;
pub mod files;
pub mod header;
pub mod health;
pub mod heartbeat;
pub mod host_clock;
pub mod inspect;
pub mod latency;
pub mod ledger;
pub mod listing;
pub mod pipeline;
pub mod raw_log;
pub mod record;
pub mod rig;
pub mod setting;
pub mod threads;
pub mod verdict;

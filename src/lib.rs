//! mocapd: records optical motion capture. The daemon's library: the `mocapd` binary, the tests and the
//! benchmarks are built on it.

pub mod ahead;
pub mod clock;
pub mod compare;
pub mod config;
pub mod disk;
pub mod doctor;
#[cfg(feature = "fault-hooks")]
pub mod fault_hooks;
pub mod files;
pub mod header;
pub mod health;
pub mod heartbeat;
pub mod inspect;
mod latency;
pub mod listing;
pub mod local_time;
pub mod outcome;
pub mod pipeline;
pub mod process;
pub mod raw_log;
pub mod record;
pub mod rig;
pub mod service;
pub mod subject;
pub mod threads;
pub mod units;

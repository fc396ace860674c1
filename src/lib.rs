//! mocapd: records optical motion capture. The daemon's library: the `mocapd` binary, the tests and the
//! benchmarks are built on it.

pub mod ahead;
pub mod compare;
pub mod config;
pub mod doctor;
pub mod health;
pub mod inspect;
pub mod listing;
pub mod local_time;
pub mod outcome;
pub mod process;
pub mod service;
pub mod subject;
pub mod units;

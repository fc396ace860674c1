//! The service: between takes nobody watches a terminal.
//!
//! ```text
//! Control      what people and programs can ask for: status, arm, start, stop, mark
//!   ▲   ▲  ▲
//!   │   │  └── HTTP API, dashboard     threads of each listener, async; never touch the data plane
//!   │   └───── capture triggers        own threads
//!   └───────── signals, systemd
//! ```
//!
//! [`config`] is what it is told to do, [`engine`] does it, and [`doctor`] says what of the machine is in its way.

pub mod config;
pub mod control;
pub mod doctor;
pub mod engine;
pub mod http;
pub mod live;
pub mod log;
pub mod notify;
pub mod process;
pub mod status;
pub mod subject;
pub mod trigger;
pub mod triggered;
pub mod units;

//! The service: records takes unattended, under the control of an API, triggers and signals.
//!
//! ```text
//! Control      the requests of people and programs: status, arm, start, stop, mark
//!   ▲   ▲  ▲
//!   │   │  └── HTTP API, dashboard     threads of each listener, async; never touch the data plane
//!   │   └───── capture triggers        own threads
//!   └───────── signals, systemd
//! ```
//!
//! [`config`] configures it, [`engine`] runs it, and [`doctor`] checks whether the machine is fit for it.

pub mod config;
pub mod control;
pub mod doctor;
pub mod engine;
pub mod finished;
pub mod http;
pub mod live;
pub mod log;
pub mod notify;
pub mod page;
pub mod playback;
pub mod process;
pub mod publish;
pub mod status;
pub mod subject;
pub mod take_files;
pub mod take_name;
pub mod trigger;
pub mod triggered;
pub mod units;
pub mod viewer;

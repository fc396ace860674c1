//! The service: between takes nobody watches a terminal.
//!
//! ```text
//! Control      what people and programs can ask for: status, arm, start, stop, mark
//!   ▲   ▲  ▲
//!   │   │  └── HTTP API, dashboard     own thread, async; never touches the data plane
//!   │   └───── capture triggers        own thread
//!   └───────── signals, systemd
//! ```

pub mod bones;
pub mod control;
pub mod engine;
pub mod face;
pub mod http;
pub mod live;
pub mod log;
pub mod notify;
pub mod status;
pub mod trigger;
pub mod triggered;

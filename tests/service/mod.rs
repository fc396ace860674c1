//! The service: an engine with a simulated device on a line, and its API in front of a fake one.

mod ctl;
mod cycles;
pub(crate) mod engine;
pub(crate) mod fake;
pub(crate) mod http;
mod idle;
mod triggers;

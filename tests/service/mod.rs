//! The service: an engine and a simulated device on a line.

mod cycles;
pub(crate) mod engine;
mod triggers;

//! Tests of the service: the engine with a simulated device, and the API with a fake service.

mod ctl;
mod cycles;
pub(crate) mod engine;
pub(crate) mod fake;
mod finished;
pub(crate) mod http;
mod idle;
mod killed;
mod outputs;
mod publish;
mod publish_network;
mod timed;
mod triggers;

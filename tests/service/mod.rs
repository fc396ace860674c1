//! The service: an engine and a simulated device on a line.

mod engine;

//! QTM: the driver against our server, with time and bytes in the hands of the test.

#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod bodies;
mod bring_up;
mod hostile;
mod pair;
mod recorder;
mod samples;
mod settings;
mod stream;

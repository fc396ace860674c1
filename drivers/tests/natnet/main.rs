//! NatNet: goldens, bring-up, streams and hostile bytes, without a network.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]
#![expect(clippy::panic, reason = "a test fails by panicking")]

mod bring_up;
mod goldens;
mod hostile;
mod model;
mod pair;
mod stream;

//! The NDI driver against the simulated NDI system, on a line in virtual time: breaks, speeds, damage.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod bench;
mod bring_up;
mod damage;
mod frames;
mod strays;
mod sweeps;

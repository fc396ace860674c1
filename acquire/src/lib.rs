//! Acquisition: from a device to a take file.
//!
//! [`rig`] opens a device, reads it and reconnects to it. [`pipeline`] carries its frames through lock-free rings and a
//! pool of resampler threads to a writer. [`record`] combines both for a single take, [`series`] for a recording that is
//! divided into several. [`clock`] relates the device's
//! clock to the host's, [`ledger`] accounts for every frame, and [`inspect`] reads a take back.

pub mod clock;
pub mod files;
pub mod gaps;
pub mod header;
pub mod host_clock;
pub mod inspect;
pub mod ledger;
pub mod parallel_frames;
pub mod pipeline;
pub mod raw_log;
pub mod record;
pub mod rig;
pub mod series;
pub mod setting;
pub mod threads;

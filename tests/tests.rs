//! One integration binary with a module per topic.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test stops where it fails"
)]

mod cli;
mod kills;
mod messages;
mod parallel_frames;
mod phases;
mod pipeline;
mod recovery;
mod regression;
mod replay;
mod service;
mod support;
mod system;
mod take_file;

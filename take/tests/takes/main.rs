//! Takes as they are written and read: claims beyond the limits, orders of markers, still stretches, statistics, subjects, and
//! reading from the middle.

#![expect(clippy::unwrap_used, clippy::panic, reason = "a test stops there")]

mod bounds;
mod middle;
mod order;
mod statistics;
mod still;
mod subject;
#[path = "../sweeps/take.rs"]
mod take;

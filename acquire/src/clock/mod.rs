//! The device's clock against the host's: a line through what is known of both, laid as frames come.
//!
//! Two kinds of things are known. A frame cannot arrive before it happened: the device's clock showed its
//! ticks no later than its arrival. And when a ping was answered, the device's clock showed the pong's ticks
//! between the two host times. So each observation bounds the line from above or from below, however late
//! anything came, and the line is laid in the middle of what the bounds leave. docs/clock.md has the method.
//!
//! Sans-io: times and ticks go in. Nothing here allocates after it was made, or reads a clock.

mod fit;
mod model;
mod observations;
mod prober;
#[cfg(test)]
mod tests;

pub use fit::{Bound, Burst, Line, fit};
pub use model::{ClockEvent, ClockItem, ClockModel, ClockStatus, Store};
pub use observations::{Apart, LineAgain};
pub use prober::Prober;

/// What the line is made of is at most so old: over two minutes the oscillator of a device and that of a host
/// change their rate against each other by some hundredths of a ppm, 5 us.
const WINDOW_US: u64 = 120_000_000;

/// Seconds from `from` to `ticks`, modulo 2^64 as ticks are.
fn seconds(ticks: u64, from: u64, tick_hz: f64) -> f64 {
    ticks.wrapping_sub(from).cast_signed() as f64 / tick_hz
}

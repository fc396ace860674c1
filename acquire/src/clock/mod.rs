//! Relates the device's clock to the host's: a line fitted to observations of both, updated as frames come.
//!
//! There are two kinds of observations. A frame arrives after it was captured, so the device's clock showed its ticks
//! no later than its arrival. And when a ping is answered, the device's clock showed the pong's ticks between the two
//! host times. Each observation therefore bounds the line from above or from below, however late it came, and the
//! line is placed midway between the bounds. docs/clock.md describes the method.
//!
//! Sans-io: times and ticks are arguments. Nothing here reads a clock, or allocates after construction.

mod fit;
mod model;
mod observations;
mod prober;
#[cfg(test)]
mod tests;

pub use fit::{Bound, Burst, Line, fit};
pub use model::{ClockEvent, ClockItem, ClockModel, ClockStatus, StoreItem};
pub use observations::{LineDeviation, LineRefit};
pub use prober::Prober;

/// Longest age of an observation that the line is fitted to: over two minutes the oscillators of a device and of a host
/// change their relative rate by some hundredths of a ppm, 5 us.
const WINDOW_US: u64 = 120_000_000;

/// Seconds from `from` to `ticks`, modulo 2^64 as ticks are.
fn seconds(ticks: u64, from: u64, tick_hz: f64) -> f64 {
    ticks.wrapping_sub(from).cast_signed() as f64 / tick_hz
}

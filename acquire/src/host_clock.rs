//! The clock that stamps arrivals.

use rustix::time::{ClockId, clock_gettime};

/// The host's monotonic clock, in nanoseconds. A simulator on the same machine reads this clock too.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

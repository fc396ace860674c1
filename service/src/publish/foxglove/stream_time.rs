//! Times of messages: the device's clock, put into the calendar once.

use std::time::SystemTime;

use mocapd_acquire::host_clock::monotonic_ns;

/// How far the device's time may be from that of the host before the stream is put into the calendar anew: a clock that was
/// reset is off by more, while one that is wrong by 50 ppm needs two days.
const APART_MAX_NS: u64 = 10_000_000_000;

/// The times of a device's stream.
#[derive(Debug)]
pub(super) struct StreamTime {
    tick_hz: u64,
    /// A time by the device's clock in nanoseconds, and the same since 1970.
    anchor: Option<(u64, u64)>,
}

/// The time of the host, in nanoseconds since 1970.
pub(super) fn unix_now_ns() -> u64 {
    let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since_1970.as_nanos()).unwrap_or(u64::MAX)
}

/// When something arrived, in nanoseconds since 1970.
pub(super) fn unix_ns_of(arrival_ns: u64) -> u64 {
    unix_now_ns().saturating_sub(monotonic_ns().saturating_sub(arrival_ns))
}

impl StreamTime {
    pub(super) fn new(tick_hz: u64) -> Self {
        Self { tick_hz: tick_hz.max(1), anchor: None }
    }

    /// The time of something that arrived at `arrival_unix_ns`, in nanoseconds since 1970. Times differ as the device's clock
    /// says; what arrived first has the time of its arrival.
    pub(super) fn of(&mut self, device_ticks: u64, arrival_unix_ns: u64) -> u64 {
        let ns = u128::from(device_ticks) * 1_000_000_000 / u128::from(self.tick_hz);
        let device_ns = u64::try_from(ns).unwrap_or(u64::MAX);
        let (from_ns, unix_ns) = *self.anchor.get_or_insert((device_ns, arrival_unix_ns));
        let time_ns = unix_ns.wrapping_add(device_ns.wrapping_sub(from_ns));
        if time_ns.abs_diff(arrival_unix_ns) > APART_MAX_NS {
            self.anchor = Some((device_ns, arrival_unix_ns));
            return arrival_unix_ns;
        }
        time_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_follow_the_device_from_the_first_arrival_on() {
        let mut time = StreamTime::new(1_000_000);
        assert_eq!(time.of(500, 9_000_000_000), 9_000_000_000);
        assert_eq!(time.of(1500, 9_400_000_000), 9_001_000_000, "it arrived late");
        assert_eq!(time.of(400, 9_500_000_000), 8_999_900_000, "samples of before the first frame");
        // The device was switched off and on.
        assert_eq!(time.of(7, 99_000_000_000), 99_000_000_000);
        assert_eq!(time.of(1007, 99_000_500_000), 99_001_000_000);
    }
}

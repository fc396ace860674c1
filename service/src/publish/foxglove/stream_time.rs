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
    /// Whether it is that of a frame.
    is_by_frames: bool,
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
        Self { tick_hz: tick_hz.max(1), anchor: None, is_by_frames: false }
    }

    /// The time of a frame that arrived at `arrival_unix_ns`, in nanoseconds since 1970. Times differ as the device's clock says;
    /// the first has the time of its arrival. With it, whether times have jumped.
    pub(super) fn of_frame(&mut self, device_ticks: u64, arrival_unix_ns: u64) -> (u64, bool) {
        let device_ns = self.device_ns(device_ticks);
        self.is_by_frames = true;
        if let Some(time_ns) = self.near(device_ns, arrival_unix_ns) {
            return (time_ns, false);
        }
        let has_jumped = self.anchor.replace((device_ns, arrival_unix_ns)).is_some();
        (arrival_unix_ns, has_jumped)
    }

    /// The time of samples, of which the first was taken at about `taken_unix_ns`, on the time line of the frames. Without
    /// frames they make one.
    pub(super) fn of_samples(&mut self, device_ticks: u64, taken_unix_ns: u64) -> u64 {
        let device_ns = self.device_ns(device_ticks);
        if let Some(time_ns) = self.near(device_ns, taken_unix_ns) {
            return time_ns;
        }
        if !self.is_by_frames {
            self.anchor = Some((device_ns, taken_unix_ns));
        }
        // The samples have another clock than the frames.
        taken_unix_ns
    }

    fn device_ns(&self, ticks: u64) -> u64 {
        let ns = u128::from(ticks) * 1_000_000_000 / u128::from(self.tick_hz);
        u64::try_from(ns).unwrap_or(u64::MAX)
    }

    /// A time on the time line, if it is near that of the host.
    fn near(&self, device_ns: u64, host_ns: u64) -> Option<u64> {
        let (from_ns, unix_ns) = self.anchor?;
        let time_ns = unix_ns.wrapping_add(device_ns.wrapping_sub(from_ns));
        (time_ns.abs_diff(host_ns) <= APART_MAX_NS).then_some(time_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_follow_the_device_from_the_first_frame_on() {
        let mut time = StreamTime::new(1_000_000);
        assert_eq!(time.of_frame(500, 9_000_000_000), (9_000_000_000, false));
        assert_eq!(time.of_frame(1500, 9_400_000_000), (9_001_000_000, false), "it arrived late");
        assert_eq!(time.of_samples(400, 9_500_000_000), 8_999_900_000);
        // Samples with another clock than frames.
        assert_eq!(time.of_samples(90_000_000, 9_500_000_000), 9_500_000_000);
        assert_eq!(time.of_frame(2500, 9_500_000_000), (9_002_000_000, false));
        // The device was switched off and on.
        assert_eq!(time.of_frame(7, 99_000_000_000), (99_000_000_000, true));
        assert_eq!(time.of_frame(1007, 99_000_500_000), (99_001_000_000, false));
    }

    #[test]
    fn frames_go_on_with_the_times_of_samples_that_came_first() {
        let mut time = StreamTime::new(1_000_000);
        assert_eq!(time.of_samples(300, 8_000_000_000), 8_000_000_000);
        assert_eq!(time.of_frame(500, 8_003_000_000), (8_000_200_000, false));
        // Without frames, samples whose clock jumps begin anew.
        let mut time = StreamTime::new(1_000_000);
        assert_eq!(time.of_samples(300, 8_000_000_000), 8_000_000_000);
        assert_eq!(time.of_samples(90_000_300, 9_000_000_000), 9_000_000_000);
        assert_eq!(time.of_samples(90_000_400, 9_000_000_500), 9_000_100_000);
    }
}

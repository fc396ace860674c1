//! When something was captured, by the host's monotonic clock: of one device, from its own clock.

use mocapd_acquire::pipeline::{PipelineProgress, lock};
use mocapd_take::record::ClockLine;

use super::PublishedDevice;

/// How far the line may be from arrivals: a device's clock that was set, or began anew, is further off, and has a new line with
/// the next stretches.
const BELIEVED_NS: i64 = 1_000_000_000;

/// The times of one device.
#[derive(Debug)]
pub(super) struct HostTime {
    tick_hz: f64,
    /// The smallest difference between an arrival and the device's time so far, while there is no line.
    offset_ns: Option<i64>,
    last_ns: u64,
}

impl HostTime {
    pub(super) fn new(device: &PublishedDevice) -> Self {
        let tick_hz = device.header.device.as_ref().map_or(1_000_000, |device| device.tick_hz);
        Self { tick_hz: tick_hz.max(1) as f64, offset_ns: None, last_ns: 0 }
    }

    /// The device's clock in seconds.
    pub(super) fn device_s(&self, device_ticks: u64) -> f64 {
        device_ticks as f64 / self.tick_hz
    }

    /// When a frame was captured: by the recording's own line between the two clocks, and until there is one by the earliest
    /// arrivals. Later than the frame before.
    pub(super) fn of_frame(
        &mut self,
        device_ticks: u64,
        arrival_ns: u64,
        progress: &PipelineProgress,
    ) -> u64 {
        let captured_ns = self.of_ticks(device_ticks, arrival_ns, *lock(&progress.clock_line));
        let ahead_ns = self.last_ns.saturating_sub(captured_ns);
        // A refitted line may be some microseconds earlier.
        let is_step = ahead_ns < BELIEVED_NS.unsigned_abs();
        self.last_ns = if is_step { captured_ns.max(self.last_ns + 1) } else { captured_ns };
        self.last_ns
    }

    /// When a sample was taken that has just arrived.
    pub(super) fn of_sample(
        &mut self,
        device_ticks: u64,
        now_ns: u64,
        progress: &PipelineProgress,
    ) -> u64 {
        self.of_ticks(device_ticks, now_ns, *lock(&progress.clock_line))
    }

    fn of_ticks(&mut self, device_ticks: u64, arrival_ns: u64, line: Option<ClockLine>) -> u64 {
        let arrival = arrival_ns.cast_signed();
        let by_line = line.map(|line| {
            let ticks = device_ticks.wrapping_sub(line.device_ticks).cast_signed() as f64;
            let elapsed_ns = ticks / self.tick_hz * (1e9 + line.drift_ppb as f64);
            line.host_ns.cast_signed().saturating_add(elapsed_ns as i64)
        });
        let is_believed = |at: &i64| arrival.saturating_sub(*at).saturating_abs() < BELIEVED_NS;
        if let Some(at) = by_line.filter(is_believed) {
            return at.cast_unsigned();
        }
        let device_ns = (device_ticks as f64 / self.tick_hz * 1e9) as i64;
        let late_ns = arrival.saturating_sub(device_ns);
        let offset_ns = match self.offset_ns {
            Some(known) if known.abs_diff(late_ns) < BELIEVED_NS.unsigned_abs() => {
                known.min(late_ns)
            }
            _ => late_ns,
        };
        self.offset_ns = Some(offset_ns);
        device_ns.saturating_add(offset_ns).max(0).cast_unsigned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time() -> HostTime {
        HostTime { tick_hz: 1e6, offset_ns: None, last_ns: 0 }
    }

    const MS: u64 = 1_000_000;

    #[test]
    fn the_line_counts_once_there_is_one_and_arrivals_until_then() {
        let progress = PipelineProgress::default();
        let mut time = time();
        // Captured every 10 ms at 5 s of the device's clock, and 3 to 9 ms late.
        let mut of = |n: u64, late: u64| {
            let arrival_ns = 60_000 * MS + n * 10 * MS + late * MS;
            time.of_frame(5_000_000 + n * 10_000, arrival_ns, &progress)
        };
        assert_eq!(of(0, 9), 60_009 * MS);
        assert_eq!(of(1, 3), 60_013 * MS, "the earliest arrival so far counts");
        assert_eq!(of(2, 7), 60_023 * MS);
        let line = ClockLine {
            device_ticks: 5_000_000,
            host_ns: 60_001 * MS,
            drift_ppb: 1_000_000,
            ..ClockLine::default()
        };
        *lock(&progress.clock_line) = Some(line);
        assert_eq!(of(3, 9), 60_031 * MS + 30_000);
        // A device that was switched off and on: the line is of before.
        let at = time.of_frame(1000, 200_000 * MS, &progress);
        assert_eq!(at, 200_000 * MS);
    }

    #[test]
    fn frames_are_never_earlier_than_those_before_them() {
        let progress = PipelineProgress::default();
        let mut time = time();
        let line = ClockLine { device_ticks: 0, host_ns: 1000 * MS, ..ClockLine::default() };
        *lock(&progress.clock_line) = Some(line);
        let first = time.of_frame(10_000, 1015 * MS, &progress);
        let earlier = ClockLine { host_ns: 985 * MS, ..line };
        *lock(&progress.clock_line) = Some(earlier);
        assert_eq!(time.of_frame(11_000, 1016 * MS, &progress), first + 1);
        assert_eq!(time.of_frame(30_000, 1035 * MS, &progress), 1015 * MS);
    }
}

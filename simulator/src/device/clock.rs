//! The device's own clock: it starts at 0 and drifts.

use super::{DeviceError, SECOND_NS, TICK_HZ};

/// Largest drift, parts per million: a tenth.
const DRIFT_MAX_PPM: f64 = 100_000.0;

/// A drifting clock in integer arithmetic: rounding errors do not accumulate over time.
#[derive(Debug)]
pub(super) struct DeviceClock {
    /// Nanoseconds of the caller's clock per 10^9 of the device's.
    scale: u64,
    /// The caller's clock when the device's clock was 0.
    epoch_ns: Option<u64>,
}

impl DeviceClock {
    pub(super) fn new(drift_ppm: f64) -> Result<Self, DeviceError> {
        if !(-DRIFT_MAX_PPM..=DRIFT_MAX_PPM).contains(&drift_ppm) {
            return Err(DeviceError::Drift { found_ppm: drift_ppm });
        }
        let scale = SECOND_NS.saturating_add_signed((drift_ppm * 1e3).round() as i64);
        Ok(Self { scale, epoch_ns: None })
    }

    /// Starts the clock, unless it is running.
    pub(super) fn begin(&mut self, now_ns: u64) {
        self.epoch_ns.get_or_insert(now_ns);
    }

    /// Stops the clock until the next [`begin`](Self::begin), which starts it from 0.
    pub(super) fn reset(&mut self) {
        self.epoch_ns = None;
    }

    /// The device's time at the caller's time `at_ns`, in ticks.
    pub(super) fn ticks(&self, at_ns: u64) -> u64 {
        let since_ns = at_ns.saturating_sub(self.epoch_ns.unwrap_or(at_ns));
        let ticks = u128::from(since_ns) * u128::from(TICK_HZ) / u128::from(self.scale);
        u64::try_from(ticks).unwrap_or(u64::MAX)
    }

    /// The duration on the caller's clock of `device_ns` on the device's.
    pub(super) fn caller_ns(&self, device_ns: u64) -> u64 {
        let ns = u128::from(device_ns) * u128::from(self.scale) / u128::from(SECOND_NS);
        u64::try_from(ns).unwrap_or(u64::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_drifts_as_set() {
        let mut clock = DeviceClock::new(200.0).unwrap();
        assert_eq!(clock.ticks(77), 0, "not started");
        clock.begin(5_000);
        clock.begin(6_000);
        // After 5001 s on the host's clock it shows 5000 s.
        assert_eq!(clock.ticks(5_000 + 5_001 * SECOND_NS), 5_000 * TICK_HZ);
        assert_eq!(clock.caller_ns(5_000 * SECOND_NS), 5_001 * SECOND_NS);
        let gains = DeviceClock::new(-200.0).unwrap();
        assert_eq!(gains.caller_ns(5_000 * SECOND_NS), 4_999 * SECOND_NS);
        for found_ppm in [f64::NAN, f64::INFINITY, -100_001.0] {
            assert!(DeviceClock::new(found_ppm).is_err(), "{found_ppm}");
        }
    }
}

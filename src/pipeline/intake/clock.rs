//! A straight line through (device time, host arrival): offset, drift, residual.

use mocapd_take::record::ClockFit;

/// Least squares, updated frame by frame (running means and co-moments, so that hours lose no digits).
#[derive(Debug)]
pub(super) struct ClockLine {
    tick_hz: f64,
    origin: Option<(u64, u64)>,
    n: u64,
    mean_device_s: f64,
    mean_late_s: f64,
    m_device: f64,
    m_cross: f64,
    m_late: f64,
}

impl ClockLine {
    pub(super) fn new(tick_hz: u64) -> Self {
        Self {
            tick_hz: tick_hz.max(1) as f64,
            origin: None,
            n: 0,
            mean_device_s: 0.0,
            mean_late_s: 0.0,
            m_device: 0.0,
            m_cross: 0.0,
            m_late: 0.0,
        }
    }

    /// What was fitted so far is another clock's.
    pub(super) fn restart(&mut self) {
        *self = Self { tick_hz: self.tick_hz, ..Self::new(1) };
    }

    pub(super) fn add(&mut self, device_ticks: u64, arrival_ns: u64) {
        let (ticks, ns) = *self.origin.get_or_insert((device_ticks, arrival_ns));
        let device_s = device_ticks.wrapping_sub(ticks).cast_signed() as f64 / self.tick_hz;
        // What is fitted is the difference of the clocks: microseconds beside hours.
        let late_s = arrival_ns.wrapping_sub(ns).cast_signed() as f64 * 1e-9 - device_s;
        self.n += 1;
        let n = self.n as f64;
        let from_mean = device_s - self.mean_device_s;
        let late_from_mean = late_s - self.mean_late_s;
        self.mean_device_s += from_mean / n;
        self.mean_late_s += late_from_mean / n;
        self.m_device += from_mean * (device_s - self.mean_device_s);
        self.m_cross += from_mean * (late_s - self.mean_late_s);
        self.m_late += late_from_mean * (late_s - self.mean_late_s);
    }

    /// `None` before there are two different times.
    pub(super) fn fit(&self) -> Option<ClockFit> {
        let (ticks, ns) = self.origin?;
        if self.m_device <= 0.0 {
            return None;
        }
        let drift = self.m_cross / self.m_device;
        let late_at_origin_s = self.mean_late_s - drift * self.mean_device_s;
        let origin_s = ticks as f64 / self.tick_hz;
        let offset_ns = ns as f64 + (late_at_origin_s - origin_s * (1.0 + drift)) * 1e9;
        let residual = (self.m_late - drift * self.m_cross).max(0.0) / self.n as f64;
        Some(ClockFit {
            offset_ns: offset_ns as i64,
            drift_ppm: drift * 1e6,
            residual_us: residual.sqrt() * 1e6,
            n_fitted: self.n,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_a_drifting_clock_under_jitter() {
        let mut line = ClockLine::new(1_000_000);
        for i in 0..10_000_u64 {
            let ticks = 7_000_000 + i * 1_000;
            let jitter_ns = (i * 7_919) % 100_000;
            let ns = 5_000_000_000 + (i as f64 * 1e6 * (1.0 + 150e-6)) as u64 + jitter_ns;
            line.add(ticks, ns);
        }
        let fit = line.fit().unwrap();
        assert!((fit.drift_ppm - 150.0).abs() < 1.0, "{fit:?}");
        assert!((fit.residual_us - 28.87).abs() < 0.5, "{fit:?}");
        let expected = 5_000_050_000 - 7_000_000_000_i64 - 1_050_000;
        assert!((fit.offset_ns - expected).abs() < 10_000, "{fit:?}");
    }
}

//! Round trips, by bursts: of each the best bounds.

use mocapd_take::record::{ClockPoint, ClockProbe};

use super::{
    WINDOW_US,
    fit::{BURSTS_MAX, Burst},
    seconds,
};

/// Round trips that begin within this of the first one are a burst: eight take at most 0.2 s, and the next
/// burst begins a second later at the earliest.
const BURST_US: u64 = 500_000;

/// The bursts of a segment, oldest first.
#[derive(Debug)]
pub(super) struct Bursts {
    bursts: [Burst; BURSTS_MAX],
    n: usize,
}

impl Bursts {
    pub(super) fn new() -> Self {
        Self { bursts: [Burst::default(); BURSTS_MAX], n: 0 }
    }

    pub(super) fn all(&self) -> &[Burst] {
        &self.bursts[..self.n]
    }

    pub(super) fn add(&mut self, probe: ClockProbe, drift_ppm: f64, tick_hz: f64) {
        let ClockProbe { sent_us, device_ticks, round_trip_us } = probe;
        let low = ClockPoint { device_ticks, host_us: sent_us };
        let high = ClockPoint { device_ticks, host_us: sent_us.saturating_add(round_trip_us) };
        let later_us = |point: ClockPoint, than: ClockPoint| {
            let passed_s = seconds(point.device_ticks, than.device_ticks, tick_hz);
            point.host_us.wrapping_sub(than.host_us).cast_signed() as f64
                - passed_s * (1e6 + drift_ppm)
        };
        if let Some(last) = self.bursts[..self.n].last_mut()
            && sent_us.abs_diff(last.first_us) < BURST_US
        {
            let better_us = later_us(low, last.low);
            last.low_next_us = next_us(last.low_next_us, better_us);
            if better_us > 0.0 {
                last.low = low;
            }
            let better_us = -later_us(high, last.high);
            last.high_next_us = next_us(last.high_next_us, better_us);
            if better_us > 0.0 {
                last.high = high;
            }
            return;
        }
        let expired = |burst: &&Burst| burst.first_us.saturating_add(WINDOW_US) < sent_us;
        let old = self.all().iter().take_while(expired).count();
        self.forget(old.max(usize::from(self.n == BURSTS_MAX)));
        let [low_next_us, high_next_us] = [round_trip_us as f64; 2];
        self.bursts[self.n] = Burst { first_us: sent_us, low, high, low_next_us, high_next_us };
        self.n += 1;
    }

    /// The oldest ones no longer count.
    pub(super) fn forget(&mut self, n: usize) {
        self.bursts.copy_within(n..self.n, 0);
        self.n -= n;
    }
}

/// How far the second best is from the best, after another one that is better by so much, or worse.
fn next_us(next_us: f64, better_us: f64) -> f64 {
    if better_us > 0.0 { better_us } else { next_us.min(-better_us) }
}

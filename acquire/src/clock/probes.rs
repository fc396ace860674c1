//! Round trips, by bursts: of each the best bounds.

use mocapd_take::record::{ClockPoint, ClockProbe};

use super::{
    WINDOW_US,
    fit::{BURSTS_MAX, Burst},
    prober::PROBES,
    seconds,
};

/// Round trips that begin within this of the first one are a burst: eight take at most 0.2 s, and the next
/// burst begins a second later at the earliest.
const BURST_US: u64 = 500_000;

const PROBES_MAX: usize = PROBES as usize;

/// The bursts of a segment, oldest first, with all their round trips: which of these are the best depends on the rate
/// of the line, which is another one with each observation.
#[derive(Debug)]
pub(super) struct Bursts {
    bursts: [Trips; BURSTS_MAX],
    n: usize,
}

/// The round trips of a burst.
#[derive(Debug, Clone, Copy, Default)]
struct Trips {
    probes: [ClockProbe; PROBES_MAX],
    n: usize,
}

/// The best bounds of each burst, at some rate.
#[derive(Debug, Clone, Copy)]
pub(super) struct BestBounds {
    bursts: [Burst; BURSTS_MAX],
    n: usize,
}

impl BestBounds {
    pub(super) fn all(&self) -> &[Burst] {
        &self.bursts[..self.n]
    }

    /// Whether these are the same round trips.
    pub(super) fn are_of(&self, other: &Self) -> bool {
        let same = |(a, b): (&Burst, &Burst)| (a.low, a.high) == (b.low, b.high);
        self.n == other.n && self.all().iter().zip(other.all()).all(same)
    }
}

impl Bursts {
    pub(super) fn new() -> Self {
        Self { bursts: [Trips::default(); BURSTS_MAX], n: 0 }
    }

    pub(super) fn add(&mut self, probe: ClockProbe) {
        if let Some(last) = self.bursts[..self.n].last_mut()
            && last.n < PROBES_MAX
            && probe.sent_us.abs_diff(last.first_us()) < BURST_US
        {
            last.add(probe);
            return;
        }
        let expired = |trips: &&Trips| trips.first_us().saturating_add(WINDOW_US) < probe.sent_us;
        let old = self.bursts[..self.n].iter().take_while(expired).count();
        self.forget(old.max(usize::from(self.n == BURSTS_MAX)));
        self.bursts[self.n] = Trips::default();
        self.bursts[self.n].add(probe);
        self.n += 1;
    }

    /// The best bounds, when the host's clock runs faster by `drift_ppm`.
    pub(super) fn best(&self, drift_ppm: f64, tick_hz: f64) -> BestBounds {
        let mut best = BestBounds { bursts: [Burst::default(); BURSTS_MAX], n: self.n };
        for (burst, trips) in best.bursts.iter_mut().zip(&self.bursts[..self.n]) {
            *burst = trips.best(drift_ppm, tick_hz);
        }
        best
    }

    /// The oldest ones no longer count.
    fn forget(&mut self, n: usize) {
        self.bursts.copy_within(n..self.n, 0);
        self.n -= n;
    }
}

impl Trips {
    fn first_us(&self) -> u64 {
        self.probes[0].sent_us
    }

    fn add(&mut self, probe: ClockProbe) {
        self.probes[self.n] = probe;
        self.n += 1;
    }

    fn best(&self, drift_ppm: f64, tick_hz: f64) -> Burst {
        let later_us = |point: ClockPoint, than: ClockPoint| {
            let passed_s = seconds(point.device_ticks, than.device_ticks, tick_hz);
            point.host_us.wrapping_sub(than.host_us).cast_signed() as f64
                - passed_s * (1e6 + drift_ppm)
        };
        let bounds = self.probes[..self.n].iter().map(|probe| {
            let ClockProbe { sent_us, device_ticks, round_trip_us } = *probe;
            let low = ClockPoint { device_ticks, host_us: sent_us };
            (low, ClockPoint { host_us: sent_us.saturating_add(round_trip_us), ..low })
        });
        let trip_us = self.probes[0].round_trip_us as f64;
        let mut best = Burst::default();
        for (index, (low, high)) in bounds.enumerate() {
            if index == 0 {
                let first_us = low.host_us;
                best = Burst { first_us, low, high, low_next_us: trip_us, high_next_us: trip_us };
                continue;
            }
            let better_us = later_us(low, best.low);
            best.low_next_us = next_us(best.low_next_us, better_us);
            if better_us > 0.0 {
                best.low = low;
            }
            let better_us = -later_us(high, best.high);
            best.high_next_us = next_us(best.high_next_us, better_us);
            if better_us > 0.0 {
                best.high = high;
            }
        }
        best
    }
}

/// How far the second best is from the best, after another one that is better by so much, or worse.
fn next_us(next_us: f64, better_us: f64) -> f64 {
    if better_us > 0.0 { better_us } else { next_us.min(-better_us) }
}

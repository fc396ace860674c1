//! Of all frames those that came earliest after they happened: one each bin of time.

use mocapd_take::record::ClockPoint;

use super::{WINDOW_US, fit::POINTS_MAX, seconds};

/// How long a bin is, by the age of the segment: short ones, so that there is a line soon, then as long as a take
/// can afford to store (some six bytes each).
const BINS_US: [(u64, u64); 4] =
    [(250_000, 250_000), (4_000_000, 1_000_000), (10_000_000, 2_000_000), (u64::MAX, 5_000_000)];

/// The points of a segment, oldest first, and the bin that is filled.
#[derive(Debug)]
pub(super) struct Arrivals {
    points: [ClockPoint; POINTS_MAX],
    n: usize,
    first_us: Option<u64>,
    open: Option<Open>,
}

#[derive(Debug, Clone, Copy)]
struct Open {
    since_us: u64,
    earliest: ClockPoint,
}

impl Arrivals {
    pub(super) fn new() -> Self {
        Self { points: [ClockPoint::default(); POINTS_MAX], n: 0, first_us: None, open: None }
    }

    pub(super) fn points(&self) -> &[ClockPoint] {
        &self.points[..self.n]
    }

    /// Takes a frame in. Gives the point of a bin that it ended, for [`keep`](Self::keep).
    pub(super) fn add(
        &mut self,
        frame: ClockPoint,
        drift_ppm: f64,
        tick_hz: f64,
    ) -> Option<ClockPoint> {
        let first_us = *self.first_us.get_or_insert(frame.host_us);
        let Some(open) = &mut self.open else {
            self.open = Some(Open { since_us: frame.host_us, earliest: frame });
            return None;
        };
        let age_us = open.since_us.saturating_sub(first_us);
        let bin_us = BINS_US.iter().find(|bin| age_us < bin.0).map_or(0, |bin| bin.1);
        if frame.host_us.saturating_sub(open.since_us) >= bin_us {
            let closed = open.earliest;
            self.open = Some(Open { since_us: frame.host_us, earliest: frame });
            return Some(closed);
        }
        let passed_s = seconds(frame.device_ticks, open.earliest.device_ticks, tick_hz);
        let passed_us = frame.host_us.wrapping_sub(open.earliest.host_us).cast_signed() as f64;
        if passed_us < passed_s * (1e6 + drift_ppm) {
            open.earliest = frame;
        }
        None
    }

    /// Ends the bin that is open, and gives its point.
    pub(super) fn close(&mut self) -> Option<ClockPoint> {
        self.open.take().map(|open| open.earliest)
    }

    /// The line is laid through this point, too.
    pub(super) fn keep(&mut self, newest: ClockPoint) {
        let expired =
            |point: &&ClockPoint| point.host_us.saturating_add(WINDOW_US) < newest.host_us;
        let old = self.points().iter().take_while(expired).count();
        self.drop_oldest(old.max(usize::from(self.n == POINTS_MAX)));
        self.points[self.n] = newest;
        self.n += 1;
    }

    fn drop_oldest(&mut self, n: usize) {
        self.points.copy_within(n..self.n, 0);
        self.n -= n;
    }
}

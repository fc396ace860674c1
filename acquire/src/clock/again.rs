//! The line of a take laid again, from the round trips and early frames that it stores.

use std::collections::VecDeque;

use mocapd_take::record::{Clock, ClockLine, ClockPoint, ClockProbe};

use super::{
    WINDOW_US,
    fit::{Line, POINTS_MAX},
    observations::{Bursts, lines},
    seconds,
};

/// Round trips that are held: ten a second, which is the link's budget, over the window.
const PROBES_MAX: usize = 1200;

/// How far the two lines may lie apart, beside a quarter of the bound: in takes of the first versions, which round trip
/// of a burst was the best was chosen with the rate known then, and not with the last one as here.
const APART_US: f64 = 20.0;
const APART_PPM: f64 = 2.0;

/// How far a stored line lies from the one that its observations give.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Apart {
    /// Where the line is told, in microseconds: the stored one is later when negative.
    pub offset_us: f64,
    /// Its drift, in parts per million.
    pub drift_ppm: f64,
    /// Whether both are as near as they have to be.
    pub agrees: bool,
}

/// Takes in a take's CLOCK records, in order; bounded.
#[derive(Debug, Default)]
pub struct LineAgain {
    segment: u32,
    tick_hz: u64,
    points: VecDeque<ClockPoint>,
    probes: VecDeque<ClockProbe>,
    line: Option<ClockLine>,
}

impl LineAgain {
    /// The next record.
    pub fn add(&mut self, clock: &Clock) {
        if clock.segment != self.segment {
            *self = Self { segment: clock.segment, ..Self::default() };
        }
        self.tick_hz = clock.tick_hz;
        self.line = clock.line;
        self.points.extend(&clock.points);
        self.probes.extend(&clock.probes);
        self.points.drain(..self.points.len().saturating_sub(POINTS_MAX));
        self.probes.drain(..self.probes.len().saturating_sub(PROBES_MAX));
    }

    /// The last record's line against its observations; `None` where there is no line.
    #[must_use]
    pub fn apart(&self) -> Option<Apart> {
        let stored = self.line?;
        let tick_hz = self.tick_hz.max(1) as f64;
        let stored_ppm = stored.drift_ppb as f64 / 1e3;
        let newest_us = self.points.back().map_or(0, |point| point.host_us);
        let counts = |point: &&ClockPoint| point.host_us.saturating_add(WINDOW_US) >= newest_us;
        let points: Vec<ClockPoint> = self.points.iter().filter(counts).copied().collect();
        let mut bursts = Bursts::new();
        for &probe in &self.probes {
            bursts.add(probe);
        }
        // The choice between round trips may go on between a few lines: the stored one is the nearest.
        let all = lines(&points, &bursts, stored_ppm, tick_hz);
        let nearest = all.map(|line| apart(&line, &stored, tick_hz)).min_by(|a, b| {
            let nearer = a.offset_us.abs().total_cmp(&b.offset_us.abs());
            b.agrees.cmp(&a.agrees).then(nearer)
        });
        // A line of nothing.
        let nothing = Apart { offset_us: f64::INFINITY, drift_ppm: f64::INFINITY, agrees: false };
        Some(nearest.unwrap_or(nothing))
    }
}

fn apart(line: &Line, stored: &ClockLine, tick_hz: f64) -> Apart {
    let stored_ppm = stored.drift_ppb as f64 / 1e3;
    let passed_s = seconds(line.at.device_ticks, stored.device_ticks, tick_hz);
    let at_ns = line.at.host_us.wrapping_mul(1000).wrapping_sub(stored.host_ns).cast_signed();
    let offset_us = at_ns as f64 * 1e-3 + line.late_us - passed_s * (1e6 + stored_ppm);
    let drift_ppm = line.drift_ppm - stored_ppm;
    let (us, ppm) =
        stored.bound.map_or((0.0, 0.0), |b| (b.offset_us as f64, b.drift_ppb as f64 / 1e3));
    let agrees = offset_us.abs() <= APART_US + us / 4.0 && drift_ppm.abs() <= APART_PPM + ppm / 4.0;
    Apart { offset_us, drift_ppm, agrees }
}

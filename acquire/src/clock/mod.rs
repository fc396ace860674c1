//! Relates the device's clock to the host's: a line fitted to observations of both, updated as frames come.
//!
//! There are two kinds of observations. A frame arrives after it was captured, so the device's clock showed its ticks
//! no later than its arrival. And when a ping is answered, the device's clock showed the pong's ticks between the two
//! host times. Each observation therefore bounds the line from above or from below, however late it came, and the
//! line is placed midway between the bounds. docs/clock.md describes the method.
//!
//! Sans-io: times and ticks are arguments. Nothing here reads a clock, or allocates after construction.

mod model;
mod observations;
#[cfg(test)]
mod tests;

use mocapd_take::record::{ClockBound, ClockLine, ClockPoint};

pub use model::{ClockEvent, ClockItem, ClockModel, ClockStatus, StoreItem};
pub use observations::Prober;
pub use observations::{LineDeviation, LineRefit};

/// Longest age of an observation that the line is fitted to: over two minutes the oscillators of a device and of a host
/// change their relative rate by some hundredths of a ppm, 5 us.
const WINDOW_US: u64 = 120_000_000;

/// Seconds from `from` to `ticks`, modulo 2^64 as ticks are.
fn seconds(ticks: u64, from: u64, tick_hz: f64) -> f64 {
    ticks.wrapping_sub(from).cast_signed() as f64 / tick_hz
}

/// Maximum number of points, and of bursts, that a line is fitted to: eight points of the first ten seconds, and one
/// per five seconds of a window of 120; a burst every half minute, and those at the start.
const POINTS_MAX: usize = 48;
const BURSTS_MAX: usize = 16;

/// Steepest line: far beyond any oscillator (a crystal stays within 100 ppm, a ring oscillator within 2 %).
const DRIFT_MAX_PPM: f64 = 20_000.0;

/// Steepest line considered for the bound: five times the error of a crystal.
const USUAL_PPM: f64 = 500.0;

/// Regularisation: a rate of 1 ppm must improve the fit by this many seconds times 1 ppm. Observations within less
/// time say nothing about a rate.
const PRIOR_S: f64 = 0.25;

/// Number of bursts, and seconds between the first and the last, from which the round trips alone determine the rate:
/// arrivals on a line that sends in batches can follow the batches' clock for minutes.
const BURSTS_FOR_RATE: usize = 3;
const SPAN_FOR_RATE_S: f64 = 1.0;

/// Cost of a microsecond beyond a bound, relative to a microsecond of mean lateness: more than any rate gains.
/// The second number is the violation tolerated, more than the resolution of the search for a rate.
const VIOLATION_COST: f64 = 100.0;
const VIOLATION_MAX_US: f64 = 1.0;

/// Frames that come later than this after their round trips are stamped by another clock.
const LATE_MAX_US: f64 = 10e6;

/// Smallest uncertainty of a bound: two clock readings.
const NOISE_MIN_US: f64 = 3.0;

/// Steps of the search for a rate, each of which reduces the range to two thirds: down to a ten-thousandth of a ppm.
const SEARCH_STEPS: usize = 48;

/// The best bounds of several consecutive round trips.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Burst {
    /// When the first ping was sent, in host microseconds.
    pub first_us: u64,
    /// The latest ping by the device's clock: the line passes above it.
    pub low: ClockPoint,
    /// The earliest pong: the line passes below it.
    pub high: ClockPoint,
    /// How much worse the second best ping was, in microseconds: an estimate of the distance of the best one from the
    /// shortest delay.
    pub low_next_us: f64,
    /// How much worse the second best pong was, in microseconds.
    pub high_next_us: f64,
}

/// A line in full precision.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Its reference point: device ticks, and the host time of an observation there.
    pub at: ClockPoint,
    /// How much later than `at.host_us` the line is at the reference point, in microseconds.
    pub late_us: f64,
    /// How much faster the host's clock runs, in parts per million.
    pub drift_ppm: f64,
    /// The largest possible error; `None` without a round trip.
    pub bound: Option<Bound>,
}

/// The largest possible error of a line, if the drift is constant and within 500 ppm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bound {
    /// Error of the offset at the reference point, in microseconds.
    pub offset_us: f64,
    /// Error of the drift, in parts per million.
    pub drift_ppm: f64,
}

impl Line {
    /// How late an event was against the line, in microseconds; negative when early.
    #[must_use]
    pub fn lateness_us(&self, ticks: u64, host_ns: u64, tick_hz: f64) -> f64 {
        let elapsed_s = seconds(ticks, self.at.device_ticks, tick_hz);
        let host_ns = host_ns.wrapping_sub(self.at.host_us.wrapping_mul(1000)).cast_signed();
        host_ns as f64 * 1e-3 - elapsed_s * (1e6 + self.drift_ppm) - self.late_us
    }

    /// The line as stored in a take.
    #[must_use]
    pub fn stored(&self) -> ClockLine {
        let late_ns = (self.late_us * 1e3).round() as i64;
        ClockLine {
            device_ticks: self.at.device_ticks,
            host_ns: self.at.host_us.saturating_mul(1000).saturating_add_signed(late_ns),
            drift_ppb: (self.drift_ppm * 1e3).round() as i64,
            bound: self.bound.map(|bound| ClockBound {
                offset_us: bound.offset_us.ceil() as u64,
                drift_ppb: (bound.drift_ppm * 1e3).ceil() as u64,
            }),
        }
    }
}

/// Points that bound the line on one side, as (seconds, deviation from the nominal rate in microseconds).
struct BoundPoints<const N: usize> {
    n: usize,
    x_s: [f64; N],
    y_us: [f64; N],
    mean_x_s: f64,
    mean_y_us: f64,
}

impl<const N: usize> BoundPoints<N> {
    fn new(points: impl Iterator<Item = ClockPoint>, at: ClockPoint, tick_hz: f64) -> Self {
        let mut side = Self { n: 0, x_s: [0.0; N], y_us: [0.0; N], mean_x_s: 0.0, mean_y_us: 0.0 };
        for (i, point) in points.take(N).enumerate() {
            let x_s = seconds(point.device_ticks, at.device_ticks, tick_hz);
            let y_us = point.host_us.wrapping_sub(at.host_us).cast_signed() as f64 - x_s * 1e6;
            (side.x_s[i], side.y_us[i]) = (x_s, y_us);
            side.n = i + 1;
            side.mean_x_s += (x_s - side.mean_x_s) / side.n as f64;
            side.mean_y_us += (y_us - side.mean_y_us) / side.n as f64;
        }
        side
    }

    fn residuals(&self, ppm: f64) -> impl Iterator<Item = f64> {
        self.x_s.iter().zip(&self.y_us).take(self.n).map(move |(x_s, y_us)| y_us - ppm * x_s)
    }

    fn lowest(&self, ppm: f64) -> f64 {
        self.residuals(ppm).fold(f64::INFINITY, f64::min)
    }

    fn highest(&self, ppm: f64) -> f64 {
        self.residuals(ppm).fold(f64::NEG_INFINITY, f64::max)
    }

    fn mean(&self, ppm: f64) -> f64 {
        self.mean_y_us - ppm * self.mean_x_s
    }
}

struct FitInput {
    arrivals: BoundPoints<POINTS_MAX>,
    low: BoundPoints<BURSTS_MAX>,
    high: BoundPoints<BURSTS_MAX>,
    /// Scatter of the bounds below and above, in microseconds.
    noise_us: [f64; 2],
    rate_from_probes: bool,
}

impl FitInput {
    /// Width between the bounds, in microseconds.
    fn gap(&self, ppm: f64) -> f64 {
        self.arrivals.lowest(ppm).min(self.high.lowest(ppm)) - self.low.highest(ppm)
    }

    /// Mean distance of the bursts' bounds from the tightest one, below and above, for lines of this rate.
    fn slack(&self, ppm: f64) -> [f64; 2] {
        [self.low.highest(ppm) - self.low.mean(ppm), self.high.mean(ppm) - self.high.lowest(ppm)]
    }

    /// Score of a rate. It is concave, so that one search finds the maximum.
    ///
    /// The shortest delay is constant: bounds near it follow a line of the right rate. The side that scatters
    /// less has more weight. Frames determine a rate only while bursts do not, and not one that the bursts
    /// rule out.
    fn score(&self, ppm: f64) -> f64 {
        let prior = PRIOR_S * ppm.abs();
        let violation = if self.low.n > 0 { VIOLATION_COST * self.gap(ppm).min(0.0) } else { 0.0 };
        if self.rate_from_probes {
            let [low, high] = self.slack(ppm);
            let [low_noise, high_noise] = self.noise_us;
            let slack = low / low_noise + high / high_noise;
            return violation - prior / (low_noise + high_noise) - slack;
        }
        self.arrivals.lowest(ppm) - self.arrivals.mean(ppm) - prior + violation
    }

    /// The largest distance of the true line from a line of the best rate, at the reference point, over all lines that
    /// satisfy the bounds with a rate that oscillators have.
    fn bound(&self, best_ppm: f64, late_us: f64) -> Bound {
        let is_feasible = |ppm: f64| self.gap(ppm) >= 0.0;
        let [from, to] = [-1.0, 1.0].map(|sign| {
            let (mut inside, mut outside) = (best_ppm, sign * USUAL_PPM);
            if (outside - best_ppm) * sign <= 0.0 {
                return best_ppm;
            }
            if is_feasible(outside) {
                return outside;
            }
            for _ in 0..SEARCH_STEPS {
                let middle = f64::midpoint(inside, outside);
                if is_feasible(middle) { inside = middle } else { outside = middle }
            }
            inside
        });
        let high = |ppm: f64| self.arrivals.lowest(ppm).min(self.high.lowest(ppm));
        let highest = high(argmax(from, to, high));
        let lowest = self.low.highest(argmax(from, to, |ppm| -self.low.highest(ppm)));
        Bound {
            offset_us: (highest - late_us).max(late_us - lowest).max(0.0),
            drift_ppm: (to - best_ppm).max(best_ppm - from),
        }
    }
}

/// The argument that maximises a concave function.
fn argmax(mut from: f64, mut to: f64, height: impl Fn(f64) -> f64) -> f64 {
    for _ in 0..SEARCH_STEPS {
        let third = (to - from) / 3.0;
        if height(from + third) < height(to - third) {
            from += third;
        } else {
            to -= third;
        }
    }
    f64::midpoint(from, to)
}

fn noise_us(bursts: &[Burst]) -> [f64; 2] {
    let n = bursts.len().max(1) as f64;
    let mean = |next_us: fn(&Burst) -> f64| bursts.iter().map(next_us).sum::<f64>() / n;
    [mean(|burst| burst.low_next_us), mean(|burst| burst.high_next_us)].map(|us| us + NOISE_MIN_US)
}

/// Fits a line to points and bursts, both oldest first. Returns it with the number of the oldest bursts that do not
/// belong to it, because no line satisfies all bounds. `None` without observations.
///
/// When the points contradict even the last burst, frames and pongs are stamped by different clocks: the
/// line follows the frames and has no bound.
#[must_use]
pub fn fit(points: &[ClockPoint], bursts: &[Burst], tick_hz: f64) -> Option<(Line, usize)> {
    for outdated in 0..bursts.len() {
        let bursts = &bursts[outdated..];
        // Points older than the oldest burst in use are as outdated as the earlier bursts.
        let since_us = if outdated == 0 { 0 } else { bursts[0].first_us };
        if let Some(line) = fit_line(points, since_us, bursts, tick_hz) {
            return Some((line, outdated));
        }
    }
    let line = fit_line(points, 0, &[], tick_hz)?;
    Some((line, bursts.len()))
}

fn fit_line(points: &[ClockPoint], since_us: u64, bursts: &[Burst], tick_hz: f64) -> Option<Line> {
    let at = *points.last().or(bursts.last().map(|burst| &burst.low))?;
    // The last point always counts: bursts that contradict it belong to another clock.
    let (before, last) = points.split_at(points.len().saturating_sub(1));
    let recent = before.iter().filter(|point| point.host_us >= since_us).chain(last).copied();
    let span_us = match bursts {
        [first, .., last] => last.first_us.saturating_sub(first.first_us),
        _ => 0,
    };
    let input = FitInput {
        arrivals: BoundPoints::new(recent, at, tick_hz),
        low: BoundPoints::new(bursts.iter().map(|burst| burst.low), at, tick_hz),
        high: BoundPoints::new(bursts.iter().map(|burst| burst.high), at, tick_hz),
        noise_us: noise_us(bursts),
        rate_from_probes: bursts.len() >= BURSTS_FOR_RATE
            && span_us as f64 >= SPAN_FOR_RATE_S * 1e6,
    };
    let drift_ppm = if input.rate_from_probes || input.arrivals.n > 0 {
        argmax(-DRIFT_MAX_PPM, DRIFT_MAX_PPM, |ppm| input.score(ppm))
    } else {
        0.0
    };
    let earliest = input.arrivals.lowest(drift_ppm);
    if bursts.is_empty() {
        return Some(Line { at, late_us: earliest, drift_ppm, bound: None });
    }
    let gap_us = input.gap(drift_ppm);
    let contradicts = gap_us < -VIOLATION_MAX_US
        || (input.arrivals.n > 0 && earliest - input.high.lowest(drift_ppm) > LATE_MAX_US);
    if contradicts {
        return None;
    }
    let late_us = input.low.highest(drift_ppm) + gap_us.max(0.0) / 2.0;
    let bound = Some(input.bound(drift_ppm, late_us));
    Some(Line { at, late_us, drift_ppm, bound })
}

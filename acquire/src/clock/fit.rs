//! The line itself: a function of the points and the round trips, and of nothing else.

use mocapd_take::record::{ClockBound, ClockLine, ClockPoint};

use super::seconds;

/// Most points, and most bursts, that a line is laid through: eight of the first ten seconds, and one each five
/// seconds of a window of 120; a burst each half a minute, and those of the first.
pub(super) const POINTS_MAX: usize = 48;
pub(super) const BURSTS_MAX: usize = 16;

/// The steepest line: far beyond any oscillator (a crystal stays within 100 ppm, a ring within 2 %).
const DRIFT_MAX_PPM: f64 = 20_000.0;

/// The steepest one that is thought of when a line's bound is worked out: five times what a crystal is off.
const USUAL_PPM: f64 = 500.0;

/// What a ppm must bring before it is believed, in seconds: less than that of observations say nothing of a
/// rate.
const PRIOR_S: f64 = 0.25;

/// Bursts, and the seconds between the first and the last, from which on the round trips alone tell the rate:
/// arrivals on a line that sends in batches can follow the batches' clock for minutes.
const BURSTS_FOR_RATE: usize = 3;
const SPAN_FOR_RATE_S: f64 = 1.0;

/// What a microsecond beyond a bound costs, beside a microsecond of mean lateness: more than any rate gains.
/// Beyond the second number it is more than how exactly a rate is searched for.
const RULED_OUT: f64 = 100.0;
const BEYOND_US: f64 = 1.0;

/// Frames that come later than this after their round trips are not of the same clock.
const LATE_MAX_US: f64 = 10e6;

/// What a bound is uncertain by at least: two readings of clocks.
const NOISE_MIN_US: f64 = 3.0;

/// Halvings by two thirds of the range of rates: down to a ten thousandth of a ppm.
const STEPS: usize = 48;

/// The best bounds of some round trips in a row.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Burst {
    /// When the first one was sent, in host microseconds.
    pub first_us: u64,
    /// The latest ping, seen from the device's clock: the line passes above it.
    pub low: ClockPoint,
    /// The earliest pong: the line passes below it.
    pub high: ClockPoint,
    /// By how much the second best of these were worse, in microseconds: how far the best ones may be from the
    /// least delay.
    pub low_next_us: f64,
    /// The same of `high`.
    pub high_next_us: f64,
}

/// A line, in full precision.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Where it is told at: device ticks, and the host time of an observation there.
    pub at: ClockPoint,
    /// How much later than `at.host_us` the line is there, in microseconds.
    pub late_us: f64,
    /// How much faster the host's clock runs, in parts per million.
    pub drift_ppm: f64,
    /// How far it can be off; `None` without a round trip.
    pub bound: Option<Bound>,
}

/// How far a line can be off, if the drift is constant and within 500 ppm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bound {
    /// Where it is told, in microseconds.
    pub offset_us: f64,
    /// Its drift, in parts per million.
    pub drift_ppm: f64,
}

impl Line {
    /// How long after the line something came, in microseconds; before it when negative.
    #[must_use]
    pub fn lateness_us(&self, ticks: u64, host_ns: u64, tick_hz: f64) -> f64 {
        let passed_s = seconds(ticks, self.at.device_ticks, tick_hz);
        let host_ns = host_ns.wrapping_sub(self.at.host_us.wrapping_mul(1000)).cast_signed();
        host_ns as f64 * 1e-3 - passed_s * (1e6 + self.drift_ppm) - self.late_us
    }

    /// As a take stores it.
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

/// What bounds the line on one side, as (seconds, microseconds beside the nominal rate).
struct Side<const N: usize> {
    n: usize,
    x_s: [f64; N],
    y_us: [f64; N],
    mean_x_s: f64,
    mean_y_us: f64,
}

impl<const N: usize> Side<N> {
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

    fn over(&self, ppm: f64) -> impl Iterator<Item = f64> {
        self.x_s.iter().zip(&self.y_us).take(self.n).map(move |(x_s, y_us)| y_us - ppm * x_s)
    }

    fn least(&self, ppm: f64) -> f64 {
        self.over(ppm).fold(f64::INFINITY, f64::min)
    }

    fn most(&self, ppm: f64) -> f64 {
        self.over(ppm).fold(f64::NEG_INFINITY, f64::max)
    }

    fn mean(&self, ppm: f64) -> f64 {
        self.mean_y_us - ppm * self.mean_x_s
    }
}

struct Sides {
    arrivals: Side<POINTS_MAX>,
    low: Side<BURSTS_MAX>,
    high: Side<BURSTS_MAX>,
    /// What the bounds below and above scatter by.
    noise_us: [f64; 2],
    probes_tell_the_rate: bool,
}

impl Sides {
    /// What there is between the bounds, in microseconds.
    fn gap(&self, ppm: f64) -> f64 {
        self.arrivals.least(ppm).min(self.high.least(ppm)) - self.low.most(ppm)
    }

    /// How much the bursts' bounds slacken, below and above, under lines of this rate.
    fn slack(&self, ppm: f64) -> [f64; 2] {
        [self.low.most(ppm) - self.low.mean(ppm), self.high.mean(ppm) - self.high.least(ppm)]
    }

    /// How good a rate is. Concave: one search finds the best.
    ///
    /// The least delay is the same all the time: bounds that come close to it follow a line of the right rate.
    /// The side that scatters less counts for more. Frames tell a rate only while bursts do not, and none that
    /// the bursts rule out.
    fn merit(&self, ppm: f64) -> f64 {
        let prior = PRIOR_S * ppm.abs();
        let ruled_out = if self.low.n > 0 { RULED_OUT * self.gap(ppm).min(0.0) } else { 0.0 };
        if self.probes_tell_the_rate {
            let [low, high] = self.slack(ppm);
            let [low_noise, high_noise] = self.noise_us;
            let slack = low / low_noise + high / high_noise;
            return ruled_out - prior / (low_noise + high_noise) - slack;
        }
        self.arrivals.least(ppm) - self.arrivals.mean(ppm) - prior + ruled_out
    }

    /// How far the truth may be from a line of the best rate, at the place where the line is told: over all
    /// lines that keep the bounds, of a rate that oscillators have.
    fn bound(&self, best_ppm: f64, late_us: f64) -> Bound {
        let keeps = |ppm: f64| self.gap(ppm) >= 0.0;
        let [from, to] = [-1.0, 1.0].map(|sign| {
            let (mut inside, mut outside) = (best_ppm, sign * USUAL_PPM);
            if (outside - best_ppm) * sign <= 0.0 {
                return best_ppm;
            }
            if keeps(outside) {
                return outside;
            }
            for _ in 0..STEPS {
                let middle = f64::midpoint(inside, outside);
                if keeps(middle) { inside = middle } else { outside = middle }
            }
            inside
        });
        let high = |ppm: f64| self.arrivals.least(ppm).min(self.high.least(ppm));
        let highest = high(peak(from, to, high));
        let lowest = self.low.most(peak(from, to, |ppm| -self.low.most(ppm)));
        Bound {
            offset_us: (highest - late_us).max(late_us - lowest).max(0.0),
            drift_ppm: (to - best_ppm).max(best_ppm - from),
        }
    }
}

/// Where something concave is largest.
fn peak(mut from: f64, mut to: f64, height: impl Fn(f64) -> f64) -> f64 {
    for _ in 0..STEPS {
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

/// The line through points, oldest first, and bursts, oldest first; and how many of the oldest bursts do not
/// belong to it, because no line has all bounds on the right sides. `None` when there is nothing.
///
/// Where points and the last burst contradict each other, frames and pongs are not stamped by one clock: the
/// line is that of the frames, and it has no bound.
#[must_use]
pub fn fit(points: &[ClockPoint], bursts: &[Burst], tick_hz: f64) -> Option<(Line, usize)> {
    for outdated in 0..bursts.len() {
        let bursts = &bursts[outdated..];
        // What came before the oldest burst that counts is as outdated as the ones before it.
        let since_us = if outdated == 0 { 0 } else { bursts[0].first_us };
        if let Some(line) = through(points, since_us, bursts, tick_hz) {
            return Some((line, outdated));
        }
    }
    let line = through(points, 0, &[], tick_hz)?;
    Some((line, bursts.len()))
}

fn through(points: &[ClockPoint], since_us: u64, bursts: &[Burst], tick_hz: f64) -> Option<Line> {
    let at = *points.last().or(bursts.last().map(|burst| &burst.low))?;
    // The last point always counts: bursts that do not go with it are not of the frames' clock.
    let (last, before) =
        points.split_last().map_or((None, points), |(last, rest)| (Some(last), rest));
    let recent = before.iter().filter(|point| point.host_us >= since_us).chain(last).copied();
    let span_us = match bursts {
        [first, .., last] => last.first_us.saturating_sub(first.first_us),
        _ => 0,
    };
    let sides = Sides {
        arrivals: Side::new(recent, at, tick_hz),
        low: Side::new(bursts.iter().map(|burst| burst.low), at, tick_hz),
        high: Side::new(bursts.iter().map(|burst| burst.high), at, tick_hz),
        noise_us: noise_us(bursts),
        probes_tell_the_rate: bursts.len() >= BURSTS_FOR_RATE
            && span_us as f64 >= SPAN_FOR_RATE_S * 1e6,
    };
    let drift_ppm = if sides.probes_tell_the_rate || sides.arrivals.n > 0 {
        peak(-DRIFT_MAX_PPM, DRIFT_MAX_PPM, |ppm| sides.merit(ppm))
    } else {
        0.0
    };
    let earliest = sides.arrivals.least(drift_ppm);
    if bursts.is_empty() {
        return Some(Line { at, late_us: earliest, drift_ppm, bound: None });
    }
    let gap_us = sides.gap(drift_ppm);
    let contradicts = gap_us < -BEYOND_US
        || (sides.arrivals.n > 0 && earliest - sides.high.least(drift_ppm) > LATE_MAX_US);
    if contradicts {
        return None;
    }
    let late_us = sides.low.most(drift_ppm) + gap_us.max(0.0) / 2.0;
    let bound = Some(sides.bound(drift_ppm, late_us));
    Some(Line { at, late_us, drift_ppm, bound })
}

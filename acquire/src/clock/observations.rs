//! The observations that the line is fitted to: the best bounds of each burst of round trips, and the earliest frame of
//! each time bin. Also the pings that ask the device for its clock, the fit itself, and the refit of a take's line from its
//! stored observations.
//!
//! Round trips come in bursts of eight; the best bounds of a burst count. On a line that sends in batches (an
//! FTDI adapter: every 16 ms), a pong waits for the next batch, and a burst timed at random never sees a short
//! way back. On such a line a burst therefore measures the batch interval and sends its pings shortly before the
//! next batch.

use std::collections::VecDeque;

use mocapd_take::record::{Clock, ClockLine, ClockPoint, ClockProbe};
use serde::Serialize;

use super::{BURSTS_MAX, Burst, Line, POINTS_MAX, WINDOW_US, fit, seconds};

/// Round trips that begin within this time of the first form a burst: eight take at most 0.2 s, and the next
/// burst begins a second later at the earliest.
const BURST_US: u64 = 500_000;

const PROBES_MAX: usize = PROBES as usize;

/// The bursts of a segment, oldest first, with all their round trips: which of them are best depends on the rate
/// of the line, which changes with each observation.
#[derive(Debug)]
pub(super) struct Bursts {
    bursts: [RoundTrips; BURSTS_MAX],
    n: usize,
}

/// The round trips of a burst.
#[derive(Debug, Clone, Copy, Default)]
struct RoundTrips {
    probes: [ClockProbe; PROBES_MAX],
    n: usize,
}

/// The best bounds of each burst at one rate.
#[derive(Debug, Clone, Copy)]
pub(super) struct BestBounds {
    bursts: [Burst; BURSTS_MAX],
    n: usize,
}

impl BestBounds {
    pub(super) fn all(&self) -> &[Burst] {
        &self.bursts[..self.n]
    }

    /// Whether both select the same round trips.
    fn selects_same(&self, other: &Self) -> bool {
        let same = |(a, b): (&Burst, &Burst)| (a.low, a.high) == (b.low, b.high);
        self.n == other.n && self.all().iter().zip(other.all()).all(same)
    }
}

impl Bursts {
    pub(super) fn new() -> Self {
        Self { bursts: [RoundTrips::default(); BURSTS_MAX], n: 0 }
    }

    pub(super) fn add(&mut self, probe: ClockProbe) {
        if let Some(last) = self.bursts[..self.n].last_mut()
            && last.n < PROBES_MAX
            && probe.sent_us.abs_diff(last.first_us()) < BURST_US
        {
            return last.add(probe);
        }
        let expired = |b: &&RoundTrips| b.first_us().saturating_add(WINDOW_US) < probe.sent_us;
        let old = self.bursts[..self.n].iter().take_while(expired).count();
        self.drop_oldest(old.max(usize::from(self.n == BURSTS_MAX)));
        self.bursts[self.n] = RoundTrips::default();
        self.bursts[self.n].add(probe);
        self.n += 1;
    }

    /// The best bounds if the host's clock runs faster by `drift_ppm`.
    pub(super) fn best(&self, drift_ppm: f64, tick_hz: f64) -> BestBounds {
        let mut best = BestBounds { bursts: [Burst::default(); BURSTS_MAX], n: self.n };
        for (burst, trips) in best.bursts.iter_mut().zip(&self.bursts[..self.n]) {
            *burst = trips.best(drift_ppm, tick_hz);
        }
        best
    }

    /// Drops the oldest bursts.
    fn drop_oldest(&mut self, n: usize) {
        self.bursts.copy_within(n..self.n, 0);
        self.n -= n;
    }
}

impl RoundTrips {
    fn first_us(&self) -> u64 {
        self.probes[0].sent_us
    }

    fn add(&mut self, probe: ClockProbe) {
        self.probes[self.n] = probe;
        self.n += 1;
    }

    fn best(&self, drift_ppm: f64, tick_hz: f64) -> Burst {
        let later_us = |point: ClockPoint, than: ClockPoint| {
            let elapsed_s = seconds(point.device_ticks, than.device_ticks, tick_hz);
            point.host_us.wrapping_sub(than.host_us).cast_signed() as f64
                - elapsed_s * (1e6 + drift_ppm)
        };
        let mut bounds = self.probes[..self.n].iter().map(|probe| {
            let ClockProbe { sent_us, device_ticks, round_trip_us } = *probe;
            let low = ClockPoint { device_ticks, host_us: sent_us };
            (low, ClockPoint { host_us: sent_us.saturating_add(round_trip_us), ..low })
        });
        let Some((low, high)) = bounds.next() else { return Burst::default() };
        let (first_us, trip_us) = (low.host_us, self.probes[0].round_trip_us as f64);
        let mut best = Burst { first_us, low, high, low_next_us: trip_us, high_next_us: trip_us };
        for (low, high) in bounds {
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

/// Updates the distance of the second best from the best with another candidate, which is better by `better_us`.
fn next_us(next_us: f64, better_us: f64) -> f64 {
    if better_us > 0.0 { better_us } else { next_us.min(-better_us) }
}

/// Length of a bin, by the age of the segment: short at first, so that there is a line soon, then as long as a take
/// can afford to store (some six bytes each).
const BINS_US: [(u64, u64); 4] =
    [(250_000, 250_000), (4_000_000, 1_000_000), (10_000_000, 2_000_000), (u64::MAX, 5_000_000)];

/// The points of a segment, oldest first, and the open bin.
#[derive(Debug)]
pub(super) struct Arrivals {
    points: [ClockPoint; POINTS_MAX],
    n: usize,
    first_us: Option<u64>,
    open: Option<OpenBin>,
}

#[derive(Debug, Clone, Copy)]
struct OpenBin {
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

    /// Accepts a frame. Returns the point of the bin that it closes, for [`keep`](Self::keep).
    pub(super) fn add(
        &mut self,
        frame: ClockPoint,
        drift_ppm: f64,
        tick_hz: f64,
    ) -> Option<ClockPoint> {
        let first_us = *self.first_us.get_or_insert(frame.host_us);
        let Some(open) = &mut self.open else {
            self.open = Some(OpenBin { since_us: frame.host_us, earliest: frame });
            return None;
        };
        let age_us = open.since_us.saturating_sub(first_us);
        let bin_us = BINS_US.iter().find(|bin| age_us < bin.0).map_or(0, |bin| bin.1);
        if frame.host_us.saturating_sub(open.since_us) >= bin_us {
            let closed = open.earliest;
            self.open = Some(OpenBin { since_us: frame.host_us, earliest: frame });
            return Some(closed);
        }
        let elapsed_s = seconds(frame.device_ticks, open.earliest.device_ticks, tick_hz);
        let elapsed_us = frame.host_us.wrapping_sub(open.earliest.host_us).cast_signed() as f64;
        if elapsed_us < elapsed_s * (1e6 + drift_ppm) {
            open.earliest = frame;
        }
        None
    }

    /// Closes the open bin and returns its point.
    pub(super) fn close(&mut self) -> Option<ClockPoint> {
        self.open.take().map(|open| open.earliest)
    }

    /// Adds a point to those that the line is fitted to.
    pub(super) fn keep(&mut self, newest: ClockPoint) {
        let is_old = |point: &&ClockPoint| point.host_us.saturating_add(WINDOW_US) < newest.host_us;
        let old = self.points().iter().take_while(is_old).count();
        self.drop_oldest(old.max(usize::from(self.n == POINTS_MAX)));
        self.points[self.n] = newest;
        self.n += 1;
    }

    fn drop_oldest(&mut self, n: usize) {
        self.points.copy_within(n..self.n, 0);
        self.n -= n;
    }
}

/// Maximum number of rounds. Two are usually enough, because a rate hardly changes; where few round trips were held up,
/// the choice can cycle between two or three.
const ROUNDS_MAX: usize = 8;

/// Rates this close count as equal: within a burst of half a second the difference is 0.005 us.
const SAME_PPM: f64 = 0.01;

/// Fits a line to the best round trips at the rate `from_ppm`, then to the best ones at its own rate, and so on until
/// the choice is stable: the last line is the result. Started from its rate, the fit yields the same line: this is how
/// it can be verified from what a take stores.
pub(super) fn lines(
    points: &[ClockPoint],
    bursts: &Bursts,
    from_ppm: f64,
    tick_hz: f64,
) -> impl Iterator<Item = Line> {
    let mut next = Some((from_ppm, bursts.best(from_ppm, tick_hz)));
    (0..ROUNDS_MAX).map_while(move |_| {
        let (ppm, best) = next.take()?;
        let (line, _) = fit(points, best.all(), tick_hz)?;
        let better = bursts.best(line.drift_ppm, tick_hz);
        let is_same = (line.drift_ppm - ppm).abs() < SAME_PPM && better.selects_same(&best);
        next = (!is_same).then_some((line.drift_ppm, better));
        Some(line)
    })
}

/// Maximum number of round trips to hold: ten per second, which is the link's budget, over the window.
const STORED_PROBES_MAX: usize = 1200;

/// Permitted distance of the two lines, in addition to a quarter of the bound: the first versions chose the best round
/// trip of a burst with the rate known at that time, and not with the final one as here.
const SLACK_US: f64 = 20.0;
const SLACK_PPM: f64 = 2.0;

/// How far a stored line is from the line refitted to its observations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LineDeviation {
    /// At the reference point, in microseconds: negative when the stored line is later.
    #[serde(rename = "apart_us")]
    pub offset_us: f64,
    /// Difference of the drift, in parts per million.
    #[serde(rename = "apart_ppm")]
    pub drift_ppm: f64,
    /// Whether both are within the permitted distance.
    pub agrees: bool,
}

/// Refits a take's clock line from its CLOCK records, added in order. Its memory is bounded.
#[derive(Debug, Default)]
pub struct LineRefit {
    segment: u32,
    tick_hz: u64,
    points: VecDeque<ClockPoint>,
    probes: VecDeque<ClockProbe>,
    line: Option<ClockLine>,
}

impl LineRefit {
    /// Adds the next record.
    pub fn add(&mut self, clock: &Clock) {
        if clock.segment != self.segment {
            *self = Self { segment: clock.segment, ..Self::default() };
        }
        self.tick_hz = clock.tick_hz;
        self.line = clock.line;
        self.points.extend(&clock.points);
        self.probes.extend(&clock.probes);
        self.points.drain(..self.points.len().saturating_sub(POINTS_MAX));
        self.probes.drain(..self.probes.len().saturating_sub(STORED_PROBES_MAX));
    }

    /// Compares the last record's line with its observations; `None` if there is no line.
    #[must_use]
    pub fn deviation(&self) -> Option<LineDeviation> {
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
        // The choice of round trips may cycle between a few lines: take the nearest one.
        let all = lines(&points, &bursts, stored_ppm, tick_hz);
        let nearest = all.map(|line| deviation(&line, &stored, tick_hz)).min_by(|a, b| {
            let nearer = a.offset_us.abs().total_cmp(&b.offset_us.abs());
            b.agrees.cmp(&a.agrees).then(nearer)
        });
        // The line has no observations.
        let [offset_us, drift_ppm] = [f64::INFINITY; 2];
        Some(nearest.unwrap_or(LineDeviation { offset_us, drift_ppm, agrees: false }))
    }
}

fn deviation(line: &Line, stored: &ClockLine, tick_hz: f64) -> LineDeviation {
    let stored_ppm = stored.drift_ppb as f64 / 1e3;
    let elapsed_s = seconds(line.at.device_ticks, stored.device_ticks, tick_hz);
    let at_ns = line.at.host_us.wrapping_mul(1000).wrapping_sub(stored.host_ns).cast_signed();
    let offset_us = at_ns as f64 * 1e-3 + line.late_us - elapsed_s * (1e6 + stored_ppm);
    let drift_ppm = line.drift_ppm - stored_ppm;
    let (us, ppm) =
        stored.bound.map_or((0.0, 0.0), |b| (b.offset_us as f64, b.drift_ppb as f64 / 1e3));
    let agrees = offset_us.abs() <= SLACK_US + us / 4.0 && drift_ppm.abs() <= SLACK_PPM + ppm / 4.0;
    LineDeviation { offset_us, drift_ppm, agrees }
}

/// Round trips of a burst, as in LSL.
const PROBES: u32 = 8;

/// Seconds between two bursts: short at the start, so that there is a rate after four seconds and a good one
/// after nine, then as long as a take can afford to store (some 50 bytes a burst). A full window holds four.
const INTERVALS_S: [u64; 6] = [1, 3, 5, 11, 20, 30];

/// Shortest time between bursts on request. The link's budget allows ten pongs a second (docs/link-protocol.md), and a
/// clock that jumps with every frame must not be queried all the time.
const RESTART_AFTER_NS: u64 = 2 * SECOND_NS;

const SECOND_NS: u64 = 1_000_000_000;

/// Time to wait for an answer.
const ANSWER_TIMEOUT_NS: u64 = 500_000_000;

/// Number of unanswered pings in a row after which the device is not queried again until a late answer comes.
const UNANSWERED_MAX: u32 = 2 * PROBES;

/// Number of pings that may still be answered.
const PENDING_MAX: usize = 8;

/// Time between two round trips of a burst on a line that sends at once, so that one disturbance does not
/// delay all of them.
const SPACING_NS: u64 = 10_000_000;

/// A shorter round trip did not wait for a batch.
const QUICK_NS: u64 = 400_000;

/// Longest batch interval to synchronise with: 16 ms, and what a scheduler adds. Nothing can
/// arrive during the wait.
const PERIOD_MAX_NS: u64 = 20_000_000;

/// Shortest time from a ping to the batch that answers it: the timer latency of an idle machine.
const LEAD_MIN_NS: u64 = 80_000;

/// Number of pings in a row that missed their batch, after which the interval is measured again.
const MISSES_MAX: u32 = 3;

/// Schedules pings. Sans-io: the caller reports what was sent and answered.
#[derive(Debug, Default)]
pub struct Prober {
    off: bool,
    bursts: usize,
    burst_began_ns: u64,
    next_burst_ns: u64,
    /// Probes of this burst that are still to be sent.
    remaining: u32,
    ready_ns: u64,
    sleeps: bool,
    waiting_since_ns: Option<u64>,
    unanswered: u32,
    pending: [Option<u64>; PENDING_MAX],
    timing: BatchTiming,
}

#[derive(Debug, Default)]
struct BatchTiming {
    /// The batch interval; 0 while unknown.
    period_ns: u64,
    lead_ns: u64,
    misses: u32,
    missed: bool,
    /// Arrival of this burst's last pong.
    last_pong_ns: Option<u64>,
    /// Whether the pending ping was timed to precede a batch.
    is_timed: bool,
}

impl Prober {
    /// A prober whose first burst is due at once.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// When to send the next ping, if that is now, or so soon that the caller should sleep until then.
    pub fn due(&mut self, now_ns: u64) -> Option<u64> {
        if self.off {
            return None;
        }
        if let Some(since_ns) = self.waiting_since_ns {
            if now_ns.saturating_sub(since_ns) < ANSWER_TIMEOUT_NS {
                return None;
            }
            self.waiting_since_ns = None;
            self.unanswered += 1;
            self.off = self.unanswered >= UNANSWERED_MAX;
            self.ready_ns = now_ns;
        }
        if self.remaining == 0 {
            if now_ns < self.next_burst_ns {
                return None;
            }
            self.begin(now_ns);
        }
        let soon =
            now_ns >= self.ready_ns || (self.sleeps && self.ready_ns - now_ns <= PERIOD_MAX_NS);
        (soon && !self.off).then_some(self.ready_ns.max(now_ns))
    }

    fn begin(&mut self, now_ns: u64) {
        let interval_s = INTERVALS_S[self.bursts.min(INTERVALS_S.len() - 1)];
        self.bursts += 1;
        self.remaining = PROBES;
        self.burst_began_ns = now_ns;
        self.next_burst_ns = now_ns.saturating_add(interval_s * SECOND_NS);
        self.ready_ns = now_ns;
        self.sleeps = false;
        self.timing.last_pong_ns = None;
        self.timing.is_timed = false;
    }

    /// Starts the schedule again because the clocks changed, but not before the link allows it.
    pub fn restart_schedule(&mut self) {
        if self.bursts > 0 {
            self.bursts = 0;
            self.next_burst_ns =
                self.next_burst_ns.min(self.burst_began_ns.saturating_add(RESTART_AFTER_NS));
        }
    }

    /// Reports that a ping was sent.
    pub fn sent(&mut self, at_ns: u64) {
        self.remaining = self.remaining.saturating_sub(1);
        self.waiting_since_ns = Some(at_ns);
        self.pending.rotate_right(1);
        self.pending[0] = Some(at_ns);
        self.timing.is_timed = std::mem::take(&mut self.sleeps);
    }

    /// Stops probing: the device cannot be queried.
    pub fn disable(&mut self) {
        self.off = true;
    }

    /// Reports a pong that carries `sent_ns`. Returns whether it answers one of these pings.
    pub fn answered(&mut self, sent_ns: u64, now_ns: u64) -> bool {
        let Some(ping) = self.pending.iter_mut().find(|ping| **ping == Some(sent_ns)) else {
            return false;
        };
        *ping = None;
        self.unanswered = 0;
        self.off = false;
        // A late answer is as good a bound as any, but says nothing about when to send.
        if self.waiting_since_ns == Some(sent_ns) {
            self.waiting_since_ns = None;
            (self.ready_ns, self.sleeps) = self.timing.next(sent_ns, now_ns);
        }
        true
    }
}

impl BatchTiming {
    /// Corrects the batch interval, which a pong noticed late has made wrong: later pongs show it again, or
    /// twice its length.
    fn correct(&mut self, now_ns: u64, before_ns: Option<u64>) {
        let elapsed_ns = now_ns.saturating_sub(before_ns.unwrap_or(now_ns));
        let times = (elapsed_ns + self.period_ns / 2) / self.period_ns.max(1);
        if (1..=2).contains(&times) && self.period_ns.abs_diff(elapsed_ns / times) > self.lead_ns {
            self.period_ns = u64::midpoint(self.period_ns, elapsed_ns / times);
        }
    }

    /// After a round trip: when to send the next ping, and whether to sleep until then.
    fn next(&mut self, sent_ns: u64, now_ns: u64) -> (u64, bool) {
        let trip_ns = now_ns.saturating_sub(sent_ns);
        let before_ns = self.last_pong_ns.replace(now_ns);
        if self.is_timed {
            self.correct(now_ns, before_ns);
            if trip_ns <= self.period_ns / 2 {
                self.misses = 0;
                // Halve it until a ping was too late, then reduce it carefully.
                let step_ns = self.lead_ns / if self.missed { 4 } else { 2 };
                self.lead_ns = (self.lead_ns - step_ns).max(LEAD_MIN_NS);
            } else if trip_ns <= 2 * self.period_ns {
                self.misses += 1;
                self.missed = true;
                self.lead_ns = self.lead_ns.saturating_mul(2).min(self.period_ns / 2);
                if self.misses >= MISSES_MAX {
                    *self = Self { last_pong_ns: self.last_pong_ns, ..Self::default() };
                    return (now_ns, false);
                }
            }
        } else if trip_ns < QUICK_NS {
            self.period_ns = 0;
            return (now_ns.saturating_add(SPACING_NS), false);
        } else if self.period_ns == 0 {
            // A ping sent as soon as the preceding pong came, with a batch, was answered with the next batch.
            if let Some(before_ns) = before_ns
                && sent_ns.saturating_sub(before_ns) < QUICK_NS
            {
                self.period_ns = now_ns.saturating_sub(before_ns);
                self.lead_ns = (self.period_ns / 16).max(LEAD_MIN_NS);
                (self.misses, self.missed) = (0, false);
            } else {
                return (now_ns, false);
            }
        }
        if (QUICK_NS..=PERIOD_MAX_NS).contains(&self.period_ns) {
            return (now_ns.saturating_add(self.period_ns - self.lead_ns), true);
        }
        self.period_ns = 0;
        (now_ns.saturating_add(SPACING_NS), false)
    }
}

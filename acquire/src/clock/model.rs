//! The clock model of a recording: segments, the line of the current segment, and the lateness of frames.

use mocapd_take::record::{ClockFit, ClockJitter, ClockLine, ClockPoint, ClockProbe};

use super::{
    Line,
    observations::{Arrivals, Bursts, lines},
    seconds,
};
use crate::host_clock::LatencyHistogram;

/// An item of the clock model for the take to store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ClockItem {
    /// The earliest frame of a bin, with the segment's number.
    Point(u32, ClockPoint),
    /// A round trip, with the segment's number.
    Probe(u32, ClockProbe),
    /// The final line of a segment that is over.
    Line(u32, ClockLine),
}

/// Stores an item in the take. Returns `false` when it cannot, and then the line is not fitted to the item either.
pub type StoreItem<'a> = dyn FnMut(ClockItem) -> bool + 'a;

/// A discontinuity of the device's clock: a new segment begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ClockEvent {
    /// The ticks went back by this many seconds.
    WentBack(f64),
    /// A 32-bit counter wrapped to 0.
    Wrapped,
    /// The clock jumped ahead by this many seconds; back when negative.
    Jumped(f64),
}

/// The state of the clocks at one moment of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ClockStatus {
    /// Number of the segment, from 0.
    pub segment: u32,
    /// Device clock ticks per second.
    pub tick_hz: u64,
    /// The line.
    pub line: Option<ClockLine>,
    /// The lateness of frames.
    pub jitter: ClockJitter,
    /// Round trips so far.
    pub probes: u64,
    /// Frames kept for the line so far.
    pub points: u64,
    /// Root mean square distance of arrivals from the line, in microseconds.
    pub residual_us: f64,
    /// Items stored so far: the line was fitted to these and to no later ones.
    pub stored: u64,
}

impl ClockStatus {
    /// The fit as stored in a ledger.
    #[must_use]
    pub fn ledger(&self) -> Option<ClockFit> {
        let line = self.line?;
        let drift_ppm = line.drift_ppb as f64 / 1e3;
        let at_s = line.device_ticks as f64 / self.tick_hz.max(1) as f64;
        Some(ClockFit {
            offset_ns: (line.host_ns as f64 - at_s * (1e9 + drift_ppm * 1e3)) as i64,
            drift_ppm,
            residual_us: self.residual_us,
            n_fitted: self.jitter.frames,
        })
    }
}

/// The clock model. Its memory is bounded, and a single thread feeds it.
#[derive(Debug)]
pub struct ClockModel {
    ticks_per_s: u64,
    tick_hz: f64,
    segment: u32,
    begun_us: Option<u64>,
    /// Ticks and host microseconds of the preceding frame.
    last: Option<(u64, u64)>,
    arrivals: Arrivals,
    bursts: Bursts,
    gate: OutlierGate,
    line: Option<Line>,
    lateness: LatencyHistogram,
    late_squared: f64,
    probes: u64,
    points: u64,
    wants_probes: bool,
}

impl ClockModel {
    /// A model of a device whose clock ticks `tick_hz` times per second.
    #[must_use]
    pub fn new(tick_hz: u64) -> Self {
        Self {
            ticks_per_s: tick_hz,
            tick_hz: tick_hz.max(1) as f64,
            segment: 0,
            begun_us: None,
            last: None,
            arrivals: Arrivals::new(),
            bursts: Bursts::new(),
            gate: OutlierGate::default(),
            line: None,
            lateness: LatencyHistogram::default(),
            late_squared: 0.0,
            probes: 0,
            points: 0,
            wants_probes: false,
        }
    }

    /// Accepts a frame.
    pub fn frame(
        &mut self,
        ticks: u64,
        arrival_ns: u64,
        store: &mut StoreItem<'_>,
    ) -> Option<ClockEvent> {
        let host_us = arrival_ns.div_ceil(1000);
        let before = self.last;
        let silent_us = before.map_or(0, |(_, us)| host_us.saturating_sub(us));
        let mut event = before.and_then(|(last, _)| self.went_back(ticks, last, silent_us));
        if event.is_some() {
            self.restart(store);
        }
        let begun_us = *self.begun_us.get_or_insert(host_us);
        if let Some(line) = self.line {
            let late_us = line.lateness_us(ticks, arrival_ns, self.tick_hz);
            let age_us = host_us.saturating_sub(begun_us);
            match self.gate.frame(late_us, host_us, age_us, silent_us) {
                Gating::Accepted => self.count(late_us),
                // The next frame is compared with the one before this.
                Gating::Outlier => return event,
                Gating::Jumped(by_us) => event = Some(self.jump(by_us, host_us, store)),
            }
            self.wants_probes |= self.gate.is_in_doubt();
        }
        self.last = Some((ticks, host_us));
        let point = ClockPoint { device_ticks: ticks, host_us };
        if let Some(closed) = self.arrivals.add(point, self.drift_ppm(), self.tick_hz) {
            self.keep(closed, store);
        }
        event
    }

    /// Accepts a round trip: a ping sent at `sent_ns` whose pong carried `ticks` and arrived at `answered_ns`.
    pub fn probe(
        &mut self,
        ticks: u64,
        sent_ns: u64,
        answered_ns: u64,
        store: &mut StoreItem<'_>,
    ) -> Option<ClockEvent> {
        let sent_us = sent_ns / 1000;
        let answered_us = answered_ns.div_ceil(1000);
        let round_trip_us = answered_us.saturating_sub(sent_us);
        let probe = ClockProbe { sent_us, device_ticks: ticks, round_trip_us };
        let mut event = None;
        let begun_us = *self.begun_us.get_or_insert(sent_us);
        if let Some(line) = self.line {
            let off = |host_ns: u64| line.lateness_us(ticks, host_ns, self.tick_hz);
            let age_us = sent_us.saturating_sub(begun_us);
            let silent_us = self.last.map_or(0, |(_, us)| sent_us.saturating_sub(us));
            let (sent, answered) = (off(sent_ns), off(answered_ns));
            match self.gate.probe(&line, sent, answered, age_us, silent_us) {
                Gating::Accepted => {}
                // Left out of the line, and so of the take: a refit must not find it.
                Gating::Outlier => return None,
                Gating::Jumped(by_us) => event = Some(self.jump(by_us, sent_us, store)),
            }
        }
        if store(ClockItem::Probe(self.segment, probe)) {
            self.probes += 1;
            self.bursts.add(probe);
            self.refit();
        }
        event
    }

    /// Fits the line to all observations, at the end of a recording.
    pub fn close(&mut self, store: &mut StoreItem<'_>) {
        if let Some(closed) = self.arrivals.close() {
            self.keep(closed, store);
        }
    }

    fn keep(&mut self, point: ClockPoint, store: &mut StoreItem<'_>) {
        if store(ClockItem::Point(self.segment, point)) {
            self.points += 1;
            self.arrivals.keep(point);
            self.refit();
        }
    }

    /// Whether round trips would help now. Returns `true` once.
    pub fn wants_probes(&mut self) -> bool {
        std::mem::take(&mut self.wants_probes)
    }

    /// Number of the current segment.
    pub(crate) fn segment(&self) -> u32 {
        self.segment
    }

    /// The line of the current segment.
    #[must_use]
    pub fn line(&self) -> Option<&Line> {
        self.line.as_ref()
    }

    /// The state of the clocks.
    #[must_use]
    pub fn status(&self) -> ClockStatus {
        let late = &self.lateness;
        let us = |ns: u64| ns.div_ceil(1000);
        let residual_us = (self.late_squared / late.count().max(1) as f64).sqrt();
        ClockStatus {
            segment: self.segment,
            tick_hz: self.ticks_per_s,
            line: self.line.map(|line| line.stored()),
            jitter: ClockJitter {
                frames: late.count(),
                residual_us: residual_us.round() as u64,
                p50_us: us(late.quantile_ns(0.5)),
                p99_us: us(late.quantile_ns(0.99)),
                max_us: us(late.max_ns()),
            },
            probes: self.probes,
            points: self.points,
            residual_us,
            stored: 0,
        }
    }

    /// Starts a new segment, because the device's clock jumped.
    fn jump(&mut self, by_us: f64, host_us: u64, store: &mut StoreItem<'_>) -> ClockEvent {
        self.restart(store);
        self.begun_us = Some(host_us);
        ClockEvent::Jumped(by_us * 1e-6)
    }

    fn count(&mut self, late_us: f64) {
        self.lateness.add((late_us.max(0.0) * 1e3) as u64);
        self.late_squared += late_us * late_us;
    }

    fn refit(&mut self) {
        let fits = lines(self.arrivals.points(), &self.bursts, self.drift_ppm(), self.tick_hz);
        self.line = fits.last().or(self.line);
    }

    fn drift_ppm(&self) -> f64 {
        self.line.map_or(0.0, |line| line.drift_ppm)
    }

    /// Detects a clock that went back. A 64-bit counter wraps after thousands of years, a 32-bit one within
    /// minutes.
    fn went_back(&self, ticks: u64, last: u64, silent_us: u64) -> Option<ClockEvent> {
        let by = last.wrapping_sub(ticks).cast_signed();
        if by <= 0 {
            return None;
        }
        let wrapped_s = seconds(ticks.wrapping_add(1 << 32), last, self.tick_hz);
        let elapsed_s = silent_us as f64 * 1e-6;
        let is_wrap = last >> 32 == 0 && (wrapped_s - elapsed_s).abs() < 0.1 + elapsed_s * 0.1;
        let back_s = by as f64 / self.tick_hz;
        Some(if is_wrap { ClockEvent::Wrapped } else { ClockEvent::WentBack(back_s) })
    }

    /// Starts a new segment after the device was disconnected: its clock may or may not have continued, and its line to
    /// the host may be another.
    pub fn rejoin(&mut self, store: &mut StoreItem<'_>) {
        self.restart(store);
        self.last = None;
    }

    /// Starts a new segment. What is known of the old one is in the take.
    fn restart(&mut self, store: &mut StoreItem<'_>) {
        // A clock that jumps with every frame leaves nothing worth storing.
        if self.line.is_some() {
            self.close(store);
        }
        if let Some(line) = self.line {
            // If the take cannot store the line, the segment has none.
            store(ClockItem::Line(self.segment, line.stored()));
        }
        self.segment = self.segment.saturating_add(1);
        self.begun_us = None;
        self.arrivals = Arrivals::new();
        self.bursts = Bursts::new();
        self.gate = OutlierGate::default();
        self.line = None;
        self.wants_probes = true;
    }
}

/// Tolerance in addition to the measured one: for a line fitted to few points, and for the scheduler.
const SLACK_US: f64 = 2_000.0;

/// Age below which a batch of frames may have tilted a segment's line.
const YOUNG_US: u64 = 3_000_000;
const YOUNG_SLACK_US: f64 = 100_000.0;

/// How fast a line may become wrong without observations, in microseconds per second: ten times the error of
/// a crystal.
const STALE_US_PER_S: f64 = 1_000.0;

/// Multiple of the mean lateness that is still normal: batches are late by up to twice their mean.
const LATENESS_FACTOR: f64 = 4.0;

/// Length of a run of outliers that makes a jump: damage that its checksum does not show is a single one.
const RUN_MIN: u32 = 3;

/// Frames that stay late for this long are not held up any more: the clock fell behind.
const LATE_FOR_US: u64 = 30_000_000;

/// How the gate classifies an observation.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Gating {
    Accepted,
    /// An outlier, which is left out; it may be the first observation after a jump.
    Outlier,
    /// The clock jumped ahead by this many microseconds; back when negative.
    Jumped(f64),
}

/// Separates outliers from jumps of the device's clock, within one segment.
#[derive(Debug, Default)]
struct OutlierGate {
    mean_late_us: f64,
    n_late: u64,
    early: u32,
    missed: u32,
    late_since_us: Option<u64>,
    late: u32,
}

impl OutlierGate {
    fn slack_us(&self, age_us: u64, silent_us: u64) -> f64 {
        let young = if age_us < YOUNG_US { YOUNG_SLACK_US } else { 0.0 };
        let stale = silent_us as f64 * 1e-6 * STALE_US_PER_S;
        SLACK_US + young + stale + LATENESS_FACTOR * self.mean_late_us
    }

    /// Classifies a frame: its lateness against the line, its arrival, the age of the segment, and the time since the
    /// preceding observation.
    fn frame(&mut self, late_us: f64, host_us: u64, age_us: u64, silent_us: u64) -> Gating {
        let slack_us = self.slack_us(age_us, silent_us);
        if late_us < -slack_us {
            self.early += 1;
            return if self.early >= RUN_MIN { Gating::Jumped(-late_us) } else { Gating::Outlier };
        }
        self.early = 0;
        if late_us > slack_us + YOUNG_SLACK_US {
            self.late = self.late.saturating_add(1);
            let since_us = *self.late_since_us.get_or_insert(host_us);
            if host_us.saturating_sub(since_us) > LATE_FOR_US {
                return Gating::Jumped(-late_us);
            }
            return Gating::Accepted;
        }
        self.late_since_us = None;
        self.late = 0;
        // The mean of the last thousand.
        self.n_late = (self.n_late + 1).min(1000);
        self.mean_late_us += (late_us.max(0.0) - self.mean_late_us) / self.n_late as f64;
        Gating::Accepted
    }

    /// Classifies a round trip, given how late its ping and its pong were against the line.
    fn probe(
        &mut self,
        line: &Line,
        sent_us: f64,
        answered_us: f64,
        age_us: u64,
        silent_us: u64,
    ) -> Gating {
        let Some(bound) = line.bound else { return Gating::Accepted };
        let young = if age_us < YOUNG_US { YOUNG_SLACK_US } else { 0.0 };
        let slack_us =
            SLACK_US + young + bound.offset_us + silent_us as f64 * 1e-6 * STALE_US_PER_S;
        let off_us = if sent_us > slack_us {
            -sent_us
        } else if answered_us < -slack_us {
            -answered_us
        } else {
            self.missed = 0;
            // Frames that are late together with a round trip that is not show a delay, not another clock.
            self.late_since_us = None;
            return Gating::Accepted;
        };
        self.missed += 1;
        if self.missed >= RUN_MIN { Gating::Jumped(off_us) } else { Gating::Outlier }
    }

    /// Whether a round trip would distinguish late frames from a clock that fell behind.
    fn is_in_doubt(&self) -> bool {
        self.late == RUN_MIN
    }
}

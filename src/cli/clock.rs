//! The device's clock against the host's, as JSON and as text, for `info` and `record`.

use std::fmt::Write;

use mocapd_acquire::clock::ClockStatus;
use mocapd_take::record::{ClockJitter, ClockLine};
use serde::Serialize;

use super::values::count;

#[derive(Debug, Serialize)]
pub(crate) struct ClockReport {
    method: &'static str,
    offset_ns: i64,
    drift_ppm: f64,
    bound_us: Option<u64>,
    drift_bound_ppm: Option<f64>,
    at: ClockPoint,
    residual_us: u64,
    jitter_us: Jitter,
    frames: u64,
    probes: u64,
    points: u64,
    segments: u64,
    lines: Vec<LineReport>,
}

/// Maximum number of earlier segments that the text lists.
const LINES_SHOWN: usize = 8;

/// The fitted line of one clock segment.
#[derive(Debug, Serialize)]
struct LineReport {
    segment: u32,
    drift_ppm: f64,
    bound_us: Option<u64>,
    drift_bound_ppm: Option<f64>,
    at: ClockPoint,
}

impl LineReport {
    fn new(segment: u32, line: &ClockLine) -> Self {
        let &ClockLine { device_ticks, host_ns, drift_ppb, bound } = line;
        Self {
            segment,
            drift_ppm: drift_ppb as f64 / 1e3,
            bound_us: bound.map(|bound| bound.offset_us),
            drift_bound_ppm: bound.map(|bound| bound.drift_ppb as f64 / 1e3),
            at: ClockPoint { device_ticks, host_ns },
        }
    }
}

/// The reference point of a line: a device time, and the host time that the line gives for it.
#[derive(Debug, Serialize)]
struct ClockPoint {
    device_ticks: u64,
    host_ns: u64,
}

#[derive(Debug, Serialize)]
struct Jitter {
    p50: u64,
    p99: u64,
    max: u64,
}

impl ClockReport {
    /// `lines` holds the line of each segment that has one. `None` if the last segment has none.
    pub(crate) fn new(status: &ClockStatus, lines: &[(u32, ClockLine)]) -> Option<Self> {
        let ClockLine { device_ticks, host_ns, bound, .. } = status.line?;
        let fit = status.ledger()?;
        let ClockJitter { frames, residual_us, p50_us, p99_us, max_us } = status.jitter;
        Some(Self {
            method: if bound.is_some() { "round trips" } else { "arrivals" },
            offset_ns: fit.offset_ns,
            drift_ppm: fit.drift_ppm,
            bound_us: bound.map(|bound| bound.offset_us),
            drift_bound_ppm: bound.map(|bound| bound.drift_ppb as f64 / 1e3),
            at: ClockPoint { device_ticks, host_ns },
            residual_us,
            jitter_us: Jitter { p50: p50_us, p99: p99_us, max: max_us },
            frames,
            probes: status.probes,
            points: status.points,
            segments: u64::from(status.segment) + 1,
            lines: lines.iter().map(|(segment, line)| LineReport::new(*segment, line)).collect(),
        })
    }

    /// Indented text, one line per fact.
    pub(crate) fn text(&self) -> String {
        let mut out = String::from("clock\n");
        let mut line = |name: &str, text: &str| {
            writeln!(out, "  {name:>15} {text}").ok();
        };
        let within = match self.drift_bound_ppm {
            Some(ppm) => format!(" +- {ppm:.1} ppm"),
            None => " ppm, accuracy unknown without round trips".to_owned(),
        };
        let faster = self.faster_clock();
        line("drift", &format!("{:+.1}{within}: {faster}", self.drift_ppm));
        let ClockPoint { device_ticks, host_ns } = self.at;
        let host_s = host_ns as f64 * 1e-9;
        let known = match self.bound_us {
            Some(us) => format!("within {us} us, by {}", count(self.probes, "round trip")),
            None => {
                "late by the shortest frame delay, which is unknown without round trips".to_owned()
            }
        };
        let offset = format!("device tick {device_ticks} is {host_s:.6} s of host time, {known}");
        line("offset", &offset);
        let Jitter { p50, p99, max } = self.jitter_us;
        let jitter =
            format!("frames arrived {p50} us after that (p50), {p99} us (p99), {max} us (max)");
        line("jitter", &format!("{jitter}; {} us rms", self.residual_us));
        if self.segments > 1 {
            let segments = count(self.segments, "segment");
            let why = "the device disconnected, its clock jumped, or takes were joined";
            line("segments", &format!("{segments}: {why}; this is the last"));
            let earlier =
                self.lines.iter().filter(|line| u64::from(line.segment) + 1 < self.segments);
            let shown = earlier.clone().take(LINES_SHOWN);
            for LineReport { segment, drift_ppm, bound_us, .. } in shown {
                let known = bound_us.map_or(String::new(), |us| format!(", within {us} us"));
                line("", &format!("segment {segment}: drift {drift_ppm:+.1} ppm{known}"));
            }
            let more = earlier.count().saturating_sub(LINES_SHOWN);
            if more > 0 {
                line("", &format!("and {more} more: see --json"));
            }
        }
        out
    }

    fn faster_clock(&self) -> &'static str {
        if self.drift_bound_ppm.is_some_and(|bound| self.drift_ppm.abs() <= bound) {
            "no significant difference"
        } else if self.drift_ppm >= 0.0 {
            "the host's clock runs faster than the device's"
        } else {
            "the device's clock runs faster than the host's"
        }
    }
}

//! Long silences of a device that is there.

use mocapd_take::record::{Event, EventKind};

use super::Intake;

/// A silence so long is an event.
const SILENCE_S: f64 = 1.0;

/// Or so many frames' time, at a low rate.
const SILENCE_FRAMES: f64 = 10.0;

/// Silences that get an event. More are a device that stutters: the time line has each of its frames.
const EVENTS_MAX: u32 = 256;

/// When the last frame came, and how often it took long.
#[derive(Debug)]
pub(super) struct Silences {
    longest_ns: u64,
    last_arrival_ns: Option<u64>,
    n_events: u32,
}

impl Silences {
    pub(super) fn new(rate_hz: f64) -> Self {
        let longest_ns = (SILENCE_S.max(SILENCE_FRAMES / rate_hz) * 1e9) as u64;
        Self { longest_ns, last_arrival_ns: None, n_events: 0 }
    }

    /// How long no frame had come until now; none had come before the first.
    pub(super) fn until_ns(&self, arrival_ns: u64) -> u64 {
        self.last_arrival_ns.map_or(0, |last_ns| arrival_ns.saturating_sub(last_ns))
    }

    fn frame(&mut self, arrival_ns: u64) -> Option<f64> {
        let silent_ns = self.until_ns(arrival_ns);
        self.last_arrival_ns = Some(arrival_ns);
        if silent_ns < self.longest_ns || self.n_events == EVENTS_MAX {
            return None;
        }
        self.n_events += 1;
        Some(silent_ns as f64 * 1e-9)
    }
}

impl Intake {
    /// A frame arrived. `is_told`: why it took long is told elsewhere.
    pub(super) fn end_silence(&mut self, device_ticks: u64, arrival_ns: u64, is_told: bool) {
        if let Some(silent_s) = self.silences.frame(arrival_ns)
            && !is_told
        {
            self.event(Event {
                kind: EventKind::Host,
                row: 0,
                device_ticks,
                host_ns: arrival_ns,
                input: 0,
                text: format!("no frame came for {silent_s:.3} s"),
            });
        }
    }
}

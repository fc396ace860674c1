//! Long silences of a device that is there.

use mocapd_take::{
    record::{Event, EventKind},
    timeline::Causes,
};

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
    /// When the device said last that it had produced no more than came.
    accounted_ns: u64,
    n_events: u32,
}

impl Silences {
    pub(super) fn new(rate_hz: f64) -> Self {
        let longest_ns = (SILENCE_S.max(SILENCE_FRAMES / rate_hz) * 1e9) as u64;
        Self { longest_ns, last_arrival_ns: None, accounted_ns: 0, n_events: 0 }
    }

    /// How long no frame had come until now; none had come before the first.
    pub(super) fn until_ns(&self, arrival_ns: u64) -> u64 {
        self.last_arrival_ns.map_or(0, |last_ns| arrival_ns.saturating_sub(last_ns))
    }

    /// The device says that all its frames have come.
    pub(super) fn account(&mut self, now_ns: u64) {
        self.accounted_ns = now_ns;
    }

    /// Of [`until_ns`](Self::until_ns), the time after the device's last word.
    pub(super) fn unaccounted_ns(&self, now_ns: u64) -> u64 {
        self.until_ns(now_ns).min(now_ns.saturating_sub(self.accounted_ns))
    }

    /// How long no frame has come, where that is long.
    pub(super) fn lasts(&mut self, now_ns: u64) -> Option<f64> {
        let silent_ns = self.until_ns(now_ns);
        if silent_ns < self.longest_ns || self.n_events == EVENTS_MAX {
            return None;
        }
        self.n_events += 1;
        Some(silent_ns as f64 * 1e-9)
    }

    fn frame(&mut self, arrival_ns: u64) -> Option<f64> {
        let lasted = self.lasts(arrival_ns);
        self.last_arrival_ns = Some(arrival_ns);
        lasted
    }
}

impl Intake {
    /// A frame arrived. `is_told`: why it took long is told elsewhere.
    pub(super) fn end_silence(&mut self, device_ticks: u64, arrival_ns: u64, is_told: bool) {
        if let Some(silent_s) = self.silences.frame(arrival_ns)
            && !is_told
        {
            self.silence_event(silent_s, device_ticks, arrival_ns);
        }
    }

    /// A take ends: what was due since the last frame, by the host's clock, is that take's loss, and stands in it, when
    /// the device is away or has been silent for long.
    pub(super) fn count_absence(&mut self, now_ns: u64) {
        let until_ns = self.due_until_ns.map_or(now_ns, |due_ns| due_ns.min(now_ns));
        let silent_ns = if self.is_away {
            self.silences.until_ns(until_ns)
        } else if let Some(silent_s) = self.silences.lasts(until_ns) {
            self.silence_event(silent_s, 0, until_ns);
            self.silences.unaccounted_ns(until_ns)
        } else {
            return;
        };
        // Its last word tells of every frame.
        if self.counts.ended {
            return;
        }
        let new = self.due(silent_ns as f64 * 1e-9).saturating_sub(self.rows_away);
        self.rows_away += new;
        if self.is_away {
            self.counts.lost_to_outage(new);
        } else {
            self.counts.lost_to_silence(new);
        }
        self.pending.add(new, Causes::DISCONNECTED);
    }

    fn silence_event(&mut self, silent_s: f64, device_ticks: u64, host_ns: u64) {
        let text = format!("no frame came for {silent_s:.3} s");
        self.event(Event { kind: EventKind::Host, row: 0, device_ticks, host_ns, input: 0, text });
    }
}

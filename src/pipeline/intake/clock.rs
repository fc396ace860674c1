//! The clocks of a recording: what frames and pongs say of them, and where that goes.

use crossbeam_channel::Sender;
use mocapd_take::record::{Event, EventKind};

use super::Intake;
use crate::clock::{ClockEvent, ClockItem, ClockModel, ClockStatus};

/// Jumps that get an event of their own. More are a device without a clock: the segments count them.
const EVENTS_MAX: u32 = 32;

/// The model, and the way to the writer.
#[derive(Debug)]
pub(super) struct Clocks {
    model: ClockModel,
    items: Sender<ClockItem>,
    /// Items that found the writer's queue full.
    dropped: u64,
    events: u32,
}

impl Clocks {
    pub(super) fn new(tick_hz: u64, items: Sender<ClockItem>) -> Self {
        Self { model: ClockModel::new(tick_hz), items, dropped: 0, events: 0 }
    }

    pub(super) fn frame(&mut self, ticks: u64, arrival_ns: u64) -> Option<ClockEvent> {
        let Self { model, items, dropped, .. } = self;
        model.frame(ticks, arrival_ns, &mut |item| {
            *dropped += u64::from(items.try_send(item).is_err());
        })
    }

    fn probe(&mut self, ticks: u64, sent_ns: u64, answered_ns: u64) -> Option<ClockEvent> {
        let Self { model, items, dropped, .. } = self;
        let store = &mut |item| *dropped += u64::from(items.try_send(item).is_err());
        model.probe(ticks, sent_ns, answered_ns, store)
    }

    pub(super) fn rejoin(&mut self) {
        let Self { model, items, dropped, .. } = self;
        model.rejoin(&mut |item| *dropped += u64::from(items.try_send(item).is_err()));
    }

    pub(super) fn close(&mut self) {
        let Self { model, items, dropped, .. } = self;
        model.close(&mut |item| *dropped += u64::from(items.try_send(item).is_err()));
    }

    pub(super) fn status(&self) -> ClockStatus {
        ClockStatus { dropped: self.dropped, ..self.model.status() }
    }
}

impl Intake {
    /// A ping of `sent_ns` whose pong said `device_ticks` and arrived at `answered_ns`, by the host's monotonic
    /// clock.
    pub fn probe(&mut self, device_ticks: u64, sent_ns: u64, answered_ns: u64) {
        let event = self.clocks.probe(device_ticks, sent_ns, answered_ns);
        self.clock_event(event, device_ticks, answered_ns);
    }

    /// Whether the clocks are in doubt, and round trips would help. Said once.
    pub fn wants_probes(&mut self) -> bool {
        self.clocks.model.wants_probes()
    }

    pub(super) fn clock_event(
        &mut self,
        event: Option<ClockEvent>,
        device_ticks: u64,
        host_ns: u64,
    ) {
        let Some(event) = event else { return };
        self.counts.clock_jumps += u64::from(matches!(event, ClockEvent::WentBack(_)));
        self.clocks.events += 1;
        if self.clocks.events > EVENTS_MAX {
            return;
        }
        let what = match event {
            ClockEvent::WentBack(by_s) => format!("went back by {by_s:.3} s"),
            ClockEvent::Wrapped => "counts in 32 bits and began again at 0".to_owned(),
            ClockEvent::Jumped(by_s) if by_s >= 0.0 => format!("jumped ahead by {by_s:.3} s"),
            ClockEvent::Jumped(by_s) => format!("fell behind by {:.3} s", -by_s),
        };
        self.event(Event {
            kind: EventKind::Host,
            row: 0,
            device_ticks,
            host_ns,
            input: 0,
            text: format!("the device's clock {what}"),
        });
    }
}

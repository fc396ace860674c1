//! The clocks of a recording: takes observations from frames and pongs, and passes them to the writer.

use crossbeam_channel::Sender;
use mocapd_take::record::{Event, EventKind};

use super::Intake;
use crate::clock::{ClockEvent, ClockItem, ClockModel, ClockStatus};

/// Clock jumps and omitted observations that get an event of their own. More jumps mean a device without a
/// clock: the segments count them.
const EVENTS_MAX: u32 = 32;

/// The clock model, and its queue to the writer.
#[derive(Debug)]
pub(super) struct ClockTracker {
    model: ClockModel,
    queue: ClockQueue,
    events: u32,
}

/// The queue to the writer. If it is full, an item is neither stored in the take nor used to fit the line.
#[derive(Debug)]
struct ClockQueue {
    items: Sender<ClockItem>,
    sent: u64,
    /// Whether an item was refused, and the queue has not been empty since.
    is_overflowing: bool,
    /// Whether an overflow has not been reported yet.
    has_new_overflow: bool,
}

impl ClockQueue {
    fn send(&mut self, item: ClockItem) -> bool {
        self.is_overflowing &= !self.items.is_empty();
        let is_sent = self.items.try_send(item).is_ok();
        self.sent += u64::from(is_sent);
        self.has_new_overflow |= !is_sent && !self.is_overflowing;
        self.is_overflowing |= !is_sent;
        is_sent
    }
}

impl ClockTracker {
    pub(super) fn new(tick_hz: u64, items: Sender<ClockItem>) -> Self {
        let queue = ClockQueue { items, sent: 0, is_overflowing: false, has_new_overflow: false };
        Self { model: ClockModel::new(tick_hz), queue, events: 0 }
    }

    pub(super) fn frame(&mut self, ticks: u64, arrival_ns: u64) -> Option<ClockEvent> {
        self.model.frame(ticks, arrival_ns, &mut |item| self.queue.send(item))
    }

    fn probe(&mut self, ticks: u64, sent_ns: u64, answered_ns: u64) -> Option<ClockEvent> {
        self.model.probe(ticks, sent_ns, answered_ns, &mut |item| self.queue.send(item))
    }

    pub(super) fn rejoin(&mut self) {
        self.model.rejoin(&mut |item| self.queue.send(item));
    }

    pub(super) fn close(&mut self) {
        self.model.close(&mut |item| self.queue.send(item));
    }

    /// The present segment of the device's clock.
    pub(super) fn segment(&self) -> u32 {
        self.model.segment()
    }

    pub(super) fn status(&self) -> ClockStatus {
        ClockStatus { stored: self.queue.sent, ..self.model.status() }
    }
}

impl Intake {
    /// Accepts a round trip: a ping sent at `sent_ns` whose pong carried `device_ticks` and arrived at `answered_ns`,
    /// by the host's monotonic clock.
    pub fn probe(&mut self, device_ticks: u64, sent_ns: u64, answered_ns: u64) {
        let event = self.clocks.probe(device_ticks, sent_ns, answered_ns);
        self.clock_events(event, device_ticks, answered_ns);
    }

    /// Whether the clocks are in doubt and round trips would help. Returns `true` once.
    pub fn wants_probes(&mut self) -> bool {
        self.clocks.model.wants_probes()
    }

    /// Records the events that the last frame or pong revealed.
    pub(super) fn clock_events(&mut self, event: Option<ClockEvent>, ticks: u64, host_ns: u64) {
        if std::mem::take(&mut self.clocks.queue.has_new_overflow) {
            let text = "the disk stalls: some clock observations are missing from the take and from its clock line";
            self.clock_event(text.to_owned(), ticks, host_ns);
        }
        let Some(event) = event else { return };
        self.counts.clock_jumps += u64::from(matches!(event, ClockEvent::WentBack(_)));
        let what = match event {
            ClockEvent::WentBack(by_s) => format!("went back by {by_s:.3} s"),
            ClockEvent::Wrapped => "wrapped at 32 bits".to_owned(),
            ClockEvent::Jumped(by_s) if by_s >= 0.0 => format!("jumped ahead by {by_s:.3} s"),
            ClockEvent::Jumped(by_s) => format!("fell behind by {:.3} s", -by_s),
        };
        self.clock_event(format!("the device's clock {what}"), ticks, host_ns);
    }

    fn clock_event(&mut self, text: String, device_ticks: u64, host_ns: u64) {
        self.clocks.events += 1;
        if self.clocks.events <= EVENTS_MAX {
            let event = Event::new(EventKind::Host, host_ns, text);
            self.event(Event { device_ticks, ..event });
        }
    }
}

//! Accepted triggers that wait for execution, in limited numbers.
//!
//! A trigger without a delay is due immediately, and executed after the previous one. A delayed trigger is due later
//! and delays nothing else. [`PendingTriggers`] is sans-io: the time goes in, and due triggers come out.
//! [`TriggerQueue`] applies it in real time, between the thread that receives triggers and the one that executes them.

use std::{
    net::{IpAddr, SocketAddr},
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use crossbeam_channel::{Receiver, Sender, bounded};
use mocapd_acquire::pipeline::lock;

use super::{Trigger, TriggerError};

/// Maximum number of undelayed triggers that wait. Execution takes milliseconds, and a laboratory sends one every few
/// seconds: if this many wait, the service is stuck, and a start executed minutes later would be useless.
pub const DUE_MAX: usize = 16;

/// Maximum number of undelayed triggers of one sender that is not in `trigger.allow_from`: the stop of one take and the
/// start of the next, twice.
pub const DUE_EACH_MAX: usize = 4;

/// Maximum number of delayed triggers of all senders in `trigger.allow_from`: a start and a stop of eight machines.
pub const DELAYED_MAX: usize = 16;

/// Maximum number of delayed triggers of all other senders, one each: eight unlisted machines.
pub const DELAYED_OTHERS_MAX: usize = 8;

/// An accepted trigger.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReceivedTrigger {
    /// The sender.
    pub from: SocketAddr,
    /// The trigger.
    pub trigger: Trigger,
    /// Whether `trigger.allow_from` lists the sender.
    pub is_known: bool,
    /// The take that was being recorded when it arrived.
    pub recording: Option<String>,
}

impl ReceivedTrigger {
    /// The address that identifies the sender.
    #[must_use]
    pub fn sender(&self) -> IpAddr {
        self.from.ip().to_canonical()
    }
}

/// The pending triggers.
#[derive(Debug, Default)]
pub struct PendingTriggers {
    entries: Vec<Entry>,
    next_number: u64,
}

#[derive(Debug)]
struct Entry {
    due: Duration,
    /// In order of arrival.
    number: u64,
    is_delayed: bool,
    received: ReceivedTrigger,
}

impl PendingTriggers {
    /// Accepts a trigger received at `now`.
    ///
    /// # Errors
    /// Too many triggers are pending.
    pub fn push(&mut self, received: ReceivedTrigger, now: Duration) -> Result<(), TriggerError> {
        let delay = received.trigger.delay();
        let is_delayed = delay > Duration::ZERO;
        let (sender, is_known) = (received.sender(), received.is_known);
        let same_kind = || self.entries.iter().filter(|entry| entry.is_delayed == is_delayed);
        let all =
            same_kind().filter(|entry| !is_delayed || entry.received.is_known == is_known).count();
        let own = same_kind().filter(|entry| entry.received.sender() == sender).count();
        let (all_max, own_max) = match (is_delayed, is_known) {
            (false, true) => (DUE_MAX, None),
            (false, false) => (DUE_MAX, Some(DUE_EACH_MAX)),
            (true, true) => (DELAYED_MAX, None),
            (true, false) => (DELAYED_OTHERS_MAX, Some(1)),
        };
        if own_max.is_some_and(|max| own >= max) {
            return Err(TriggerError::TooManyOfSender { waiting: own, sender });
        }
        if all >= all_max {
            return Err(TriggerError::TooMany(all));
        }
        let number = self.next_number;
        self.next_number += 1;
        self.entries.push(Entry { due: now.saturating_add(delay), number, is_delayed, received });
        Ok(())
    }

    /// The number of pending triggers.
    #[must_use]
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether no trigger is pending.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The time when the next trigger is due.
    #[must_use]
    pub fn next_due(&self) -> Option<Duration> {
        self.entries.iter().map(|entry| entry.due).min()
    }

    /// Takes the next trigger due at `now`, in order of due times.
    pub fn take_due(&mut self, now: Duration) -> Option<ReceivedTrigger> {
        let due = |at: &usize| self.entries[*at].due <= now;
        let order = |at: &usize| (self.entries[*at].due, self.entries[*at].number);
        let at = (0..self.entries.len()).filter(due).min_by_key(order)?;
        Some(self.entries.swap_remove(at).received)
    }

    /// Cancels pending starts of a sender: those of the named take, or all if `name` is `None`. Returns how many there
    /// were.
    pub fn cancel_starts(&mut self, from: SocketAddr, name: Option<&str>) -> usize {
        let before = self.entries.len();
        self.entries.retain(|entry| {
            let Trigger::Start(start) = &entry.received.trigger else { return true };
            let has_name = match (name, &start.name) {
                (Some(name), Some(start)) => start.text() == name,
                _ => true,
            };
            entry.received.sender() != from.ip().to_canonical() || !has_name
        });
        before - self.entries.len()
    }
}

/// The pending triggers, shared by two threads.
#[derive(Debug, Clone)]
pub struct TriggerQueue {
    waiting: Arc<Mutex<PendingTriggers>>,
    /// Holds at most one message: the next due time may have changed.
    wake: Sender<()>,
    woken: Receiver<()>,
    created: Instant,
}

impl Default for TriggerQueue {
    fn default() -> Self {
        let (wake, woken) = bounded(1);
        Self { waiting: Arc::default(), wake, woken, created: Instant::now() }
    }
}

impl TriggerQueue {
    /// The current time, by the clock of the due times.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.created.elapsed()
    }

    /// Accepts a trigger that has just arrived.
    ///
    /// # Errors
    /// Too many triggers are pending.
    pub fn push(&self, received: ReceivedTrigger) -> Result<(), TriggerError> {
        lock(&self.waiting).push(received, self.now())?;
        // If the channel is full, the receiver will wake up anyway.
        self.wake.try_send(()).ok();
        Ok(())
    }

    /// Takes the next trigger that is due now.
    #[must_use]
    pub fn take_due(&self) -> Option<ReceivedTrigger> {
        lock(&self.waiting).take_due(self.now())
    }

    /// The time until the next trigger is due; `None` if none is pending.
    #[must_use]
    pub fn due_in(&self) -> Option<Duration> {
        Some(lock(&self.waiting).next_due()?.saturating_sub(self.now()))
    }

    /// Receives a message when the next due time may have changed.
    #[must_use]
    pub fn woken(&self) -> &Receiver<()> {
        &self.woken
    }

    /// Cancels pending starts of a sender, and returns their number, as [`PendingTriggers::cancel_starts`] does.
    #[must_use]
    pub fn cancel_starts(&self, from: SocketAddr, name: Option<&str>) -> usize {
        lock(&self.waiting).cancel_starts(from, name)
    }
}

#[cfg(test)]
mod tests {
    use super::{super::Capture, *};

    fn start(sender: u8, is_known: bool, delay_ms: u64) -> ReceivedTrigger {
        let delay = Duration::from_millis(delay_ms);
        ReceivedTrigger {
            from: SocketAddr::from(([192, 0, 2, sender], 1)),
            trigger: Trigger::Start(Capture { delay, ..Capture::default() }),
            is_known,
            recording: None,
        }
    }

    #[test]
    fn triggers_come_in_order_of_due_times() {
        let mut waiting = PendingTriggers::default();
        let at = Duration::from_millis;
        for (sender, delay_ms) in [(1, 300), (2, 100), (3, 0), (4, 0)] {
            waiting.push(start(sender, true, delay_ms), at(1000)).unwrap();
        }
        let mut due = |ms: u64| waiting.take_due(at(ms)).map(|due| due.from.ip().to_string());
        assert_eq!(due(1000).as_deref(), Some("192.0.2.3"));
        assert_eq!(due(1000).as_deref(), Some("192.0.2.4"));
        assert_eq!(due(1099), None);
        assert_eq!(due(2000).as_deref(), Some("192.0.2.2"));
        assert_eq!(waiting.next_due(), Some(at(1300)));
    }

    #[test]
    fn one_delayed_trigger_per_unlisted_sender_and_eight_in_all() {
        let mut waiting = PendingTriggers::default();
        let mut push = |received| waiting.push(received, Duration::ZERO);
        for sender in 0..DELAYED_OTHERS_MAX as u8 {
            push(start(sender, false, 1)).unwrap();
            let again = push(start(sender, false, 1));
            assert!(matches!(again, Err(TriggerError::TooManyOfSender { waiting: 1, .. })));
        }
        assert_eq!(push(start(99, false, 1)), Err(TriggerError::TooMany(DELAYED_OTHERS_MAX)));
        // They take nothing away from undelayed triggers, or from listed senders.
        for _ in 0..DUE_EACH_MAX {
            push(start(0, false, 0)).unwrap();
        }
        assert!(push(start(0, false, 0)).is_err());
        push(start(1, false, 0)).unwrap();
        for _ in 0..DELAYED_MAX {
            push(start(100, true, 1)).unwrap();
        }
        assert_eq!(push(start(100, true, 1)), Err(TriggerError::TooMany(DELAYED_MAX)));
    }

    #[test]
    fn a_listed_sender_has_no_limit_of_its_own() {
        for (delay_ms, max) in [(0, DUE_MAX), (1, DELAYED_MAX)] {
            let mut waiting = PendingTriggers::default();
            for _ in 0..max {
                waiting.push(start(1, true, delay_ms), Duration::ZERO).unwrap();
            }
            for sender in [1, 2] {
                let refused = waiting.push(start(sender, true, delay_ms), Duration::ZERO);
                assert_eq!(refused, Err(TriggerError::TooMany(max)));
            }
        }
    }

    #[test]
    fn a_stop_cancels_the_starts_of_its_sender() {
        let mut waiting = PendingTriggers::default();
        waiting.push(start(1, true, 10), Duration::ZERO).unwrap();
        waiting.push(start(2, true, 10), Duration::ZERO).unwrap();
        let stop =
            ReceivedTrigger { trigger: Trigger::Stop(Capture::default()), ..start(1, true, 0) };
        assert_eq!(waiting.cancel_starts(stop.from, None), 1);
        assert_eq!(waiting.take_due(Duration::from_secs(1)), Some(start(2, true, 10)));
        assert_eq!(waiting.next_due(), None);
    }
}

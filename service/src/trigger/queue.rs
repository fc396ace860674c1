//! Triggers that were accepted and wait for their time, in a bounded number.
//!
//! A trigger without a delay is due at once, and is carried out as soon as the one before it is. One with a delay is due
//! later: it is a deadline here, and holds up nothing else. [`Waiting`] is sans-io: the time goes in, due triggers come
//! out. [`Queue`] is it in real time, between the thread that hears triggers and the one that carries them out.

use std::{
    net::{IpAddr, SocketAddr},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use crossbeam_channel::{Receiver, Sender, bounded};

use super::{Refusal, Trigger};

/// Triggers without a delay that are not carried out yet. That takes milliseconds, and a laboratory sends one in
/// seconds: when so many wait the service is stuck, and a start that comes out minutes later would start nothing that
/// anybody meant.
pub const DUE_MAX: usize = 16;

/// Of these, those of a sender that is not in `trigger.allow_from`: the end of a take and the start of the next one, and
/// as many again.
pub const DUE_EACH_MAX: usize = 4;

/// Delayed triggers of all senders in `trigger.allow_from`: a start and a stop of eight machines.
pub const DELAYED_MAX: usize = 16;

/// Delayed triggers of all other senders, one of each: eight machines that nobody has named.
pub const DELAYED_OTHERS_MAX: usize = 8;

/// A trigger that was accepted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Received {
    /// Who sent it.
    pub from: SocketAddr,
    /// What it asks for.
    pub trigger: Trigger,
    /// Whether `trigger.allow_from` names the sender.
    pub is_known: bool,
    /// The take that was being recorded when it came.
    pub recording: Option<String>,
}

impl Received {
    /// Its address, by which senders are told apart.
    #[must_use]
    pub fn sender(&self) -> IpAddr {
        self.from.ip().to_canonical()
    }
}

/// Those that wait.
#[derive(Debug, Default)]
pub struct Waiting {
    entries: Vec<Entry>,
    next_number: u64,
}

#[derive(Debug)]
struct Entry {
    due: Duration,
    /// In the order of arrival.
    number: u64,
    is_delayed: bool,
    received: Received,
}

impl Waiting {
    /// Accepts a trigger that came `now`.
    ///
    /// # Errors
    /// Too many wait already.
    pub fn push(&mut self, received: Received, now: Duration) -> Result<(), Refusal> {
        let delay = received.trigger.delay();
        let is_delayed = delay > Duration::ZERO;
        let (sender, is_known) = (received.sender(), received.is_known);
        let alike = || self.entries.iter().filter(|entry| entry.is_delayed == is_delayed);
        let all =
            alike().filter(|entry| !is_delayed || entry.received.is_known == is_known).count();
        let own = alike().filter(|entry| entry.received.sender() == sender).count();
        let (all_max, own_max) = match (is_delayed, is_known) {
            (false, true) => (DUE_MAX, None),
            (false, false) => (DUE_MAX, Some(DUE_EACH_MAX)),
            (true, true) => (DELAYED_MAX, None),
            (true, false) => (DELAYED_OTHERS_MAX, Some(1)),
        };
        if own_max.is_some_and(|max| own >= max) {
            return Err(Refusal::TooManyOfSender { waiting: own, sender });
        }
        if all >= all_max {
            return Err(Refusal::TooMany(all));
        }
        let number = self.next_number;
        self.next_number += 1;
        self.entries.push(Entry { due: now.saturating_add(delay), number, is_delayed, received });
        Ok(())
    }

    /// How many wait.
    #[must_use]
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether none waits.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// When the next one is due.
    #[must_use]
    pub fn next_due(&self) -> Option<Duration> {
        self.entries.iter().map(|entry| entry.due).min()
    }

    /// The next one that is due `now`, in the order of their times.
    pub fn take_due(&mut self, now: Duration) -> Option<Received> {
        let due = |at: &usize| self.entries[*at].due <= now;
        let order = |at: &usize| (self.entries[*at].due, self.entries[*at].number);
        let at = (0..self.entries.len()).filter(due).min_by_key(order)?;
        Some(self.entries.swap_remove(at).received)
    }

    /// Forgets the starts of a sender that wait: of the take of this name, or all where the sender's stop has none.
    /// Returns how many there were.
    pub fn cancel_starts(&mut self, from: SocketAddr, name: Option<&str>) -> usize {
        let before = self.entries.len();
        self.entries.retain(|entry| {
            let Trigger::Start(start) = &entry.received.trigger else { return true };
            let is_meant = match (name, &start.name) {
                (Some(name), Some(start)) => start.text() == name,
                _ => true,
            };
            entry.received.sender() != from.ip().to_canonical() || !is_meant
        });
        before - self.entries.len()
    }
}

/// Those that wait, between two threads.
#[derive(Debug, Clone)]
pub struct TriggerQueue {
    waiting: Arc<Mutex<Waiting>>,
    /// One message at most: that the first deadline may be another one.
    wake: Sender<()>,
    woken: Receiver<()>,
    begin: Instant,
}

impl Default for TriggerQueue {
    fn default() -> Self {
        let (wake, woken) = bounded(1);
        Self { waiting: Arc::default(), wake, woken, begin: Instant::now() }
    }
}

impl TriggerQueue {
    /// The time that deadlines are compared with.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.begin.elapsed()
    }

    /// Accepts one that has just come.
    ///
    /// # Errors
    /// Too many wait already.
    pub fn push(&self, received: Received) -> Result<(), Refusal> {
        self.lock().push(received, self.now())?;
        // A message that is there already wakes as well.
        self.wake.try_send(()).ok();
        Ok(())
    }

    /// The next one that is due now.
    #[must_use]
    pub fn take_due(&self) -> Option<Received> {
        self.lock().take_due(self.now())
    }

    /// How long until the next one that waits is due; `None` when none waits.
    #[must_use]
    pub fn due_in(&self) -> Option<Duration> {
        Some(self.lock().next_due()?.saturating_sub(self.now()))
    }

    /// Something comes when what is due next may be something else.
    #[must_use]
    pub fn woken(&self) -> &Receiver<()> {
        &self.woken
    }

    /// As [`Waiting::cancel_starts`].
    #[must_use]
    pub fn cancel_starts(&self, from: SocketAddr, name: Option<&str>) -> usize {
        self.lock().cancel_starts(from, name)
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::{super::Capture, *};

    fn start(sender: u8, is_known: bool, delay_ms: u64) -> Received {
        let delay = Duration::from_millis(delay_ms);
        Received {
            from: SocketAddr::from(([192, 0, 2, sender], 1)),
            trigger: Trigger::Start(Capture { delay, ..Capture::default() }),
            is_known,
            recording: None,
        }
    }

    #[test]
    fn the_first_that_is_due_comes_first() {
        let mut waiting = Waiting::default();
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
    fn one_delayed_trigger_a_stranger_and_eight_in_all() {
        let mut waiting = Waiting::default();
        let mut push = |received| waiting.push(received, Duration::ZERO);
        for sender in 0..DELAYED_OTHERS_MAX as u8 {
            push(start(sender, false, 1)).unwrap();
            let again = push(start(sender, false, 1));
            assert!(matches!(again, Err(Refusal::TooManyOfSender { waiting: 1, .. })));
        }
        assert_eq!(push(start(99, false, 1)), Err(Refusal::TooMany(DELAYED_OTHERS_MAX)));
        // They take nothing from what is due at once, nor from senders that are known.
        for _ in 0..DUE_EACH_MAX {
            push(start(0, false, 0)).unwrap();
        }
        assert!(push(start(0, false, 0)).is_err());
        push(start(1, false, 0)).unwrap();
        for _ in 0..DELAYED_MAX {
            push(start(100, true, 1)).unwrap();
        }
        assert_eq!(push(start(100, true, 1)), Err(Refusal::TooMany(DELAYED_MAX)));
    }

    #[test]
    fn a_known_sender_has_no_limit_of_its_own() {
        for (delay_ms, max) in [(0, DUE_MAX), (1, DELAYED_MAX)] {
            let mut waiting = Waiting::default();
            for _ in 0..max {
                waiting.push(start(1, true, delay_ms), Duration::ZERO).unwrap();
            }
            for sender in [1, 2] {
                let refused = waiting.push(start(sender, true, delay_ms), Duration::ZERO);
                assert_eq!(refused, Err(Refusal::TooMany(max)));
            }
        }
    }

    #[test]
    fn a_stop_cancels_the_starts_of_its_sender() {
        let mut waiting = Waiting::default();
        waiting.push(start(1, true, 10), Duration::ZERO).unwrap();
        waiting.push(start(2, true, 10), Duration::ZERO).unwrap();
        let stop = Received { trigger: Trigger::Stop(Capture::default()), ..start(1, true, 0) };
        assert_eq!(waiting.cancel_starts(stop.from, None), 1);
        assert_eq!(waiting.take_due(Duration::from_secs(1)), Some(start(2, true, 10)));
        assert_eq!(waiting.next_due(), None);
    }
}

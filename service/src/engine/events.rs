//! Publishes the events of the service to its subscribers.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
};

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use mocapd_acquire::pipeline::lock;
use mocapd_take::escape::visible;

use super::Inner;
use crate::{
    control::EventFeed,
    status::{ServiceEvent, ServiceEventKind, State},
};

/// Maximum number of events waiting for a subscriber; beyond that, the oldest is dropped.
const WAITING_MAX: usize = 256;

/// Maximum number of subscribers. The HTTP server limits its connections to fewer.
const SUBSCRIBERS_MAX: usize = 256;

/// Maximum number of deferred messages: the reader's thread must never wait.
const DEFERRED_MAX: usize = 64;

/// The subscribers, and the messages of threads that must not wait.
#[derive(Debug)]
pub(super) struct EventPublisher {
    subscribers: Mutex<Subscribers>,
    deferred: Sender<String>,
    deferred_out: Receiver<String>,
}

#[derive(Debug, Default)]
struct Subscribers {
    number: u64,
    all: VecDeque<Subscriber>,
}

#[derive(Debug)]
struct Subscriber {
    events: Sender<Arc<ServiceEvent>>,
    /// A receiver of the same channel, to drop the oldest event.
    oldest: Receiver<Arc<ServiceEvent>>,
    missed: Arc<AtomicU64>,
}

impl Default for EventPublisher {
    fn default() -> Self {
        let (deferred, deferred_out) = bounded(DEFERRED_MAX);
        Self { subscribers: Mutex::default(), deferred, deferred_out }
    }
}

impl EventPublisher {
    pub(super) fn subscribe(&self) -> EventFeed {
        let (events, feed) = bounded(WAITING_MAX);
        let missed = Arc::new(AtomicU64::new(0));
        let mut subscribers = lock(&self.subscribers);
        if subscribers.all.len() == SUBSCRIBERS_MAX {
            subscribers.all.pop_front();
        }
        let oldest = feed.clone();
        subscribers.all.push_back(Subscriber { events, oldest, missed: Arc::clone(&missed) });
        EventFeed { events: feed, missed }
    }

    /// Queues a message of a thread that must not wait. It becomes an event soon.
    pub(super) fn defer(&self, message: &str) {
        // If the queue is full, a device's message is still stored among its take's events.
        self.deferred.try_send(message.to_owned()).ok();
    }

    pub(super) fn next_deferred(&self) -> Option<String> {
        self.deferred_out.try_recv().ok()
    }

    fn publish(
        &self,
        kind: ServiceEventKind,
        message: &str,
        state: State,
        (take, notes): (Option<String>, Option<String>),
    ) {
        let mut subscribers = lock(&self.subscribers);
        subscribers.number += 1;
        let event = Arc::new(ServiceEvent {
            number: subscribers.number,
            unix_ms: super::status::unix_ms(),
            kind,
            message: message.to_owned(),
            state,
            take,
            notes,
        });
        subscribers.all.retain(|subscriber| subscriber.send(&event));
    }
}

impl Subscriber {
    /// Sends an event. Returns `false` if the subscriber is gone: its counter has no other owner.
    fn send(&self, event: &Arc<ServiceEvent>) -> bool {
        if Arc::strong_count(&self.missed) == 1 {
            return false;
        }
        if let Err(TrySendError::Full(event)) = self.events.try_send(Arc::clone(event)) {
            self.missed.fetch_add(u64::from(self.oldest.try_recv().is_ok()), Ordering::Relaxed);
            self.events.try_send(event).ok();
        }
        true
    }
}

impl Inner {
    /// Publishes and logs an event. Do not call it from the reader's thread, or with the state locked.
    pub(super) fn publish(&self, kind: ServiceEventKind, message: &str, take: Option<&str>) {
        self.publish_with_notes(kind, message, take, None);
    }

    /// Publishes and logs an event with the notes of a take.
    pub(super) fn publish_with_notes(
        &self,
        kind: ServiceEventKind,
        message: &str,
        take: Option<&str>,
        notes: Option<&str>,
    ) {
        let state = self.core().state();
        let about = (take.map(str::to_owned), notes.map(str::to_owned));
        self.events.publish(kind, message, state, about);
        let device = self.core().device.uri.clone();
        // Subscribers get the exact text in JSON; the log gets it escaped.
        let [take, device, message] = [take.unwrap_or_default(), &device, message].map(visible);
        let (take, device) = (take.as_ref(), device.as_ref());
        match kind {
            ServiceEventKind::Failure => tracing::error!(take, device, "{message}"),
            ServiceEventKind::Warning => tracing::warn!(take, device, "{message}"),
            _ => tracing::info!(take, device, "{message}"),
        }
    }
}

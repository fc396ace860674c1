//! What happens, told to everybody who listens.

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

/// Events that wait for a listener; one that takes none for so many loses the oldest.
const WAITING_MAX: usize = 256;

/// Listeners: connections are bounded by whoever lets them in, and this is beyond that.
const LISTENERS_MAX: usize = 256;

/// Words from the reader's thread that wait to be told: it never waits itself.
const SAID_MAX: usize = 64;

/// The listeners.
#[derive(Debug)]
pub(super) struct Events {
    listeners: Mutex<Listeners>,
    said: Sender<String>,
    said_out: Receiver<String>,
}

#[derive(Debug, Default)]
struct Listeners {
    number: u64,
    all: VecDeque<Listener>,
}

#[derive(Debug)]
struct Listener {
    events: Sender<Arc<ServiceEvent>>,
    /// To drop the oldest by.
    oldest: Receiver<Arc<ServiceEvent>>,
    missed: Arc<AtomicU64>,
}

impl Default for Events {
    fn default() -> Self {
        let (said, said_out) = bounded(SAID_MAX);
        Self { listeners: Mutex::default(), said, said_out }
    }
}

impl Events {
    pub(super) fn subscribe(&self) -> EventFeed {
        let (events, feed) = bounded(WAITING_MAX);
        let missed = Arc::new(AtomicU64::new(0));
        let mut listeners = lock(&self.listeners);
        if listeners.all.len() == LISTENERS_MAX {
            listeners.all.pop_front();
        }
        let oldest = feed.clone();
        listeners.all.push_back(Listener { events, oldest, missed: Arc::clone(&missed) });
        EventFeed { events: feed, missed }
    }

    /// Words from a thread that must not wait. They become events soon.
    pub(super) fn say(&self, words: &str) {
        // Of a device that chatters, what does not fit is in its take's events all the same.
        self.said.try_send(words.to_owned()).ok();
    }

    pub(super) fn said(&self) -> Option<String> {
        self.said_out.try_recv().ok()
    }

    fn tell(
        &self,
        kind: ServiceEventKind,
        message: &str,
        state: State,
        (take, notes): (Option<String>, Option<String>),
    ) {
        let mut listeners = lock(&self.listeners);
        listeners.number += 1;
        let event = Arc::new(ServiceEvent {
            number: listeners.number,
            unix_ms: super::status::unix_ms(),
            kind,
            message: message.to_owned(),
            state,
            take,
            notes,
        });
        listeners.all.retain(|listener| listener.tell(&event));
    }
}

impl Listener {
    /// `false` when it is gone: nobody but this holds the other end.
    fn tell(&self, event: &Arc<ServiceEvent>) -> bool {
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
    /// Tells an event, and logs it. Not from the reader's thread, and not with the state locked.
    pub(super) fn say_event(&self, kind: ServiceEventKind, message: &str, take: Option<&str>) {
        self.say_noted(kind, message, take, None);
    }

    /// The same, with the notes of a take.
    pub(super) fn say_noted(
        &self,
        kind: ServiceEventKind,
        message: &str,
        take: Option<&str>,
        notes: Option<&str>,
    ) {
        let state = self.core().state();
        let about = (take.map(str::to_owned), notes.map(str::to_owned));
        self.events.tell(kind, message, state, about);
        let device = self.core().device.uri.clone();
        // Listeners get the text exactly, in JSON; the log shows it.
        let [take, device, message] = [take.unwrap_or_default(), &device, message].map(visible);
        let (take, device) = (take.as_ref(), device.as_ref());
        match kind {
            ServiceEventKind::Failure => tracing::error!(take, device, "{message}"),
            ServiceEventKind::Warning => tracing::warn!(take, device, "{message}"),
            _ => tracing::info!(take, device, "{message}"),
        }
    }
}

//! The watcher's thread: ends takes that are over, measures rates, and publishes messages of other threads; and the events of
//! the service, with their subscribers.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use crossbeam_channel::{Receiver, Sender, TryRecvError, TrySendError, bounded};
use mocapd_acquire::{
    files::FileState,
    pipeline::lock,
    threads::{HeartbeatHandle, ThreadRole},
};
use mocapd_take::{escape::visible, record::EndingKind};

use super::{
    Inner,
    session::{Core, free_bytes},
};
use crate::{
    control::EventFeed,
    process,
    status::{ServiceEvent, ServiceEventKind, State},
};

/// Time between polls.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Time between measurements of a rate.
const RATES_INTERVAL: Duration = Duration::from_secs(1);

/// How late the last frames of a take of a requested length may arrive, as for `record --seconds`.
const FRAMES_LATE_MAX: Duration = Duration::from_secs(1);

/// Runs until the service ends.
pub(super) fn run(inner: &Arc<Inner>) {
    // With sixty other threads registered, a heartbeat may be refused. Then the watchdog does not watch this thread.
    let beat = inner.heartbeat.register(ThreadRole::Supervisor).ok();
    let mut rates = RateMeter::default();
    while !inner.is_stopping() {
        if let Some(beat) = &beat {
            beat.beat();
        }
        inner.publish_deferred();
        // Waits for the end of a take, during which the disk may stall.
        if let Some(beat) = &beat {
            beat.at_disk();
        }
        inner.end_finished_takes();
        rates.update(inner, beat.as_ref());
        // Without a session only the free disk space changes.
        if inner.core().session.is_none() {
            inner.wait_while(RATES_INTERVAL, |core| core.session.is_none());
        } else {
            inner.wait_while(POLL_INTERVAL, |_| true);
        }
    }
    inner.publish_deferred();
}

impl Inner {
    fn publish_deferred(&self) {
        while let Some(message) = self.events.next_deferred() {
            let take = self.core().take.as_ref().map(|take| take.named.name.clone());
            self.publish(ServiceEventKind::Device, &message, take.as_deref());
        }
    }

    /// Ends takes at their maximum length, or whose disk, device or writer has failed. Not while a command is executed,
    /// which reports the end itself.
    fn end_finished_takes(&self) {
        let Ok(command) = self.command.try_lock() else { return };
        self.report_file_changes();
        let core = self.core();
        let why = core.due_ending();
        let ended = core.take.as_ref().map(|take| take.ended.try_recv());
        let exhausted = core.is_exhausted();
        drop(core);
        // The events have the details.
        match (ended, why) {
            (Some(Ok(end)), _) => drop(self.finish_take(end)),
            (Some(Err(TryRecvError::Disconnected)), _) => drop(self.finish_unanswered()),
            (_, Some(why)) => drop(self.stop_take(&command, why)),
            _ => {}
        }
        if exhausted {
            let message = "new markers have used all reserve channels: restarting the pre-roll";
            self.publish(ServiceEventKind::Warning, message, None);
            if let Some(session) = &self.core().session {
                session.stop.store(true, Ordering::Relaxed);
            }
        }
    }

    /// Reports changes to the take's file once; a change that ends the take is reported with its end.
    fn report_file_changes(&self) {
        let mut core = self.core();
        let Some(session) = &core.session else { return };
        let progress = Arc::clone(&session.progress);
        let Some(take) = &mut core.take else { return };
        let changes = progress.file_changes();
        let is_new = std::mem::replace(&mut take.changes_reported, changes) != changes;
        let name = take.named.name.clone();
        drop(core);
        if is_new
            && !progress.file_state().ends_take()
            && let Some(displaced) = progress.displaced()
        {
            self.publish(ServiceEventKind::Warning, &displaced.message(), Some(&name));
        }
    }
}

impl Core {
    fn due_ending(&self) -> Option<EndingKind> {
        let take = self.take.as_ref()?;
        // One that ends by itself earlier is left to the reader, to the frame.
        let max_length = self.options.take.max_length;
        let max_length = max_length.filter(|max| take.length.is_none_or(|length| length > *max));
        if max_length.is_some_and(|max| take.begun.elapsed() >= max) {
            return Some(EndingKind::Length);
        }
        let session = self.session.as_ref()?;
        // While frames arrive, the reader ends it at its last frame.
        if take.length.is_some_and(|length| take.begun.elapsed() >= length + FRAMES_LATE_MAX)
            && session.is_without_frames(FRAMES_LATE_MAX)
        {
            return Some(EndingKind::Length);
        }
        match session.progress.file_state() {
            FileState::Truncated => return Some(EndingKind::Truncated),
            FileState::Unmounted => return Some(EndingKind::Unmounted),
            _ => {}
        }
        session.progress.disk_full.load(Ordering::Relaxed).then_some(EndingKind::DiskFull)
    }

    /// Markers that appeared and vanished have used up the channels: without a take, they can be forgotten.
    fn is_exhausted(&self) -> bool {
        let (None, Some(session)) = (&self.take, &self.session) else { return false };
        !session.stop.load(Ordering::Relaxed)
            && lock(&session.progress.channels).len() >= session.slots
    }
}

/// Measures rates between two updates.
#[derive(Debug, Default)]
struct RateMeter {
    last: Option<(Instant, u64, u64, f64)>,
}

impl RateMeter {
    fn update(&mut self, inner: &Inner, beat: Option<&HeartbeatHandle>) {
        if self.last.is_some_and(|(at, ..)| at.elapsed() < RATES_INTERVAL) {
            return;
        }
        let now = Instant::now();
        let core = inner.core();
        let session = core.session.as_ref();
        let number = session.map_or(0, |session| session.number);
        let frames = session.map_or(0, |s| s.progress.frames.load(Ordering::Relaxed));
        let directory = core.options.take.directory.clone();
        drop(core);
        if let Some(beat) = beat {
            beat.at_disk();
        }
        let free_bytes = free_bytes(&directory).map_or(0, |bytes| bytes.saturating_add(1));
        inner.rates.free_bytes.store(free_bytes, Ordering::Relaxed);
        let cpu_s = process::usage(None).map_or(0.0, |usage| usage.cpu_s);
        if let Some((at, session, before, cpu_before_s)) = self.last {
            let passed_s = now.duration_since(at).as_secs_f64();
            let is_same = session == number;
            let came = if is_same { frames.saturating_sub(before) } else { frames };
            inner.rates.session.store(if is_same { number } else { 0 }, Ordering::Relaxed);
            let frames_hz = came as f64 / passed_s;
            inner.rates.frames_hz.store(frames_hz.to_bits(), Ordering::Relaxed);
            let cpu_cores = (cpu_s - cpu_before_s).max(0.0) / passed_s;
            inner.rates.cpu_cores.store(cpu_cores.to_bits(), Ordering::Relaxed);
        }
        self.last = Some((now, number, frames, cpu_s));
    }
}

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

    fn next_deferred(&self) -> Option<String> {
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
            unix_ms: super::session::unix_ms(),
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

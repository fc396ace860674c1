//! What the service sends to everybody who listens, each from one feed of it: events, with those of lately, and frames,
//! coded once, the newest few for whoever is slow.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use axum::body::Bytes;
use crossbeam_channel::{Receiver, Sender, bounded, select};
use mocapd_acquire::threads::Stopped;
use tokio::sync::broadcast;

use super::Counts;
use crate::{
    control::{Control, EventFeed},
    live::{LiveFeed, LiveMessage},
    status::ServiceEvent,
};

/// Events that are kept for those who come back: an hour of a busy session, some hundred kilobytes.
const KEPT_MAX: usize = 512;

/// Events that a listener may be behind before it loses the oldest.
const EVENTS_BEHIND_MAX: usize = 128;

/// The hub of events. They are told apart by their numbers: a gap in them is what somebody missed, wherever it was lost.
#[derive(Debug)]
pub(super) struct EventBroadcast {
    /// Which run of the service it is: numbers begin again with each.
    pub(super) run: String,
    kept: Mutex<VecDeque<Arc<ServiceEvent>>>,
    sender: broadcast::Sender<Arc<ServiceEvent>>,
    counts: Arc<Counts>,
}

impl EventBroadcast {
    pub(super) fn new(run: String, counts: Arc<Counts>) -> Self {
        let kept = Mutex::new(VecDeque::with_capacity(KEPT_MAX));
        Self { run, kept, sender: broadcast::Sender::new(EVENTS_BEHIND_MAX), counts }
    }

    /// Listens until it is stopped, or the feed ends: the work of a thread of its own. The feed was opened before, so that
    /// nothing is missed.
    pub(super) fn forward(&self, feed: &EventFeed, stopped: &Stopped) {
        loop {
            select! {
                recv(feed.events) -> event => match event {
                    Ok(event) => self.publish(event),
                    Err(_) => return,
                },
                recv(stopped.channel()) -> _ => return,
            }
            Counts::add(&self.counts.events_missed, feed.missed());
        }
    }

    fn publish(&self, event: Arc<ServiceEvent>) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() == KEPT_MAX {
            kept.pop_front();
        }
        kept.push_back(Arc::clone(&event));
        // Under the lock, so that `follow` gets each event once. Nobody may listen.
        self.sender.send(event).ok();
    }

    /// What was kept since event `after`, and what comes from now on. Without a number only the latter.
    pub(super) fn follow(&self, after: Option<u64>) -> EventSubscription {
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let last = kept.back().map_or(0, |event| event.number);
        let since = after.unwrap_or(last);
        let backlog = kept.iter().filter(|event| event.number > since).cloned().collect();
        EventSubscription { backlog, coming: self.sender.subscribe(), last_number: since }
    }
}

/// One listener.
#[derive(Debug)]
pub(super) struct EventSubscription {
    backlog: VecDeque<Arc<ServiceEvent>>,
    coming: broadcast::Receiver<Arc<ServiceEvent>>,
    last_number: u64,
}

/// An event, and how many before it are gone.
#[derive(Debug)]
pub(super) struct Delivery {
    pub(super) event: Arc<ServiceEvent>,
    pub(super) missed: u64,
}

impl EventSubscription {
    /// The next event. `None`: there will be none.
    pub(super) async fn next(&mut self) -> Option<Delivery> {
        let event = match self.backlog.pop_front() {
            Some(event) => event,
            None => loop {
                match self.coming.recv().await {
                    Ok(event) => break event,
                    // The numbers tell how many.
                    Err(broadcast::error::RecvError::Lagged(_)) => {}
                    Err(broadcast::error::RecvError::Closed) => return None,
                }
            },
        };
        let missed = event.number.saturating_sub(self.last_number + 1);
        self.last_number = event.number;
        Some(Delivery { event, missed })
    }
}

/// Messages that a viewer may be behind: a quarter of a second. A frame of 200 markers has 2.4 KB, and is held once
/// for all viewers.
const FRAMES_BEHIND_MAX: usize = 8;

/// Between looks whether there still are viewers, and whether the server ends, where no frame comes.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Markers, as they go to a viewer.
#[derive(Debug)]
pub(super) struct EncodedTable {
    number: u64,
    bytes: Bytes,
}

/// What viewers are sent.
#[derive(Debug, Clone)]
pub(super) enum LiveUpdate {
    Table(Arc<EncodedTable>),
    /// A frame, and the markers that it has: a viewer that missed the table gets it with the frame.
    Frame(Option<Arc<EncodedTable>>, Bytes),
    Over,
}

/// The hub of frames.
#[derive(Debug)]
pub(super) struct LiveBroadcast {
    sender: broadcast::Sender<LiveUpdate>,
    table: Mutex<Option<Arc<EncodedTable>>>,
    is_over: AtomicBool,
    wake: Sender<()>,
    woken: Receiver<()>,
    counts: Arc<Counts>,
}

impl LiveBroadcast {
    pub(super) fn new(counts: Arc<Counts>) -> Self {
        let (wake, woken) = bounded(1);
        let (table, is_over) = (Mutex::new(None), AtomicBool::new(false));
        Self {
            sender: broadcast::Sender::new(FRAMES_BEHIND_MAX),
            table,
            is_over,
            wake,
            woken,
            counts,
        }
    }

    /// Looks while anybody does, until it is stopped: the work of a thread of its own.
    pub(super) fn run(&self, control: &dyn Control, stopped: &Stopped) {
        while !stopped.is_stopped() && !self.is_over() {
            if self.sender.receiver_count() == 0 {
                select! {
                    recv(self.woken) -> _ => {}
                    recv(stopped.channel()) -> _ => return,
                }
                continue;
            }
            self.forward(&control.live(), stopped);
        }
    }

    fn forward(&self, feed: &LiveFeed, stopped: &Stopped) {
        while self.sender.receiver_count() > 0 && !stopped.is_stopped() {
            let asked = Instant::now();
            match feed.next(POLL_INTERVAL) {
                Some(message) => self.put(&message),
                None if feed.is_over() => {
                    self.is_over.store(true, Ordering::Relaxed);
                    self.send(LiveUpdate::Over);
                    return;
                }
                // A feed that lost its other end answers at once: it is opened again, and not all the time.
                None if asked.elapsed() < POLL_INTERVAL / 2 => {
                    std::thread::sleep(POLL_INTERVAL);
                    return;
                }
                None => {}
            }
        }
    }

    fn put(&self, message: &LiveMessage) {
        let mut bytes = Vec::new();
        message.put(&mut bytes);
        let bytes = Bytes::from(bytes);
        let mut table = self.table.lock().unwrap_or_else(PoisonError::into_inner);
        let shown = match message {
            LiveMessage::Table(_) => {
                let number = table.as_ref().map_or(1, |table| table.number + 1);
                let new = Arc::new(EncodedTable { number, bytes });
                *table = Some(Arc::clone(&new));
                LiveUpdate::Table(new)
            }
            LiveMessage::Frame(_) => LiveUpdate::Frame(table.clone(), bytes),
        };
        self.send(shown);
    }

    fn send(&self, shown: LiveUpdate) {
        // The last viewer may have left by now.
        self.sender.send(shown).ok();
    }

    /// Whether no more frames will come.
    pub(super) fn is_over(&self) -> bool {
        self.is_over.load(Ordering::Relaxed)
    }

    pub(super) fn view(&self) -> LiveSubscription {
        let table = self.table.lock().unwrap_or_else(PoisonError::into_inner);
        let coming = self.sender.subscribe();
        let first = table.as_ref().map(|table| LiveUpdate::Table(Arc::clone(table)));
        drop(table);
        // Full: it was woken already.
        self.wake.try_send(()).ok();
        LiveSubscription { first, coming, table_seen: 0, counts: Arc::clone(&self.counts) }
    }
}

/// One viewer.
#[derive(Debug)]
pub(super) struct LiveSubscription {
    first: Option<LiveUpdate>,
    coming: broadcast::Receiver<LiveUpdate>,
    table_seen: u64,
    counts: Arc<Counts>,
}

impl LiveSubscription {
    /// The bytes to send next. `None`: there will be none.
    pub(super) async fn next(&mut self) -> Option<Bytes> {
        loop {
            let shown = match self.first.take() {
                Some(shown) => shown,
                None => match self.coming.recv().await {
                    Ok(shown) => shown,
                    Err(broadcast::error::RecvError::Lagged(skipped)) => {
                        Counts::add(&self.counts.live_frames_skipped, skipped);
                        continue;
                    }
                    Err(broadcast::error::RecvError::Closed) => return None,
                },
            };
            match shown {
                LiveUpdate::Over => return None,
                LiveUpdate::Table(table) if table.number == self.table_seen => {}
                LiveUpdate::Table(table) => {
                    self.table_seen = table.number;
                    return Some(table.bytes.clone());
                }
                LiveUpdate::Frame(Some(table), frame) if table.number != self.table_seen => {
                    self.first = Some(LiveUpdate::Frame(Some(Arc::clone(&table)), frame));
                    self.table_seen = table.number;
                    return Some(table.bytes.clone());
                }
                LiveUpdate::Frame(_, frame) => return Some(frame),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::status::State;

    fn event(number: u64) -> Arc<ServiceEvent> {
        Arc::new(ServiceEvent {
            number,
            unix_ms: 0,
            kind: crate::status::ServiceEventKind::Mark,
            message: String::new(),
            state: State::Idle,
            take: None,
            notes: None,
        })
    }

    fn next(subscription: &mut EventSubscription) -> (u64, u64) {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let delivery = runtime.block_on(subscription.next()).unwrap();
        (delivery.event.number, delivery.missed)
    }

    #[test]
    fn history_is_bounded_and_gaps_are_told() {
        let hub = EventBroadcast::new("r".to_owned(), Arc::default());
        let total = KEPT_MAX as u64 + 10;
        (1..=total).for_each(|number| hub.publish(event(number)));
        let mut resumed = hub.follow(Some(3));
        assert_eq!(next(&mut resumed), (11, 7), "4 to 10 are gone");
        assert_eq!(next(&mut resumed), (12, 0));
        let mut new = hub.follow(None);
        // Lost before it came here, by a feed that was not read.
        hub.publish(event(total + 3));
        assert_eq!(next(&mut new), (total + 3, 2));
        // Behind by more than is held for one: the oldest are gone.
        (total + 4..total + 4 + 2 * EVENTS_BEHIND_MAX as u64)
            .for_each(|number| hub.publish(event(number)));
        let (number, missed) = next(&mut new);
        assert_eq!(
            (number, missed),
            (total + 4 + EVENTS_BEHIND_MAX as u64, EVENTS_BEHIND_MAX as u64)
        );
        assert_eq!(next(&mut hub.follow(Some(total))).0, total + 3);
    }
}

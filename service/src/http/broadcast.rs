//! Distributes events and live frames to all HTTP clients, each from one feed of the service. Recent events are kept
//! for clients that reconnect; frames are encoded once, and slow viewers get the newest frames.

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
use mocapd_acquire::threads::StopReceiver;
use tokio::sync::broadcast;

use super::Counts;
use crate::{
    control::{Control, EventFeed},
    live::{LiveFeed, LiveMessage},
    status::ServiceEvent,
};

/// Events kept for clients that reconnect: an hour of a busy session, some hundred kilobytes.
const HISTORY_MAX: usize = 512;

/// Maximum number of events that a subscriber may lag behind before it loses the oldest.
const EVENTS_BEHIND_MAX: usize = 128;

/// Distributes events. Their numbers are consecutive, so a gap shows what a subscriber missed, wherever it was lost.
#[derive(Debug)]
pub(super) struct EventBroadcast {
    /// Identifies this run of the service: numbers start again with each.
    pub(super) run: String,
    history: Mutex<VecDeque<Arc<ServiceEvent>>>,
    sender: broadcast::Sender<Arc<ServiceEvent>>,
    counts: Arc<Counts>,
}

impl EventBroadcast {
    pub(super) fn new(run: String, counts: Arc<Counts>) -> Self {
        let history = Mutex::new(VecDeque::with_capacity(HISTORY_MAX));
        Self { run, history, sender: broadcast::Sender::new(EVENTS_BEHIND_MAX), counts }
    }

    /// Forwards events until it is stopped or the feed ends, on its own thread. The feed was opened earlier, so that
    /// nothing is missed.
    pub(super) fn forward(&self, feed: &EventFeed, stopped: &StopReceiver) {
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
        let mut history = self.history.lock().unwrap_or_else(PoisonError::into_inner);
        if history.len() == HISTORY_MAX {
            history.pop_front();
        }
        history.push_back(Arc::clone(&event));
        // Sent under the lock, so that `follow` gets each event once. There may be no receivers.
        self.sender.send(event).ok();
    }

    /// Subscribes to the kept events after number `after` and to all future ones; without a number, only to future
    /// ones.
    pub(super) fn follow(&self, after: Option<u64>) -> EventSubscription {
        let history = self.history.lock().unwrap_or_else(PoisonError::into_inner);
        let last = history.back().map_or(0, |event| event.number);
        let since = after.unwrap_or(last);
        let backlog = history.iter().filter(|event| event.number > since).cloned().collect();
        EventSubscription { backlog, coming: self.sender.subscribe(), last_number: since }
    }
}

/// The subscription of one client.
#[derive(Debug)]
pub(super) struct EventSubscription {
    backlog: VecDeque<Arc<ServiceEvent>>,
    coming: broadcast::Receiver<Arc<ServiceEvent>>,
    last_number: u64,
}

/// An event, and the number of events lost before it.
#[derive(Debug)]
pub(super) struct Delivery {
    pub(super) event: Arc<ServiceEvent>,
    pub(super) missed: u64,
}

impl EventSubscription {
    /// Waits for the next event; `None` if there will be no more.
    pub(super) async fn next(&mut self) -> Option<Delivery> {
        let event = match self.backlog.pop_front() {
            Some(event) => event,
            None => loop {
                match self.coming.recv().await {
                    Ok(event) => break event,
                    // The numbers show how many are lost.
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

/// Maximum number of messages that a viewer may lag behind: a quarter of a second. A frame of 200 markers has 2.4 KB
/// and is shared by all viewers.
const FRAMES_BEHIND_MAX: usize = 8;

/// Time between checks for viewers and for the end of the server while no frames arrive.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// The marker table as it is sent.
#[derive(Debug)]
pub(super) struct EncodedTable {
    number: u64,
    bytes: Bytes,
}

/// A message for viewers.
#[derive(Debug, Clone)]
pub(super) enum LiveUpdate {
    Table(Arc<EncodedTable>),
    /// A frame with its table: a viewer that missed the table gets it before the frame.
    Frame(Option<Arc<EncodedTable>>, Bytes),
    Over,
}

/// Distributes live frames.
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

    /// Forwards frames while there are viewers, until it is stopped, on its own thread.
    pub(super) fn run(&self, control: &dyn Control, stopped: &StopReceiver) {
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

    fn forward(&self, feed: &LiveFeed, stopped: &StopReceiver) {
        while self.sender.receiver_count() > 0 && !stopped.is_stopped() {
            let start = Instant::now();
            match feed.next(POLL_INTERVAL) {
                Some(message) => self.put(&message),
                None if feed.is_over() => {
                    self.is_over.store(true, Ordering::Relaxed);
                    self.send(LiveUpdate::Over);
                    return;
                }
                // A feed whose sender is gone returns immediately: it is opened again after a pause.
                None if start.elapsed() < POLL_INTERVAL / 2 => {
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
        // The last viewer may have left.
        self.sender.send(shown).ok();
    }

    /// Whether there will be no more frames.
    pub(super) fn is_over(&self) -> bool {
        self.is_over.load(Ordering::Relaxed)
    }

    pub(super) fn view(&self) -> LiveSubscription {
        let table = self.table.lock().unwrap_or_else(PoisonError::into_inner);
        let coming = self.sender.subscribe();
        let first = table.as_ref().map(|table| LiveUpdate::Table(Arc::clone(table)));
        drop(table);
        // If the channel is full, the thread has been woken already.
        self.wake.try_send(()).ok();
        LiveSubscription { first, coming, table_sent: 0, counts: Arc::clone(&self.counts) }
    }
}

/// The subscription of one viewer.
#[derive(Debug)]
pub(super) struct LiveSubscription {
    first: Option<LiveUpdate>,
    coming: broadcast::Receiver<LiveUpdate>,
    table_sent: u64,
    counts: Arc<Counts>,
}

impl LiveSubscription {
    /// Waits for the bytes to send next; `None` if there will be no more.
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
                LiveUpdate::Table(table) if table.number == self.table_sent => {}
                LiveUpdate::Table(table) => {
                    self.table_sent = table.number;
                    return Some(table.bytes.clone());
                }
                LiveUpdate::Frame(Some(table), frame) if table.number != self.table_sent => {
                    self.first = Some(LiveUpdate::Frame(Some(Arc::clone(&table)), frame));
                    self.table_sent = table.number;
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
    fn history_is_bounded_and_gaps_are_reported() {
        let hub = EventBroadcast::new("r".to_owned(), Arc::default());
        let total = HISTORY_MAX as u64 + 10;
        (1..=total).for_each(|number| hub.publish(event(number)));
        let mut resumed = hub.follow(Some(3));
        assert_eq!(next(&mut resumed), (11, 7), "4 to 10 are gone");
        assert_eq!(next(&mut resumed), (12, 0));
        let mut new = hub.follow(None);
        // Lost earlier, by a feed that was not read.
        hub.publish(event(total + 3));
        assert_eq!(next(&mut new), (total + 3, 2));
        // Lagging by more events than are kept for a subscriber: the oldest are lost.
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

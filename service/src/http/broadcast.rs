//! Distributes events and live frames to all HTTP clients, each from one feed of the service, in replies that continue until
//! the client closes. Recent events are kept for clients that reconnect; frames are encoded once, and slow viewers get the
//! newest frames.

use std::{
    collections::VecDeque,
    convert::Infallible,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use axum::{
    body::{Body, Bytes},
    extract::{Query, State, rejection::QueryRejection},
    http::{HeaderMap, HeaderName, header},
    response::{
        IntoResponse, Response,
        sse::{Event, KeepAlive, Sse},
    },
};
use crossbeam_channel::{Receiver, Sender, bounded, select};
use futures_util::stream::{self, Stream};
use mocapd_acquire::threads::StopReceiver;
use serde::{Deserialize, Serialize};
use tokio::sync::broadcast;
use utoipa::ToSchema;

use super::{Counts, Shared, StreamPermit, body::Problem, until};
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
struct EncodedTable {
    number: u64,
    bytes: Bytes,
}

/// A message for viewers.
#[derive(Debug, Clone)]
enum LiveUpdate {
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

const LAST_EVENT_ID: HeaderName = HeaderName::from_static("last-event-id");

#[derive(Debug, Deserialize)]
pub(super) struct After {
    after: Option<u64>,
}

/// Reports lost events: the client was too slow, or was away for too long.
#[derive(Debug, Serialize, ToSchema)]
struct Missed {
    /// Number of lost events; null if it is unknown because the service was restarted.
    missed: Option<u64>,
}

/// Events as they happen
///
/// Server-sent events: `event` is the kind, `data` the event in JSON, and `id` its number in this run of the service.
/// With `Last-Event-ID` the stream continues after that event, as far back as events are kept. An event `missed`
/// reports lost events.
#[utoipa::path(get, path = "/v1/events", tag = "streams",
    params(("after" = Option<u64>, Query, description =
            "Start after the event with this number, as far back as events are kept; 0 for all of them"),
        ("Last-Event-ID" = Option<String>, Header, description = "Id of the last event received")),
    responses((status = 200, description = "Events, until the client closes", body = ServiceEvent,
        content_type = "text/event-stream")))]
pub(super) async fn events(
    State(app): State<Shared>,
    after: Result<Query<After>, QueryRejection>,
    headers: HeaderMap,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Problem> {
    let Query(After { after }) =
        after.map_err(|_| Problem::invalid("`after` must be the number of an event"))?;
    let resumed =
        headers.get(LAST_EVENT_ID).and_then(|id| resume(id.to_str().ok()?, &app.events.run));
    let (after, is_other_run) = match resumed {
        Some(Resumed::At(number)) => (Some(number), false),
        Some(Resumed::OtherRun) => (Some(0), true),
        None => (after, false),
    };
    let subscription = app.events.follow(after);
    let _permit = app.stream_permit()?;
    let keep_alive = KeepAlive::new().interval(app.limits.keep_alive);
    let events = EventStream { app, subscription, pending: None, is_other_run, _permit };
    Ok(Sse::new(stream::unfold(events, EventStream::next)).keep_alive(keep_alive))
}

#[derive(Debug, PartialEq, Eq)]
enum Resumed {
    /// After this event of the current run.
    At(u64),
    /// After an event of another run, or an unknown one.
    OtherRun,
}

/// Parses an id `RUN-NUMBER`; a bare number refers to the current run.
fn resume(id: &str, run: &str) -> Option<Resumed> {
    let id = id.trim();
    if id.is_empty() {
        return None;
    }
    let (of, number) = id.rsplit_once('-').unwrap_or((run, id));
    Some(match number.parse() {
        Ok(number) if of == run => Resumed::At(number),
        _ => Resumed::OtherRun,
    })
}

struct EventStream {
    app: Shared,
    subscription: EventSubscription,
    pending: Option<Delivery>,
    /// Whether the client must first be informed that this is another run.
    is_other_run: bool,
    _permit: StreamPermit,
}

impl EventStream {
    async fn next(mut self) -> Option<(Result<Event, Infallible>, Self)> {
        if std::mem::take(&mut self.is_other_run) {
            return Some((Ok(missed(None)), self));
        }
        let delivery = match self.pending.take() {
            Some(delivery) => delivery,
            None => {
                let mut stopping = self.app.stopping.clone();
                until(&mut stopping, self.subscription.next()).await??
            }
        };
        if delivery.missed > 0 {
            let event = missed(Some(delivery.missed));
            self.pending = Some(Delivery { missed: 0, ..delivery });
            return Some((Ok(event), self));
        }
        let id = format!("{}-{}", self.app.events.run, delivery.event.number);
        // Strings and numbers can always be written as JSON, on one line.
        let data = serde_json::to_string(delivery.event.as_ref()).unwrap_or_default();
        let kind = delivery.event.kind.to_string();
        Some((Ok(Event::default().id(id).event(kind).data(data)), self))
    }
}

fn missed(missed: Option<u64>) -> Event {
    let data = serde_json::to_string(&Missed { missed }).unwrap_or_default();
    Event::default().event("missed").data(data)
}

/// The newest live frames, some thirty a second
///
/// A stream of messages, little endian: u32 length of what follows, u8 kind. Kind 1 is the table of markers in JSON,
/// sent before the first frame and whenever the markers change. Kind 2 is a frame: three zero bytes, u64 row, u64
/// device ticks, u64 arrival in microseconds since 1970, then three f32 per marker in millimetres, NaN if it is not
/// seen. Kind 3 follows the frame that it belongs to if the subject's face is seen: three zero bytes, then for each
/// axis three f32 factors of a vertex of the face, and one f32 offset. Kind 4 follows the next frame, a column of a strip
/// chart of a group of sampled channels: u8 index of the group in the table, two zero bytes, u64 number of its first sample,
/// u32 number of samples, then for each channel its least and its largest value as f32. A slow viewer misses frames, but
/// never the table.
#[utoipa::path(get, path = "/v1/live", tag = "streams",
    responses((status = 200, description = "Messages, until the client closes", body = Vec<u8>,
        content_type = "application/octet-stream")))]
pub(super) async fn live(State(app): State<Shared>) -> Result<Response, Problem> {
    let permit = app.stream_permit()?;
    if app.live.is_over() {
        return Err(Problem::unavailable("the service is stopping: there are no more live frames"));
    }
    let subscription = app.live.view();
    let state = (app.stopping.clone(), subscription, permit);
    let messages = stream::unfold(state, |(mut stopping, mut subscription, permit)| async move {
        let bytes = until(&mut stopping, subscription.next()).await??;
        Some((Ok::<_, Infallible>(bytes), (stopping, subscription, permit)))
    });
    let content_type = [(header::CONTENT_TYPE, "application/octet-stream")];
    Ok((content_type, Body::from_stream(messages)).into_response())
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

    #[test]
    fn ids_of_this_run_and_of_others() {
        assert_eq!(resume("18f-7", "18f"), Some(Resumed::At(7)));
        assert_eq!(resume(" 7 ", "18f"), Some(Resumed::At(7)));
        assert_eq!(resume("", "18f"), None);
        for id in ["17a-7", "18f-", "18f-x", "x", "18f--1"] {
            assert_eq!(resume(id, "18f"), Some(Resumed::OtherRun), "{id}");
        }
    }
}

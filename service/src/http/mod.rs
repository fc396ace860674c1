//! The HTTP server: the API, event and live streams, and the dashboard.
//!
//! ```text
//! Unix socket ─┐                                                   ┌─► Control::status: at once
//!              ├─► connection: limits, ─► guard: Host, ─► route ───┼─► queue ─► Control::start …: a thread that may wait
//! TCP ─────────┘   time-outs              Origin, token            └─► hub ◄── Control::events, live: a thread each
//! ```
//!
//! Each listener has its own thread, `mocapd-socket` and `mocapd-tcp`, and a limited number of threads for blocking
//! work, so that clients of one never wait for those of the other. The data plane does not depend on it.
//! docs/api.md describes the routes and their guarantees.

mod auth;
mod body;
mod broadcast;
mod commands;
mod connection;
mod download;
mod guard;
mod metrics;
mod options;
mod playback;
mod routes;
mod server;
mod slots;
mod takes;
mod work_queues;

use std::{
    net::SocketAddr,
    pin::pin,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use axum::body::Bytes;
use futures_util::future::{Either, select};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

pub(crate) use self::auth::new_secret;
use self::{
    auth::Auth,
    broadcast::{EventBroadcast, LiveBroadcast},
    playback::KnownMaps,
    work_queues::WorkQueues,
};
pub use self::{
    auth::{Token, TokenError},
    body::{Problem, ProblemKind},
    options::{CONNECTIONS_MAX, HttpOptions, TimeLimits},
    routes::openapi,
    server::HttpServer,
    takes::TakeCheck,
};
use crate::control::Control;

/// The state shared by the requests of one listener. Limited resources belong to each listener, so that clients of one
/// never wait for those of the other.
#[derive(Debug)]
struct App {
    control: Arc<dyn Control>,
    queues: WorkQueues,
    maps: Arc<KnownMaps>,
    auth: Arc<Auth>,
    counts: Arc<Counts>,
    limits: TimeLimits,
    /// Whether only the player is served, whose files need no token.
    is_viewer: bool,
    allowed_hosts: watch::Receiver<Vec<String>>,
    events: Arc<EventBroadcast>,
    live: Arc<LiveBroadcast>,
    /// The OpenAPI description.
    document: Bytes,
    /// Limits replies of unlimited duration to half of the listener's connections, so that requests get through.
    streams: Arc<Semaphore>,
    /// Becomes true when the server stops.
    stopping: watch::Receiver<bool>,
}

/// The state passed to handlers.
type Shared = Arc<App>;

/// Held by a reply of unlimited duration.
type StreamPermit = OwnedSemaphorePermit;

impl App {
    /// A permit for a reply of unlimited duration.
    ///
    /// # Errors
    /// 503 if there are too many.
    fn stream_permit(&self) -> Result<StreamPermit, Problem> {
        let message = "too many streams and downloads: close one, or try again in a second";
        Arc::clone(&self.streams).try_acquire_owned().map_err(|_| Problem::unavailable(message))
    }
}

/// How a request reached the server.
#[derive(Debug, Clone, Copy)]
enum Via {
    /// Over the Unix socket, whose mode decides who may connect.
    Unix,
    /// TCP, to this address.
    Tcp(SocketAddr),
}

/// Counters of the server since its start, for /metrics.
#[derive(Debug, Default)]
struct Counts {
    /// Open connections.
    connections: AtomicU64,
    /// Connections rejected because there were too many.
    connections_refused: AtomicU64,
    /// Connections evicted in favour of new ones.
    connections_evicted: AtomicU64,
    /// Requests, including those for unknown routes.
    requests: AtomicU64,
    /// Requests that got a status of 400 or above.
    requests_refused: AtomicU64,
    /// Live messages that slow viewers skipped.
    live_frames_skipped: AtomicU64,
    /// Events that subscribers missed.
    events_missed: AtomicU64,
}

impl Counts {
    fn add(counter: &AtomicU64, n: u64) {
        counter.fetch_add(n, Ordering::Relaxed);
    }
}

/// Counts a connection as open until it is dropped.
#[derive(Debug)]
struct OpenConnection(Arc<Counts>);

impl OpenConnection {
    fn new(counts: Arc<Counts>) -> Self {
        counts.connections.fetch_add(1, Ordering::Relaxed);
        Self(counts)
    }
}

impl Drop for OpenConnection {
    fn drop(&mut self) {
        self.0.connections.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Awaits `work`; `None` if `event` comes first.
async fn unless<T>(event: impl Future<Output = ()>, work: impl Future<Output = T>) -> Option<T> {
    match select(pin!(event), pin!(work)).await {
        Either::Left(_) => None,
        Either::Right((done, _)) => Some(done),
    }
}

/// Awaits `work`; `None` if the server stops first.
async fn until<T>(
    stopping: &mut watch::Receiver<bool>,
    work: impl Future<Output = T>,
) -> Option<T> {
    // The sender lives as long as the server: an error also means the end.
    let stop = async { drop(stopping.wait_for(|&stopping| stopping).await) };
    unless(stop, work).await
}

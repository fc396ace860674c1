//! The service over HTTP: a small API, what happens as it happens, and the dashboard.
//!
//! ```text
//! Unix socket ─┐                                                   ┌─► Control::status: at once
//!              ├─► connection: bounds, ─► guard: Host, ─► route ───┼─► lane ─► Control::start …: a thread that may wait
//! TCP ─────────┘   time limits            Origin, token            └─► hub ◄── Control::events, live: a thread each
//! ```
//!
//! Each listener has a thread of its own, `mocapd-socket` and `mocapd-tcp`, and a bounded number of threads for what
//! waits, so that clients of one never wait for those of the other; the data plane knows nothing of it. docs/api.md has the routes and what is promised of them.

mod assets;
mod auth;
mod body;
mod broadcast;
mod commands;
mod connection;
mod guard;

mod login;
mod metrics;
mod options;

mod problem;
mod routes;
mod server;
mod streams;
mod takes;

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

use self::{
    auth::Auth,
    broadcast::{EventBroadcast, LiveBroadcast},
    work_queues::WorkQueues,
};
pub use self::{
    auth::{Token, TokenError},
    options::{CONNECTIONS_MAX, HttpOptions, TimeLimits},
    problem::{Problem, ProblemKind},
    routes::openapi,
    server::HttpServer,
    takes::TakeCheck,
};
use crate::control::Control;

/// The service, and what the server has around it, for the requests of one listener. What can be used up is each
/// listener's own, so that clients of one never wait for those of another.
#[derive(Debug)]
struct App {
    control: Arc<dyn Control>,
    queues: WorkQueues,
    auth: Arc<Auth>,
    counts: Arc<Counts>,
    limits: TimeLimits,
    allowed_hosts: watch::Receiver<Vec<String>>,
    events: Arc<EventBroadcast>,
    live: Arc<LiveBroadcast>,
    /// The API's description of itself.
    document: Bytes,
    /// Answers that go on for as long as the client likes: half of the listener's connections, so that
    /// requests get through.
    streams: Arc<Semaphore>,
    /// Turns true when the server ends.
    stopping: watch::Receiver<bool>,
}

/// What handlers are given.
type Shared = Arc<App>;

/// Held by an answer that goes on.
type StreamPermit = OwnedSemaphorePermit;

impl App {
    /// A place for an answer that goes on for as long as the client likes.
    ///
    /// # Errors
    /// 503 when there are too many.
    fn stream_permit(&self) -> Result<StreamPermit, Problem> {
        Arc::clone(&self.streams).try_acquire_owned().map_err(|_| {
            Problem::unavailable(
                "too many streams and downloads: close one, or try again in a second",
            )
        })
    }
}

/// Which way a request came.
#[derive(Debug, Clone, Copy)]
enum Via {
    /// The Unix socket: its mode says who may come in.
    Unix,
    /// TCP, to this address.
    Tcp(SocketAddr),
}

/// What the server counts of itself, for /metrics: of all connections since the start.
#[derive(Debug, Default)]
struct Counts {
    /// Open now.
    connections: AtomicU64,
    /// Closed at once, because there were too many.
    connections_refused: AtomicU64,
    /// Closed to make room for another one.
    connections_evicted: AtomicU64,
    /// Requests that reached a route, or found none.
    requests: AtomicU64,
    /// Of these, answered with 400 or more.
    requests_refused: AtomicU64,
    /// Frames that viewers were too slow for.
    live_frames_skipped: AtomicU64,
    /// Events that listeners missed.
    events_missed: AtomicU64,
}

impl Counts {
    fn add(counter: &AtomicU64, n: u64) {
        counter.fetch_add(n, Ordering::Relaxed);
    }
}

/// Counts a connection as open while it lives.
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

/// Awaits `work`, or `event`: `None`.
async fn unless<T>(event: impl Future<Output = ()>, work: impl Future<Output = T>) -> Option<T> {
    match select(pin!(event), pin!(work)).await {
        Either::Left(_) => None,
        Either::Right((done, _)) => Some(done),
    }
}

/// Awaits `work`, or that the server stops: `None`.
async fn until<T>(
    stopping: &mut watch::Receiver<bool>,
    work: impl Future<Output = T>,
) -> Option<T> {
    // Its sender lives as long as the server: an error is the end as well.
    let stop = async { drop(stopping.wait_for(|&stopping| stopping).await) };
    unless(stop, work).await
}

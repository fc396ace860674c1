//! The HTTP server: the API, event and live streams, and the dashboard.
//!
//! ```text
//! Unix socket ─┐                                                   ┌─► Control::status: at once
//!              ├─► connection: limits, ─► guard: Host, ─► route ───┼─► queue ─► Control::start …: a thread that may wait
//! TCP ─────────┘   time-outs              Origin, token            └─► hub ◄── Control::events, live: a thread each
//! ```
//!
//! Each listener has its own thread, `mocapd-socket` and `mocapd-tcp`, and a limited number of threads for blocking
//! work, so that clients of one never wait for those of the other. The data plane does not depend on it, and what computes
//! runs at a lower priority than the data plane.
//! docs/api.md describes the routes and their guarantees.

mod auth;
mod body;
mod broadcast;
mod commands;
mod connection;
mod download;
mod guard;
mod metrics;
mod playback;
mod routes;
mod server;
mod takes;
mod work_queues;

use std::{
    net::SocketAddr,
    path::PathBuf,
    pin::pin,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use anyhow::{bail, ensure};
use axum::body::Bytes;
use futures_util::future::{Either, select};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

pub(crate) use self::auth::new_secret;
use self::{
    auth::{Auth, TOKEN_BYTES_MIN},
    broadcast::{EventBroadcast, LiveBroadcast},
    playback::KnownMaps,
    work_queues::WorkQueues,
};
pub use self::{
    auth::{Token, TokenError},
    body::{Problem, ProblemKind},
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

/// Maximum number of connections, for the Unix socket and for TCP separately: enough for a studio's browsers and
/// scripts with a few each, and for those that never finish a request. Each costs at most 50 KB. Connections must leave
/// file descriptors for takes.
pub const CONNECTIONS_MAX: usize = 256;

/// Maximum number of rejected or evicted connections that are read until their client closes. If a socket is closed
/// with unread bytes, the kernel sends a reset, which may overtake the reply; beyond this limit that risk is accepted.
const LINGER_MAX: usize = 32;

/// Connections of the Unix socket beyond `connections_max`: the number of requests that can be running or waiting at
/// once. Half of `connections_max` can be streams, so that even at worst enough connections can be evicted: a user
/// with access to the socket always gets a connection.
const UNIX_EXTRA: usize = work_queues::REQUESTS_MAX;

/// File descriptors that a process has by default: the soft limit of Linux and systemd.
const DESCRIPTORS: usize = 1024;

/// Descriptors for everything but connections: the device, the take and its folder, the journal, timers and listeners
/// need some 40, and each of the 16 threads of the listeners opens a few files.
const DESCRIPTORS_ELSEWHERE: usize = 128;

/// For each of two listeners: its connections, a file for each download (half of them), rejected connections, and one
/// that has just been evicted; for the Unix socket, also its further connections.
const DESCRIPTORS_OF_CONNECTIONS: usize =
    2 * (CONNECTIONS_MAX + CONNECTIONS_MAX.div_ceil(2) + LINGER_MAX + 1) + UNIX_EXTRA;

// 2 * (256 + 128 + 32 + 1) + 61 + 128 = 1023.
const _: () = assert!(DESCRIPTORS_OF_CONNECTIONS + DESCRIPTORS_ELSEWHERE <= DESCRIPTORS);

/// Where the server listens, and for whom.
#[derive(Clone)]
pub struct HttpOptions {
    /// The Unix socket. Its users have full access; its mode is 0660.
    pub unix_socket: Option<PathBuf>,
    /// The TCP address: loopback, or any with a token.
    pub tcp: Option<SocketAddr>,
    /// The token that clients over TCP must send. Without one, everybody on this machine may do everything.
    pub token: Option<String>,
    /// Host names of the service besides `localhost` and its addresses, without ports.
    pub allowed_hosts: Vec<String>,
    /// Maximum number of connections, for the Unix socket and for TCP separately. Further ones are rejected.
    pub connections_max: usize,
    /// Time limits.
    pub limits: TimeLimits,
    /// Serves the player as the first page instead of the dashboard. Its files need no token: its script reads the token
    /// from the part of the address that browsers send to nobody.
    pub is_viewer: bool,
}

impl Default for HttpOptions {
    fn default() -> Self {
        Self {
            unix_socket: None,
            tcp: None,
            token: None,
            allowed_hosts: Vec::new(),
            connections_max: CONNECTIONS_MAX,
            limits: TimeLimits::default(),
            is_viewer: false,
        }
    }
}

impl std::fmt::Debug for HttpOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("HttpOptions")
            .field("unix_socket", &self.unix_socket)
            .field("tcp", &self.tcp)
            // Debug output ends up in logs.
            .field("token", &self.token.as_ref().map(|_| "(hidden)"))
            .field("allowed_hosts", &self.allowed_hosts)
            .field("connections_max", &self.connections_max)
            .field("limits", &self.limits)
            .field("is_viewer", &self.is_viewer)
            .finish()
    }
}

/// Time limits for clients and requests.
#[derive(Debug, Clone, Copy)]
pub struct TimeLimits {
    /// For the head of a request, and between two requests on a connection.
    pub head: Duration,
    /// For the body of a request.
    pub body: Duration,
    /// For a client to read any part of a reply.
    pub stall: Duration,
    /// For the service to execute a request. Execution continues afterwards, and the client is informed.
    pub work: Duration,
    /// Between signs of life on an idle event stream.
    pub keep_alive: Duration,
}

impl Default for TimeLimits {
    fn default() -> Self {
        Self {
            head: Duration::from_secs(10),
            body: Duration::from_secs(10),
            stall: Duration::from_secs(30),
            // A stop waits for a disk that may stall for half a minute before anything is lost.
            work: Duration::from_secs(60),
            keep_alive: Duration::from_secs(15),
        }
    }
}

impl HttpOptions {
    /// Refuses options that are useless, or that would let everybody in.
    fn check(&self) -> anyhow::Result<()> {
        ensure!(
            self.unix_socket.is_some() || self.tcp.is_some(),
            "the HTTP server has neither a socket nor an address: set one of them, or leave the server out"
        );
        ensure!(
            (1..=CONNECTIONS_MAX).contains(&self.connections_max),
            "connections_max is {}: set 1 to {CONNECTIONS_MAX}",
            self.connections_max
        );
        if let Some(token) = &self.token {
            ensure!(
                token.len() >= TOKEN_BYTES_MIN && token.bytes().all(|byte| byte.is_ascii_graphic()),
                "the token must have {TOKEN_BYTES_MIN} or more visible ASCII characters: \
                 create one with `openssl rand -hex 32`"
            );
        }
        if let Some(address) = self.tcp
            && !address.ip().is_loopback()
            && self.token.is_none()
        {
            bail!(
                "{address} is open to the network and there is no token: set one, or listen on \
                 127.0.0.1 and connect through ssh -L"
            );
        }
        for host in &self.allowed_hosts {
            ensure!(
                !host.is_empty() && !host.contains(['/', '*', '@', ' ']) && !has_port(host),
                "'{host}' is not a host name: write it as in the browser, without scheme and port"
            );
        }
        Ok(())
    }
}

fn has_port(host: &str) -> bool {
    host.rsplit_once(':').is_some_and(|(name, _)| !name.contains(':'))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn on(address: &str, token: Option<&str>) -> HttpOptions {
        HttpOptions {
            tcp: Some(address.parse().unwrap()),
            token: token.map(str::to_owned),
            ..HttpOptions::default()
        }
    }

    #[test]
    fn the_network_needs_a_token() {
        let refused = on("0.0.0.0:7060", None).check().unwrap_err().to_string();
        assert!(refused.contains("0.0.0.0:7060") && refused.contains("127.0.0.1"), "{refused}");
        assert!(on("[::]:7060", None).check().is_err());
        assert!(on("127.0.0.1:7060", None).check().is_ok());
        assert!(on("[::1]:7060", None).check().is_ok());
        assert!(on("0.0.0.0:7060", Some("0123456789abcde")).check().is_err(), "too short");
        assert!(on("0.0.0.0:7060", Some("0123456789abc def")).check().is_err(), "a blank");
        let open = on("0.0.0.0:7060", Some("0123456789abcdef"));
        assert!(open.check().is_ok());
        assert!(!format!("{open:?}").contains("0123456789"), "{open:?}");
    }

    #[test]
    fn connections_leave_descriptors_for_takes() {
        let with = |connections_max| {
            HttpOptions { connections_max, ..on("127.0.0.1:1", None) }.check().is_ok()
        };
        let found = [0, 1, CONNECTIONS_MAX, CONNECTIONS_MAX + 1].map(with);
        assert_eq!(found, [false, true, true, false]);
    }

    #[test]
    fn hosts_are_names() {
        let with = |host: &str| {
            HttpOptions { allowed_hosts: vec![host.to_owned()], ..on("127.0.0.1:1", None) }.check()
        };
        assert!(with("rig.lab.example").is_ok() && with("::1").is_ok());
        for host in ["http://rig", "rig:80", "*.lab", "", "a b"] {
            assert!(with(host).is_err(), "{host}");
        }
        assert!(HttpOptions::default().check().is_err(), "nothing to listen on");
    }
}

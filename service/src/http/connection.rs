//! Connections: their number, their time limits, and how each is served. Clients must keep reading their replies.
//!
//! Each listener has a limited number of slots. A connection that does nothing useful must not keep others out. If all slots
//! are in use, a new connection replaces one that has never made an authorized request, or otherwise one that is idle or still
//! sending its request. A connection is never closed while an authorized request of it is being executed, or before the kernel
//! has accepted its reply.

use std::{
    cmp::Reverse,
    collections::HashMap,
    io,
    net::{IpAddr, Ipv6Addr, Shutdown},
    os::fd::AsFd,
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    task::{Context, Poll},
    time::Duration,
};

use axum::{
    Router,
    body::{Body, Bytes},
};
use hyper::{
    Request,
    body::{Body as HttpBody, Frame, Incoming, SizeHint},
    server::conn::http1,
    service::service_fn,
};
use hyper_util::rt::{TokioIo, TokioTimer};
use socket2::SockRef;
use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, ReadBuf},
    net::{TcpListener, UnixListener},
    sync::{Notify, OwnedSemaphorePermit, Semaphore, watch},
    task::yield_now,
    time::{Instant, Sleep, sleep, timeout},
};
use tower_service::Service;

use super::{Counts, LINGER_MAX, OpenConnection, TimeLimits, Via, unless, until};

/// Largest request head in bytes: browsers send one or two kilobytes, including cookies of other ports.
const HEAD_BYTES_MAX: usize = 16 << 10;

/// Maximum number of header lines: browsers send some twenty.
const HEADERS_MAX: usize = 64;

/// Time for a rejected client to read the reply and close.
const LINGER_TIME_MAX: Duration = Duration::from_secs(1);

/// Time before accepting again when the process has no file descriptors left.
const ACCEPT_AGAIN: Duration = Duration::from_millis(50);

/// State shared by all connections of one listener.
#[derive(Clone)]
pub(super) struct Acceptor {
    pub(super) router: Router,
    pub(super) limits: TimeLimits,
    pub(super) counts: Arc<Counts>,
    pub(super) slots: Arc<ConnectionSlots>,
    pub(super) lingering: Arc<Semaphore>,
    pub(super) stopping: watch::Receiver<bool>,
    /// Held by every connection, so that the sender notices when all are closed.
    pub(super) alive: watch::Receiver<()>,
}

impl std::fmt::Debug for Acceptor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Acceptor").field("slots", &self.slots).finish_non_exhaustive()
    }
}

impl Acceptor {
    pub(super) fn lingering() -> Arc<Semaphore> {
        Arc::new(Semaphore::new(LINGER_MAX))
    }

    pub(super) async fn serve_unix(mut self, listener: UnixListener) {
        while let Some(accepted) = until(&mut self.stopping, listener.accept()).await {
            match accepted {
                Ok((stream, _)) => {
                    let user = stream.peer_cred().map(|peer| peer.uid());
                    self.admit(stream, Via::Unix, Peer::User(user.ok()));
                    yield_now().await;
                }
                Err(_) => sleep(ACCEPT_AGAIN).await,
            }
        }
    }

    pub(super) async fn serve_tcp(mut self, listener: TcpListener) {
        while let Some(accepted) = until(&mut self.stopping, listener.accept()).await {
            match accepted {
                Ok((stream, from)) => {
                    // Replies are written whole, and events should leave at once. If this fails, they are some ms
                    // later.
                    stream.set_nodelay(true).ok();
                    match stream.local_addr().map(Via::Tcp) {
                        Ok(via) => self.admit(stream, via, Peer::of_address(from.ip())),
                        // The connection was reset before it was accepted.
                        Err(_) => Counts::add(&self.counts.connections_refused, 1),
                    }
                    yield_now().await;
                }
                Err(_) => sleep(ACCEPT_AGAIN).await,
            }
        }
    }

    /// Callers yield afterwards, so that an evicted connection closes before the next is accepted: even under load,
    /// at most one more descriptor is open than there are slots.
    fn admit<S: Stream>(&self, stream: S, via: Via, peer: Peer) {
        let Some(guard) = self.slots.take(peer) else {
            Counts::add(&self.counts.connections_refused, 1);
            self.reject(stream);
            return;
        };
        let open = OpenConnection::new(Arc::clone(&self.counts));
        let acceptor = self.clone();
        tokio::spawn(async move {
            acceptor.serve(stream, via, &guard).await;
            drop((open, guard));
        });
    }

    async fn serve<S: Stream>(mut self, stream: S, via: Via, guard: &SlotGuard) {
        let io = TokioIo::new(StallGuard::new(stream, Arc::clone(guard.slot()), self.limits.stall));
        let router = self.router.clone();
        let slot = Arc::clone(guard.slot());
        let service = service_fn(move |request: Request<Incoming>| {
            let mut request = request.map(|body| slot.request_body(Body::new(body)));
            request.extensions_mut().insert(via);
            request.extensions_mut().insert(Arc::clone(&slot));
            let (slot, answer) = (Arc::clone(&slot), router.clone().call(request));
            async move { answer.await.map(|response| response.map(|body| slot.response_body(body))) }
        });
        let mut server = http1::Builder::new();
        server
            .timer(TokioTimer::new())
            .header_read_timeout(self.limits.head)
            .max_buf_size(HEAD_BYTES_MAX)
            .max_headers(HEADERS_MAX);
        let mut connection = server.serve_connection(io, service);
        // A broken connection (a reset, an invalid header, a limit) already got its reply if that was possible.
        let served = unless(guard.slot().evicted(), Pin::new(&mut connection));
        match until(&mut self.stopping, served).await {
            Some(Some(_)) => {}
            Some(None) => {
                Counts::add(&self.counts.connections_evicted, 1);
                // After a reply, another one would be taken for the reply to the next request.
                if !guard.slot().has_answered() {
                    let stream = connection.into_parts().io.into_inner().into_inner();
                    self.reject(stream);
                }
            }
            None => {
                Pin::new(&mut connection).graceful_shutdown();
                connection.await.ok();
            }
        }
        drop(self.alive);
    }

    /// Replies 503 and closes, without waiting for the client.
    fn reject<S: Stream>(&self, stream: S) {
        const BODY: &str = r#"{"status":503,"kind":"unavailable","message":"too many connections: close one, or try again in a second"}"#;
        let answer = format!(
            "HTTP/1.1 503 Service Unavailable\r\ncontent-type: application/problem+json\r\nretry-after: 1\r\n\
             connection: close\r\ncontent-length: {}\r\n\r\n{BODY}",
            BODY.len()
        );
        let socket = SockRef::from(&stream);
        // The call does not block, and an unused send buffer is large enough.
        socket.send(answer.as_bytes()).ok();
        socket.shutdown(Shutdown::Write).ok();
        if let Ok(permit) = Arc::clone(&self.lingering).try_acquire_owned() {
            tokio::spawn(linger(stream, permit));
        }
    }
}

/// The properties of both kinds of sockets.
pub(super) trait Stream: AsyncRead + AsyncWrite + AsFd + Unpin + Send + 'static {}

impl<S: AsyncRead + AsyncWrite + AsFd + Unpin + Send + 'static> Stream for S {}

/// Reads until the client closes, so that no reset overtakes the reply.
async fn linger<S: Stream>(mut stream: S, permit: OwnedSemaphorePermit) {
    let mut dropped = [0; 1024];
    let to_the_end = async { while stream.read(&mut dropped).await.is_ok_and(|n| n > 0) {} };
    // The connection is closed in any case.
    timeout(LINGER_TIME_MAX, to_the_end).await.ok();
    drop(permit);
}

/// Fails a write that is blocked for longer than `stall_max`. Nothing else limits a client that requests a large reply
/// and never reads it.
#[derive(Debug)]
struct StallGuard<S> {
    stream: S,
    slot: Arc<ConnectionSlot>,
    stall_max: Duration,
    deadline: Pin<Box<Sleep>>,
    is_waiting: bool,
}

impl<S> StallGuard<S> {
    pub(super) fn new(stream: S, slot: Arc<ConnectionSlot>, stall_max: Duration) -> Self {
        Self { stream, slot, stall_max, deadline: Box::pin(sleep(stall_max)), is_waiting: false }
    }

    pub(super) fn into_inner(self) -> S {
        self.stream
    }

    fn watch<T>(
        &mut self,
        cx: &mut Context<'_>,
        polled: Poll<io::Result<T>>,
    ) -> Poll<io::Result<T>> {
        if polled.is_ready() {
            self.is_waiting = false;
            return polled;
        }
        if !self.is_waiting {
            self.is_waiting = true;
            self.deadline.as_mut().reset(Instant::now() + self.stall_max);
        }
        self.deadline.as_mut().poll(cx).map(|()| Err(io::ErrorKind::TimedOut.into()))
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for StallGuard<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, buf)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for StallGuard<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &[u8],
    ) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write(cx, buf);
        self.watch(cx, polled)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write_vectored(cx, bufs);
        self.watch(cx, polled)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        // hyper flushes when its buffer is empty, and after each reply.
        let polled = Pin::new(&mut self.stream).poll_flush(cx);
        if matches!(polled, Poll::Ready(Ok(()))) {
            self.slot.flushed();
        }
        self.watch(cx, polled)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let polled = Pin::new(&mut self.stream).poll_shutdown(cx);
        self.watch(cx, polled)
    }
}

/// The client of a connection, for counting connections together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Peer {
    /// A user of this machine, on the Unix socket; `None` if the kernel does not report it.
    User(Option<u32>),
    /// An address. For IPv6 its first 64 bits: a host may use all of the others.
    Address(IpAddr),
}

impl Peer {
    fn of_address(address: IpAddr) -> Self {
        Self::Address(match address.to_canonical() {
            IpAddr::V6(address) => {
                let network = u128::from(address) >> 64 << 64;
                Ipv6Addr::from(network).into()
            }
            address @ IpAddr::V4(_) => address,
        })
    }
}

/// The connections of one listener.
#[derive(Debug)]
pub(super) struct ConnectionSlots {
    max: usize,
    open: Mutex<Vec<Arc<ConnectionSlot>>>,
}

/// The slot of one connection.
#[derive(Debug)]
pub(super) struct ConnectionSlot {
    peer: Peer,
    state: Mutex<SlotState>,
    evicted: Notify,
}

#[derive(Debug, Clone, Copy)]
struct SlotState {
    /// Whether it has made a request that needs authorization, and was allowed.
    is_authorized: bool,
    /// Whether a request has been received completely, and its reply has not been sent.
    is_busy: bool,
    /// Whether the reply is in hyper's buffer, which drops the body before its last bytes are sent.
    is_flushing: bool,
    /// Whether it has been sent a reply, or part of one.
    has_answered: bool,
    /// Since when it is neither busy nor evicted.
    since: Instant,
}

/// A slot in use; freed when dropped.
#[derive(Debug)]
pub(super) struct SlotGuard {
    slots: Arc<ConnectionSlots>,
    slot: Arc<ConnectionSlot>,
}

impl ConnectionSlots {
    pub(super) fn new(max: usize) -> Arc<Self> {
        Arc::new(Self { max, open: Mutex::new(Vec::with_capacity(max)) })
    }

    /// Takes a slot for a connection of this peer; `None` if all slots are busy.
    pub(super) fn take(self: &Arc<Self>, peer: Peer) -> Option<SlotGuard> {
        let mut open = self.lock();
        if open.len() >= self.max {
            // The evicted connection's task learns of it a moment later: until then, `max` + 1 connections are open.
            let at = evictable(&open)?;
            open.swap_remove(at).evicted.notify_one();
        }
        let state = Mutex::new(SlotState {
            is_authorized: false,
            is_busy: false,
            is_flushing: false,
            has_answered: false,
            since: Instant::now(),
        });
        let slot = Arc::new(ConnectionSlot { peer, state, evicted: Notify::new() });
        open.push(Arc::clone(&slot));
        Some(SlotGuard { slots: Arc::clone(self), slot })
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Arc<ConnectionSlot>>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Selects the connection to evict: of the peer with the most evictable slots, the connection that has held its slot
/// for longest.
fn evictable(open: &[Arc<ConnectionSlot>]) -> Option<usize> {
    let states: Vec<SlotState> = open.iter().map(|slot| *slot.lock()).collect();
    let only_unauthorized = states.iter().any(|state| !state.is_authorized);
    let is_kept = |s: &SlotState| if only_unauthorized { s.is_authorized } else { s.is_busy };
    let candidates: Vec<usize> = (0..open.len()).filter(|&at| !is_kept(&states[at])).collect();
    let mut held: HashMap<Peer, usize> = HashMap::new();
    for &at in &candidates {
        *held.entry(open[at].peer).or_default() += 1;
    }
    let rank = |at: usize| (held.get(&open[at].peer), Reverse(states[at].since));
    candidates.into_iter().max_by_key(|&at| rank(at))
}

impl SlotGuard {
    /// The slot, as routes see it.
    pub(super) fn slot(&self) -> &Arc<ConnectionSlot> {
        &self.slot
    }
}

impl Drop for SlotGuard {
    fn drop(&mut self) {
        self.slots.lock().retain(|slot| !Arc::ptr_eq(slot, &self.slot));
    }
}

impl ConnectionSlot {
    /// A request that needs authorization was allowed.
    pub(super) fn authorize(&self) {
        self.lock().is_authorized = true;
    }

    /// Resolves when another connection has taken the slot.
    pub(super) async fn evicted(&self) {
        self.evicted.notified().await;
    }

    /// Whether a reply was sent on this connection.
    fn has_answered(&self) -> bool {
        self.lock().has_answered
    }

    /// The request's body, whose progress is tracked in the slot.
    pub(super) fn request_body(self: &Arc<Self>, body: Body) -> Body {
        if body.is_end_stream() {
            self.arrived();
            return body;
        }
        Body::new(Tracked { body, slot: Arc::clone(self), direction: Direction::Request })
    }

    /// The reply's body, whose progress is tracked in the slot.
    fn response_body(self: &Arc<Self>, body: Body) -> Body {
        self.lock().has_answered = true;
        Body::new(Tracked { body, slot: Arc::clone(self), direction: Direction::Response })
    }

    /// The kernel has accepted everything written to the connection.
    fn flushed(&self) {
        let mut state = self.lock();
        if state.is_flushing {
            state.is_flushing = false;
            state.is_busy = false;
            state.since = Instant::now();
        }
    }

    /// A request has been received completely. A reply that is still being sent belongs to the previous one.
    fn arrived(&self) {
        let mut state = self.lock();
        state.is_busy = true;
        state.is_flushing = false;
    }

    fn lock(&self) -> MutexGuard<'_, SlotState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Direction {
    Request,
    Response,
}

/// A body that notifies its slot when it has been received or written.
#[derive(Debug)]
struct Tracked {
    body: Body,
    slot: Arc<ConnectionSlot>,
    direction: Direction,
}

impl HttpBody for Tracked {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let polled = Pin::new(&mut self.body).poll_frame(cx);
        let is_whole = matches!(polled, Poll::Ready(None)) || self.body.is_end_stream();
        if is_whole && self.direction == Direction::Request {
            self.slot.arrived();
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

impl Drop for Tracked {
    fn drop(&mut self) {
        if self.direction == Direction::Response {
            self.slot.lock().is_flushing = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{convert::Infallible, net::IpAddr};

    use axum::body::Body;
    use hyper::{Request, Response, body::Incoming, server::conn::http1, service::service_fn};
    use hyper_util::rt::TokioIo;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    use super::*;

    const BODY_BYTES: usize = 10_000;

    /// Bytes that the connection buffers until the client reads.
    const PIPE_BYTES: usize = 256;

    #[test]
    fn a_reply_in_hypers_buffer_keeps_its_slot() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        runtime.block_on(async {
            let peer = |last| Peer::of_address(IpAddr::from([192, 0, 2, last]));
            let slots = ConnectionSlots::new(1);
            let guard = slots.take(peer(1)).unwrap();
            guard.slot().authorize();
            let (mut client, server) = tokio::io::duplex(PIPE_BYTES);
            let slot = Arc::clone(guard.slot());
            let service = service_fn(move |request: Request<Incoming>| {
                drop(slot.request_body(Body::new(request.into_body())));
                // One frame, which hyper accepts as a whole.
                let answer = Response::new(slot.response_body(Body::from(vec![b'x'; BODY_BYTES])));
                async move { Ok::<_, Infallible>(answer) }
            });
            let stall_max = Duration::from_secs(600);
            let io = TokioIo::new(StallGuard::new(server, Arc::clone(guard.slot()), stall_max));
            let connection = tokio::spawn(http1::Builder::new().serve_connection(io, service));
            for _ in 0..2 {
                client.write_all(b"GET / HTTP/1.1\r\nhost: a\r\n\r\n").await.unwrap();
                let mut begun = [0; PIPE_BYTES];
                client.read_exact(&mut begun).await.unwrap();
                assert!(slots.take(peer(2)).is_none(), "its answer is not sent");
                let head_bytes = begun.windows(4).position(|end| end == b"\r\n\r\n").unwrap() + 4;
                let mut rest = vec![0; head_bytes + BODY_BYTES - PIPE_BYTES];
                client.read_exact(&mut rest).await.unwrap();
            }
            assert!(slots.take(peer(2)).is_some(), "it is idle");
            connection.abort();
        });
    }

    fn address(last: u8) -> Peer {
        Peer::of_address(IpAddr::from([192, 0, 2, last]))
    }

    fn is_evicted(guard: &SlotGuard) -> bool {
        !guard.slots.lock().iter().any(|slot| Arc::ptr_eq(slot, &guard.slot))
    }

    #[test]
    fn unauthorized_connections_are_evicted_first() {
        let slots = ConnectionSlots::new(4);
        let known = slots.take(address(1)).unwrap();
        known.slot.authorize();
        let single = slots.take(address(2)).unwrap();
        let crowd = [slots.take(address(3)).unwrap(), slots.take(address(3)).unwrap()];
        let newcomer = slots.take(address(4)).unwrap();
        let evicted = [&known, &single, &crowd[0], &crowd[1], &newcomer].map(is_evicted);
        assert_eq!(evicted, [false, false, true, false, false]);
        // A guard whose connection was evicted frees no slot of another one.
        drop(crowd);
        assert_eq!(slots.lock().len(), 3);
    }

    #[test]
    fn a_busy_connection_is_never_evicted_and_an_idle_one_is() {
        let slots = ConnectionSlots::new(2);
        let guards: Vec<SlotGuard> = (0..2).map(|_| slots.take(address(1)).unwrap()).collect();
        for guard in &guards {
            guard.slot.authorize();
            drop(guard.slot.request_body(Body::empty()));
        }
        assert!(slots.take(address(2)).is_none());
        drop(guards[1].slot.response_body(Body::empty()));
        assert!(slots.take(address(2)).is_none(), "its answer is not sent");
        guards[0].slot.flushed();
        guards[1].slot.flushed();
        let newcomer = slots.take(address(2)).unwrap();
        assert!(!is_evicted(&guards[0]) && is_evicted(&guards[1]) && !is_evicted(&newcomer));
    }

    #[test]
    fn a_request_is_busy_when_its_body_is_whole() {
        let slots = ConnectionSlots::new(1);
        let guard = slots.take(address(1)).unwrap();
        guard.slot.authorize();
        let mut body = guard.slot.request_body(Body::from("{}"));
        assert!(!guard.slot.lock().is_busy);
        let mut cx = Context::from_waker(std::task::Waker::noop());
        assert!(Pin::new(&mut body).poll_frame(&mut cx).is_ready());
        assert!(guard.slot.lock().is_busy);
    }

    #[test]
    fn a_host_of_ipv6_is_one_peer() {
        let peer = |address: &str| Peer::of_address(address.parse().unwrap());
        assert_eq!(peer("2001:db8::1"), peer("2001:db8::ffff:1"));
        assert_ne!(peer("2001:db8::1"), peer("2001:db8:0:1::1"));
        assert_eq!(peer("::ffff:192.0.2.1"), address(1));
    }
}

//! Connections: how many, how long, and what becomes of one.

use std::{
    net::{Shutdown, SocketAddr},
    os::fd::AsFd,
    pin::Pin,
    sync::Arc,
    task::Poll,
    time::Duration,
};

use axum::{Router, body::Body};
use hyper::{Request, body::Incoming, server::conn::http1, service::service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use socket2::SockRef;
use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite},
    net::{TcpListener, UnixListener},
    sync::{OwnedSemaphorePermit, Semaphore, watch},
    task::yield_now,
    time::{sleep, timeout},
};
use tower_service::Service;

use super::{
    counts::{Counts, Open},
    options::TimeLimits,
    places::{Peer, Places, Taken},
    stall::StallGuard,
};

/// Bytes of a request's head at most: browsers send one or two kilobytes, cookies of other ports included.
const HEAD_BYTES_MAX: usize = 16 << 10;

/// Header lines at most; browsers send some twenty.
const HEADERS_MAX: usize = 64;

/// Connections that were refused or evicted and are read until their end closes, at once. Closed with bytes unread, the
/// kernel sends a reset, which may overtake the answer; beyond this bound that risk is taken.
pub(super) const LINGER_MAX: usize = 32;

/// For such a one to read its answer and to close.
const LINGER_TIME_MAX: Duration = Duration::from_secs(1);

/// Before accepting is tried again when the process has no descriptor left.
const ACCEPT_AGAIN: Duration = Duration::from_millis(50);

/// Which way a request came.
#[derive(Debug, Clone, Copy)]
pub(super) enum Via {
    /// The Unix socket: its mode says who may come in.
    Unix,
    /// TCP, to this address.
    Tcp(SocketAddr),
}

/// What all connections of one listener share.
#[derive(Clone)]
pub(super) struct Doorway {
    pub(super) router: Router,
    pub(super) limits: TimeLimits,
    pub(super) counts: Arc<Counts>,
    pub(super) places: Arc<Places>,
    pub(super) lingering: Arc<Semaphore>,
    pub(super) stopping: watch::Receiver<bool>,
    /// Held by every connection: when all are gone the other end knows.
    pub(super) alive: watch::Receiver<()>,
}

impl std::fmt::Debug for Doorway {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Doorway").field("places", &self.places).finish_non_exhaustive()
    }
}

impl Doorway {
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
                    // Answers are written whole; an event is to leave at once. Refused, it is later by some ms.
                    stream.set_nodelay(true).ok();
                    match stream.local_addr() {
                        Ok(local) => {
                            self.admit(stream, Via::Tcp(local), Peer::of_address(from.ip()));
                        }
                        // It was reset before it was accepted.
                        Err(_) => Counts::add(&self.counts.connections_refused, 1),
                    }
                    yield_now().await;
                }
                Err(_) => sleep(ACCEPT_AGAIN).await,
            }
        }
    }

    /// Callers yield behind it: a connection that made room closes before the next one is accepted, so that a rush of
    /// them holds one descriptor more than there are places.
    fn admit<S: Stream>(&self, stream: S, via: Via, peer: Peer) {
        let Some(taken) = self.places.take(peer) else {
            Counts::add(&self.counts.connections_refused, 1);
            self.turn_away(stream);
            return;
        };
        let open = Open::new(Arc::clone(&self.counts));
        let doorway = self.clone();
        tokio::spawn(async move {
            doorway.serve(stream, via, &taken).await;
            drop((open, taken));
        });
    }

    async fn serve<S: Stream>(mut self, stream: S, via: Via, taken: &Taken) {
        let io =
            TokioIo::new(StallGuard::new(stream, Arc::clone(taken.place()), self.limits.stall));
        let router = self.router.clone();
        let place = Arc::clone(taken.place());
        let service = service_fn(move |request: Request<Incoming>| {
            let mut request = request.map(|body| place.request_body(Body::new(body)));
            request.extensions_mut().insert(via);
            request.extensions_mut().insert(Arc::clone(&place));
            let (place, answer) = (Arc::clone(&place), router.clone().call(request));
            async move { answer.await.map(|response| response.map(|body| place.response_body(body))) }
        });
        let mut server = http1::Builder::new();
        server
            .timer(TokioTimer::new())
            .header_read_timeout(self.limits.head)
            .max_buf_size(HEAD_BYTES_MAX)
            .max_headers(HEADERS_MAX);
        let mut connection = server.serve_connection(io, service);
        // What breaks a connection (a reset, a head that is none, a limit) was answered as far as it can be.
        let served = unless(taken.place().evicted(), Pin::new(&mut connection));
        match until(&mut self.stopping, served).await {
            Some(Some(_)) => {}
            Some(None) => {
                Counts::add(&self.counts.connections_evicted, 1);
                // Behind an answer, another one would be taken for that of the next request.
                if !taken.place().has_answered() {
                    let stream = connection.into_parts().io.into_inner().into_inner();
                    self.turn_away(stream);
                }
            }
            None => {
                Pin::new(&mut connection).graceful_shutdown();
                connection.await.ok();
            }
        }
        drop(self.alive);
    }

    /// Answers 503 and closes, without waiting for the other end.
    fn turn_away<S: Stream>(&self, stream: S) {
        const BODY: &str = r#"{"status":503,"kind":"unavailable","message":"too many connections: close one, or try again in a second"}"#;
        let answer = format!(
            "HTTP/1.1 503 Service Unavailable\r\ncontent-type: application/problem+json\r\nretry-after: 1\r\n\
             connection: close\r\ncontent-length: {}\r\n\r\n{BODY}",
            BODY.len()
        );
        let socket = SockRef::from(&stream);
        // It does not block, and a buffer that nothing was written to holds more than that.
        socket.send(answer.as_bytes()).ok();
        socket.shutdown(Shutdown::Write).ok();
        if let Ok(place) = Arc::clone(&self.lingering).try_acquire_owned() {
            tokio::spawn(linger(stream, place));
        }
    }
}

/// What both kinds of sockets are.
pub(super) trait Stream: AsyncRead + AsyncWrite + AsFd + Unpin + Send + 'static {}

impl<S: AsyncRead + AsyncWrite + AsFd + Unpin + Send + 'static> Stream for S {}

/// Reads until the other end closes, so that no reset overtakes what it was sent.
async fn linger<S: Stream>(mut stream: S, place: OwnedSemaphorePermit) {
    let mut dropped = [0; 1024];
    let to_the_end = async { while stream.read(&mut dropped).await.is_ok_and(|n| n > 0) {} };
    // It is closed in any case.
    timeout(LINGER_TIME_MAX, to_the_end).await.ok();
    drop(place);
}

/// Awaits `work`, or `event`: `None`.
async fn unless<T>(event: impl Future<Output = ()>, work: impl Future<Output = T>) -> Option<T> {
    let (mut event, mut work) = (std::pin::pin!(event), std::pin::pin!(work));
    std::future::poll_fn(|cx| {
        if event.as_mut().poll(cx).is_ready() {
            return Poll::Ready(None);
        }
        work.as_mut().poll(cx).map(Some)
    })
    .await
}

/// Awaits `work`, or that the server stops: `None`.
pub(super) async fn until<T>(
    stopping: &mut watch::Receiver<bool>,
    work: impl Future<Output = T>,
) -> Option<T> {
    // Its sender lives as long as the server: an error is the end as well.
    let stop = async { drop(stopping.wait_for(|&stopping| stopping).await) };
    unless(stop, work).await
}

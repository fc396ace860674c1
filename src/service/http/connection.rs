//! Connections: how many, how long, and what becomes of one.

use std::{net::SocketAddr, sync::Arc, time::Duration};

use axum::{Router, body::Body};
use hyper::{Request, body::Incoming, server::conn::http1, service::service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt},
    net::{TcpListener, UnixListener},
    sync::{OwnedSemaphorePermit, Semaphore, watch},
    time::{sleep, timeout},
};
use tower_service::Service;

use super::{
    counts::{Counts, Open},
    options::TimeLimits,
    stall::StallGuard,
};

/// Bytes of a request's head at most: browsers send one or two kilobytes, cookies of other ports included.
const HEAD_BYTES_MAX: usize = 16 << 10;

/// Header lines at most; browsers send some twenty.
const HEADERS_MAX: usize = 64;

/// Connections over the bound that are told so at the same time; more are closed without a word.
const TOLD_MAX: usize = 32;

/// For such a one to read what it is told.
const TOLD_WITHIN: Duration = Duration::from_secs(1);

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
    pub(super) places: Arc<Semaphore>,
    pub(super) told: Arc<Semaphore>,
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
    pub(super) fn told() -> Arc<Semaphore> {
        Arc::new(Semaphore::new(TOLD_MAX))
    }

    pub(super) async fn serve_unix(mut self, listener: UnixListener) {
        while let Some(accepted) = until(&mut self.stopping, listener.accept()).await {
            match accepted {
                Ok((stream, _)) => self.admit(stream, Via::Unix),
                Err(_) => sleep(ACCEPT_AGAIN).await,
            }
        }
    }

    pub(super) async fn serve_tcp(mut self, listener: TcpListener) {
        while let Some(accepted) = until(&mut self.stopping, listener.accept()).await {
            match accepted {
                Ok((stream, _)) => {
                    // Answers are written whole; an event is to leave at once. Refused, it is later by some ms.
                    stream.set_nodelay(true).ok();
                    match stream.local_addr() {
                        Ok(local) => self.admit(stream, Via::Tcp(local)),
                        // It went away before it was looked at.
                        Err(_) => Counts::add(&self.counts.connections_refused, 1),
                    }
                }
                Err(_) => sleep(ACCEPT_AGAIN).await,
            }
        }
    }

    fn admit<S: AsyncRead + AsyncWrite + Unpin + Send + 'static>(&self, stream: S, via: Via) {
        let Ok(place) = Arc::clone(&self.places).try_acquire_owned() else {
            Counts::add(&self.counts.connections_refused, 1);
            if let Ok(told) = Arc::clone(&self.told).try_acquire_owned() {
                tokio::spawn(turn_away(stream, told));
            }
            return;
        };
        let open = Open::new(Arc::clone(&self.counts));
        let doorway = self.clone();
        tokio::spawn(async move {
            doorway.serve(stream, via).await;
            drop((open, place));
        });
    }

    async fn serve<S: AsyncRead + AsyncWrite + Unpin + Send + 'static>(
        mut self,
        stream: S,
        via: Via,
    ) {
        let io = TokioIo::new(StallGuard::new(stream, self.limits.stall));
        let router = self.router.clone();
        let service = service_fn(move |request: Request<Incoming>| {
            let mut request = request.map(Body::new);
            request.extensions_mut().insert(via);
            router.clone().call(request)
        });
        let mut server = http1::Builder::new();
        server
            .timer(TokioTimer::new())
            .header_read_timeout(self.limits.head)
            .max_buf_size(HEAD_BYTES_MAX)
            .max_headers(HEADERS_MAX);
        let mut connection = std::pin::pin!(server.serve_connection(io, service));
        // What breaks a connection (a reset, a head that is none, a limit) was answered as far as it can be.
        if until(&mut self.stopping, connection.as_mut()).await.is_none() {
            connection.as_mut().graceful_shutdown();
            connection.await.ok();
        }
        drop(self.alive);
    }
}

/// Awaits `work`, or that the server stops: `None`.
pub(super) async fn until<T>(
    stopping: &mut watch::Receiver<bool>,
    work: impl Future<Output = T>,
) -> Option<T> {
    let mut work = std::pin::pin!(work);
    let mut stop = std::pin::pin!(stopping.wait_for(|&stopping| stopping));
    std::future::poll_fn(|cx| {
        if stop.as_mut().poll(cx).is_ready() {
            return std::task::Poll::Ready(None);
        }
        work.as_mut().poll(cx).map(Some)
    })
    .await
}

/// Says that there are too many, and closes. What the client sent meanwhile is read, or the reset for it would
/// overtake the words.
async fn turn_away<S: AsyncRead + AsyncWrite + Unpin>(mut stream: S, told: OwnedSemaphorePermit) {
    const BODY: &str = r#"{"status":503,"kind":"unavailable","message":"too many connections: close one, or try again in a second"}"#;
    let answer = format!(
        "HTTP/1.1 503 Service Unavailable\r\ncontent-type: application/problem+json\r\nretry-after: 1\r\n\
         connection: close\r\ncontent-length: {}\r\n\r\n{BODY}",
        BODY.len()
    );
    let words = async {
        stream.write_all(answer.as_bytes()).await?;
        stream.shutdown().await?;
        let mut dropped = [0; 1024];
        while stream.read(&mut dropped).await? > 0 {}
        std::io::Result::Ok(())
    };
    // It is closed in any case.
    timeout(TOLD_WITHIN, words).await.ok();
    drop(told);
}

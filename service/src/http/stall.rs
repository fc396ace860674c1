//! A connection whose other end must take in something from time to time, and whose place hears what was sent.

use std::{
    io,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
    time::Duration,
};

use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    time::{Instant, Sleep, sleep},
};

use super::places::Place;

/// Fails a write that waits for longer than `stall_max`. Nothing else bounds a client that asks for a large answer
/// and never reads it.
#[derive(Debug)]
pub(super) struct StallGuard<S> {
    stream: S,
    place: Arc<Place>,
    stall_max: Duration,
    deadline: Pin<Box<Sleep>>,
    is_waiting: bool,
}

impl<S> StallGuard<S> {
    pub(super) fn new(stream: S, place: Arc<Place>, stall_max: Duration) -> Self {
        Self { stream, place, stall_max, deadline: Box::pin(sleep(stall_max)), is_waiting: false }
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
        match self.deadline.as_mut().poll(cx) {
            Poll::Ready(()) => Poll::Ready(Err(io::ErrorKind::TimedOut.into())),
            Poll::Pending => Poll::Pending,
        }
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
        // hyper flushes when its buffer is empty, and after each answer.
        let polled = Pin::new(&mut self.stream).poll_flush(cx);
        if matches!(polled, Poll::Ready(Ok(()))) {
            self.place.flushed();
        }
        self.watch(cx, polled)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let polled = Pin::new(&mut self.stream).poll_shutdown(cx);
        self.watch(cx, polled)
    }
}

#[cfg(test)]
mod tests {
    use std::{convert::Infallible, net::IpAddr};

    use axum::body::Body;
    use hyper::{Request, Response, body::Incoming, server::conn::http1, service::service_fn};
    use hyper_util::rt::TokioIo;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    use super::{
        super::places::{Peer, Places},
        *,
    };

    const BODY_BYTES: usize = 10_000;

    /// What the connection takes before the client reads.
    const PIPE_BYTES: usize = 256;

    #[test]
    fn an_answer_that_is_still_in_hypers_buffer_keeps_its_place() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        runtime.block_on(async {
            let peer = |last| Peer::of_address(IpAddr::from([192, 0, 2, last]));
            let places = Places::new(1);
            let taken = places.take(peer(1)).unwrap();
            taken.place().authorize();
            let (mut client, server) = tokio::io::duplex(PIPE_BYTES);
            let place = Arc::clone(taken.place());
            let service = service_fn(move |request: Request<Incoming>| {
                drop(place.request_body(Body::new(request.into_body())));
                // One frame, which hyper takes as a whole.
                let answer = Response::new(place.response_body(Body::from(vec![b'x'; BODY_BYTES])));
                async move { Ok::<_, Infallible>(answer) }
            });
            let stall_max = Duration::from_secs(600);
            let io = TokioIo::new(StallGuard::new(server, Arc::clone(taken.place()), stall_max));
            let connection = tokio::spawn(http1::Builder::new().serve_connection(io, service));
            for _ in 0..2 {
                client.write_all(b"GET / HTTP/1.1\r\nhost: a\r\n\r\n").await.unwrap();
                let mut begun = [0; PIPE_BYTES];
                client.read_exact(&mut begun).await.unwrap();
                assert!(places.take(peer(2)).is_none(), "its answer is not sent");
                let head_bytes = begun.windows(4).position(|end| end == b"\r\n\r\n").unwrap() + 4;
                let mut rest = vec![0; head_bytes + BODY_BYTES - PIPE_BYTES];
                client.read_exact(&mut rest).await.unwrap();
            }
            assert!(places.take(peer(2)).is_some(), "it is idle");
            connection.abort();
        });
    }
}

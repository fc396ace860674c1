//! The threads of the listeners: started, and ended.

use std::{
    net::SocketAddr,
    sync::Arc,
    thread::JoinHandle,
    time::{Duration, Instant},
};

use anyhow::Context;
use axum::body::Bytes;
use jiff::Timestamp;
use mocapd_acquire::threads::{self, Stopper};
use tokio::{
    runtime::{Builder, Runtime},
    sync::{Semaphore, watch},
};

use super::{
    auth::Auth,
    connection::Doorway,
    counts::Counts,
    happenings::Happenings,
    lanes::{self, Lanes},
    listen,
    options::HttpOptions,
    places::Places,
    routes,
    show::Show,
    state::App,
};
use crate::control::{Control, EventFeed};

/// Places of the Unix socket beyond `connections_max`: as many as requests can be carried out at once. Half of
/// `connections_max` can be streams, so that at the worst as many hold connections that make room: whoever may open the
/// socket always gets in.
pub(super) const UNIX_MORE: usize = lanes::REQUESTS_MAX;

/// The HTTP API while it runs.
#[derive(Debug)]
pub struct HttpServer {
    stop: watch::Sender<bool>,
    within: watch::Sender<Duration>,
    threads: Vec<JoinHandle<()>>,
    hubs: Hubs,
    tcp: Option<SocketAddr>,
}

impl HttpServer {
    /// Listens, and answers from threads of its own.
    ///
    /// # Errors
    /// Options that are of no use or let everybody in; a socket or an address that cannot be had.
    pub fn start(options: HttpOptions, control: Arc<dyn Control>) -> anyhow::Result<Self> {
        options.check()?;
        let HttpOptions { unix_socket, tcp, token, allowed_hosts, connections_max, limits } =
            options;
        let unix = unix_socket.map(|path| Listening::new(|| listen::unix(&path))).transpose()?;
        let tcp = tcp.map(|address| Listening::new(|| listen::tcp(address))).transpose()?;
        let tcp_address = tcp.as_ref().map(|tcp| tcp.listener.local_addr()).transpose()?;

        let (stop, stopping) = watch::channel(false);
        let (within, how_long) = watch::channel(Duration::ZERO);
        let counts = Arc::new(Counts::default());
        let run = format!("{:x}", Timestamp::now().as_millisecond());
        let feed = control.events();
        let happenings = Arc::new(Happenings::new(run, Arc::clone(&counts)));
        let show = Arc::new(Show::new(Arc::clone(&counts)));
        let auth = Arc::new(Auth::new(token.as_deref()));
        let document: Bytes = routes::openapi()?.into();
        let hubs = Hubs::start(&control, &happenings, &show, feed)?;
        let serving = move |places: usize| {
            let app = Arc::new(App {
                control: Arc::clone(&control),
                lanes: Lanes::new(limits.work),
                auth: Arc::clone(&auth),
                counts: Arc::clone(&counts),
                happenings: Arc::clone(&happenings),
                show: Arc::clone(&show),
                document: document.clone(),
                limits,
                allowed_hosts: allowed_hosts.clone(),
                streams: Arc::new(Semaphore::new(connections_max.div_ceil(2))),
                stopping: stopping.clone(),
            });
            // Nothing is ever sent: that the other ends are gone is the message.
            let (gone, alive) = watch::channel(());
            let doorway = Doorway {
                router: routes::router(&app),
                limits,
                counts: Arc::clone(&counts),
                places: Places::new(places),
                lingering: Doorway::lingering(),
                stopping: stopping.clone(),
                alive,
            };
            Serving { doorway, gone, how_long: how_long.clone() }
        };
        let mut server =
            Self { stop, within, threads: Vec::with_capacity(2), hubs, tcp: tcp_address };
        if let Some(Listening { runtime, listener }) = unix {
            let serving = serving(connections_max + UNIX_MORE);
            let run = move || {
                let (listener, file) = listener.into_parts();
                serving.run(runtime, |doorway| doorway.serve_unix(listener), file);
            };
            server.threads.push(threads::spawn("mocapd-socket", run)?);
        }
        if let Some(Listening { runtime, listener }) = tcp {
            let serving = serving(connections_max);
            let run = move || serving.run(runtime, |doorway| doorway.serve_tcp(listener), ());
            server.threads.push(threads::spawn("mocapd-tcp", run)?);
        }
        Ok(server)
    }

    /// The TCP address that it listens on; the port is the one that was given for 0.
    #[must_use]
    pub fn tcp_address(&self) -> Option<SocketAddr> {
        self.tcp
    }

    /// Lets nobody in any more, lets requests that are being carried out finish, ends streams, and returns after
    /// `within` at most.
    ///
    /// # Errors
    /// When one of its threads panicked.
    pub fn stop(mut self, within: Duration) -> anyhow::Result<()> {
        self.end(within)
    }

    fn end(&mut self, within: Duration) -> anyhow::Result<()> {
        self.within.send_replace(within);
        self.stop.send_replace(true);
        // One that panicked has ended already, which `join` reports.
        let joined = self.threads.drain(..).map(threads::join).fold(Ok(()), Result::and);
        self.hubs.stop().and(joined)
    }
}

impl Drop for HttpServer {
    fn drop(&mut self) {
        // Whoever wants to hear of a panic calls `stop`.
        self.end(Duration::ZERO).ok();
    }
}

/// The threads that listen to the service for everybody.
#[derive(Debug)]
struct Hubs {
    stopper: Option<Stopper>,
    threads: Vec<JoinHandle<()>>,
}

impl Hubs {
    fn start(
        control: &Arc<dyn Control>,
        happenings: &Arc<Happenings>,
        show: &Arc<Show>,
        feed: EventFeed,
    ) -> anyhow::Result<Self> {
        let (stopper, stopped) = threads::stop();
        let mut hubs = Self { stopper: Some(stopper), threads: Vec::with_capacity(2) };
        let (happenings, is_stopped) = (Arc::clone(happenings), stopped.clone());
        let listen = move || happenings.listen(&feed, &is_stopped);
        hubs.threads.push(threads::spawn("mocapd-events", listen)?);
        let (show, control) = (Arc::clone(show), Arc::clone(control));
        let run = move || show.run(control.as_ref(), &stopped);
        hubs.threads.push(threads::spawn("mocapd-live", run)?);
        Ok(hubs)
    }

    fn stop(&mut self) -> anyhow::Result<()> {
        drop(self.stopper.take());
        self.threads.drain(..).map(threads::join).fold(Ok(()), Result::and)
    }
}

impl Drop for Hubs {
    fn drop(&mut self) {
        // Whoever wants to hear of a panic calls `stop`.
        self.stop().ok();
    }
}

/// A listener, and the runtime that it belongs to.
struct Listening<L> {
    runtime: Runtime,
    listener: L,
}

impl<L> Listening<L> {
    fn new(listen: impl FnOnce() -> anyhow::Result<L>) -> anyhow::Result<Self> {
        let runtime = Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .max_blocking_threads(lanes::THREADS)
            .thread_name("mocapd-http-job")
            .build()
            .context("cannot start the runtime of the HTTP API")?;
        let inside = runtime.enter();
        let listener = listen()?;
        drop(inside);
        Ok(Self { runtime, listener })
    }
}

/// What the thread of a listener works with.
struct Serving {
    doorway: Doorway,
    gone: watch::Sender<()>,
    how_long: watch::Receiver<Duration>,
}

impl Serving {
    /// Accepts until the server stops, drops `file`, and waits for connections as long as it may.
    fn run<F: Future<Output = ()> + Send + 'static>(
        self,
        runtime: Runtime,
        accept: impl FnOnce(Doorway) -> F,
        file: impl Sized,
    ) {
        let Self { doorway, gone, how_long } = self;
        let deadline = runtime.block_on(async move {
            let mut stopping = doorway.stopping.clone();
            tokio::spawn(accept(doorway));
            // Its sender lives as long as the server: an error is the end as well.
            stopping.wait_for(|&stopping| stopping).await.ok();
            drop(file);
            let within = *how_long.borrow();
            let deadline = Instant::now() + within;
            tokio::time::timeout(within, gone.closed()).await.ok();
            deadline
        });
        // Jobs that the service does not finish in time are left to themselves.
        runtime.shutdown_timeout(deadline.saturating_duration_since(Instant::now()));
    }
}

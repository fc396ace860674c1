//! The thread that all of it runs on: started, and ended.

use std::{
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use anyhow::Context;
use jiff::Timestamp;
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
    listen::{self, UnixDoor},
    options::HttpOptions,
    routes,
    show::Show,
    state::{App, Shared},
};
use crate::{
    service::control::{Control, EventFeed},
    threads,
};

/// The HTTP API while it runs.
#[derive(Debug)]
pub struct HttpServer {
    stop: watch::Sender<bool>,
    within: std::sync::mpsc::SyncSender<Duration>,
    thread: Option<JoinHandle<()>>,
    hubs: Hubs,
    tcp: Option<SocketAddr>,
    remarks: Vec<String>,
}

impl HttpServer {
    /// Listens, and answers from a thread of its own.
    ///
    /// # Errors
    /// Options that are of no use or let everybody in; a socket or an address that cannot be had.
    pub fn start(options: HttpOptions, control: Arc<dyn Control>) -> anyhow::Result<Self> {
        options.check()?;
        let remarks = options.remarks();
        let HttpOptions { unix_socket, tcp, token, allowed_hosts, connections_max, limits } =
            options;
        let runtime = Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .max_blocking_threads(lanes::THREADS)
            .thread_name("mocapd-http-job")
            .build()
            .context("cannot start the runtime of the HTTP API")?;
        let inside = runtime.enter();
        let unix = unix_socket.as_deref().map(listen::unix).transpose()?;
        let tcp = tcp.map(listen::tcp).transpose()?;
        let tcp_address = tcp.as_ref().map(tokio::net::TcpListener::local_addr).transpose()?;
        drop(inside);

        let (stop, stopping) = watch::channel(false);
        let counts = Arc::new(Counts::default());
        let run = format!("{:x}", Timestamp::now().as_millisecond());
        let feed = control.events();
        let app = Arc::new(App {
            control,
            lanes: Lanes::new(limits.work),
            auth: Auth::new(token.as_deref()),
            counts: Arc::clone(&counts),
            happenings: Happenings::new(run, Arc::clone(&counts)),
            show: Show::new(Arc::clone(&counts)),
            document: routes::openapi()?.into(),
            limits,
            allowed_hosts,
            streams: Arc::new(Semaphore::new(connections_max.div_ceil(2))),
            stopping: stopping.clone(),
        });
        let router = routes::router(&app);
        let hubs = Hubs::start(&app, feed)?;
        // Nothing is ever sent: that the other ends are gone is the message.
        let (gone, alive) = watch::channel(());
        let doorway = Doorway {
            router,
            limits,
            counts,
            places: Arc::new(Semaphore::new(connections_max)),
            told: Doorway::told(),
            stopping,
            alive,
        };
        let (within, how_long) = std::sync::mpsc::sync_channel(1);
        let run = move || serve(runtime, doorway, unix, tcp, gone, &how_long);
        let thread = Some(threads::spawn("mocapd-http", run)?);
        Ok(Self { stop, within, thread, hubs, tcp: tcp_address, remarks })
    }

    /// The TCP address that it listens on; the port is the one that was given for 0.
    #[must_use]
    pub fn tcp_address(&self) -> Option<SocketAddr> {
        self.tcp
    }

    /// What whoever started it should hear.
    #[must_use]
    pub fn remarks(&self) -> &[String] {
        &self.remarks
    }

    /// Lets nobody in any more, lets requests that are being carried out finish, ends streams, and returns after
    /// `within` at most.
    ///
    /// # Errors
    /// When its thread panicked.
    pub fn stop(mut self, within: Duration) -> anyhow::Result<()> {
        self.end(within)
    }

    fn end(&mut self, within: Duration) -> anyhow::Result<()> {
        let Some(thread) = self.thread.take() else { return Ok(()) };
        // It has ended already where it panicked, which `join` tells.
        self.within.try_send(within).ok();
        self.stop.send_replace(true);
        let joined = threads::join(thread);
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
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Hubs {
    fn start(app: &Shared, feed: EventFeed) -> anyhow::Result<Self> {
        let mut hubs = Self { stop: Arc::default(), threads: Vec::with_capacity(2) };
        let (shared, stop) = (Arc::clone(app), Arc::clone(&hubs.stop));
        let listen = move || shared.happenings.listen(&feed, &stop);
        hubs.threads.push(threads::spawn("mocapd-events", listen)?);
        let (shared, stop) = (Arc::clone(app), Arc::clone(&hubs.stop));
        let show = move || shared.show.run(shared.control.as_ref(), &stop);
        hubs.threads.push(threads::spawn("mocapd-live", show)?);
        Ok(hubs)
    }

    fn stop(&mut self) -> anyhow::Result<()> {
        self.stop.store(true, Ordering::Relaxed);
        self.threads.drain(..).map(threads::join).fold(Ok(()), Result::and)
    }
}

impl Drop for Hubs {
    fn drop(&mut self) {
        // Whoever wants to hear of a panic calls `stop`.
        self.stop().ok();
    }
}

fn serve(
    runtime: Runtime,
    doorway: Doorway,
    unix: Option<UnixDoor>,
    tcp: Option<tokio::net::TcpListener>,
    gone: watch::Sender<()>,
    how_long: &std::sync::mpsc::Receiver<Duration>,
) {
    let deadline = runtime.block_on(async move {
        let mut stopping = doorway.stopping.clone();
        let (unix, file) = unix.map(UnixDoor::into_parts).unzip();
        if let Some(listener) = unix {
            tokio::spawn(doorway.clone().serve_unix(listener));
        }
        if let Some(listener) = tcp {
            tokio::spawn(doorway.clone().serve_tcp(listener));
        }
        drop(doorway);
        // Its sender lives as long as the server: an error is the end as well.
        stopping.wait_for(|&stopping| stopping).await.ok();
        drop(file);
        let within = how_long.try_recv().unwrap_or_default();
        let deadline = Instant::now() + within;
        tokio::time::timeout(within, gone.closed()).await.ok();
        deadline
    });
    // Jobs that the service does not finish in time are left to themselves.
    runtime.shutdown_timeout(deadline.saturating_duration_since(Instant::now()));
}

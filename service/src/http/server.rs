//! Starts and stops the listeners' threads.

use std::{
    fs,
    io::ErrorKind,
    net::SocketAddr,
    os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt},
    path::{Path, PathBuf},
    sync::Arc,
    thread::JoinHandle,
    time::{Duration, Instant},
};

use anyhow::{Context, bail};
use axum::body::Bytes;
use jiff::Timestamp;
use mocapd_acquire::threads::{self, StopSender};
use tokio::{
    net::{TcpListener, TcpSocket, UnixListener, UnixSocket},
    runtime::{Builder, Runtime},
    sync::{Semaphore, watch},
};

use super::{
    App, Counts, HttpOptions, UNIX_EXTRA,
    auth::Auth,
    broadcast::{EventBroadcast, LiveBroadcast},
    connection::{Acceptor, ConnectionSlots},
    routes,
    work_queues::{self, WorkQueues},
};
use crate::control::Control;

/// The running HTTP server.
#[derive(Debug)]
pub struct HttpServer {
    stop: watch::Sender<bool>,
    within: watch::Sender<Duration>,
    /// The listeners' threads.
    threads: Vec<JoinHandle<()>>,
    broadcast_stopper: Option<StopSender>,
    /// The threads that forward events and live frames.
    broadcast_threads: Vec<JoinHandle<()>>,
    tcp: Option<SocketAddr>,
    allowed_hosts: watch::Sender<Vec<String>>,
}

impl HttpServer {
    /// Listens, and serves from its own threads.
    ///
    /// # Errors
    /// The options are useless or would let everybody in, or a socket or address is unavailable.
    pub fn start(options: HttpOptions, control: Arc<dyn Control>) -> anyhow::Result<Self> {
        options.check()?;
        let is_viewer = options.is_viewer;
        let HttpOptions { unix_socket, tcp, token, allowed_hosts, connections_max, limits, .. } =
            options;
        let unix = Listening::at(unix_socket, is_viewer, |path| listen_unix(&path))?;
        let tcp = Listening::at(tcp, is_viewer, listen_tcp)?;
        let tcp_address = tcp.as_ref().map(|tcp| tcp.listener.local_addr()).transpose()?;

        let (stop, stopping) = watch::channel(false);
        let (within, how_long) = watch::channel(Duration::ZERO);
        let (allow_hosts, allowed_hosts) = watch::channel(allowed_hosts);
        let counts = Arc::new(Counts::default());
        let run = format!("{:x}", Timestamp::now().as_millisecond());
        let feed = control.events();
        let events = Arc::new(EventBroadcast::new(run, Arc::clone(&counts)));
        let live = Arc::new(LiveBroadcast::new(Arc::clone(&counts)));
        let auth = Arc::new(Auth::new(token.as_deref()));
        let document: Bytes = routes::openapi()?.into();
        let (broadcast_stopper, stopped) = threads::stop_channel();
        let mut server = Self {
            stop,
            within,
            threads: Vec::with_capacity(2),
            broadcast_stopper: Some(broadcast_stopper),
            broadcast_threads: Vec::with_capacity(2),
            tcp: tcp_address,
            allowed_hosts: allow_hosts,
        };
        let (hub, is_stopped) = (Arc::clone(&events), stopped.clone());
        let listen = move || hub.forward(&feed, &is_stopped);
        server.broadcast_threads.push(threads::spawn("mocapd-events", listen)?);
        let (hub, shown) = (Arc::clone(&live), Arc::clone(&control));
        let run = move || hub.run(shown.as_ref(), &stopped);
        server.broadcast_threads.push(threads::spawn("mocapd-live", run)?);
        let serving = move |slots: usize, runtimes: Runtimes| {
            let app = Arc::new(App {
                control: Arc::clone(&control),
                queues: WorkQueues::new(limits.work, runtimes.computing.handle()),
                maps: Arc::default(),
                auth: Arc::clone(&auth),
                counts: Arc::clone(&counts),
                events: Arc::clone(&events),
                live: Arc::clone(&live),
                document: document.clone(),
                limits,
                is_viewer,
                allowed_hosts: allowed_hosts.clone(),
                streams: Arc::new(Semaphore::new(connections_max.div_ceil(2))),
                stopping: stopping.clone(),
            });
            // Nothing is ever sent: the channel closes with the last connection.
            let (connections, alive) = watch::channel(());
            let acceptor = Acceptor {
                router: routes::router(&app),
                limits,
                counts: Arc::clone(&counts),
                slots: ConnectionSlots::new(slots),
                lingering: Acceptor::lingering(),
                stopping: stopping.clone(),
                alive,
            };
            Serving { acceptor, connections, how_long: how_long.clone(), runtimes }
        };
        if let Some(Listening { runtimes, listener }) = unix {
            let serving = serving(connections_max + UNIX_EXTRA, runtimes);
            let run = move || {
                let BoundSocket { listener, file } = listener;
                serving.run(|acceptor| acceptor.serve_unix(listener), file);
            };
            server.threads.push(threads::spawn("mocapd-socket", run)?);
        }
        if let Some(Listening { runtimes, listener }) = tcp {
            let serving = serving(connections_max, runtimes);
            let run = move || serving.run(|acceptor| acceptor.serve_tcp(listener), ());
            server.threads.push(threads::spawn("mocapd-tcp", run)?);
        }
        Ok(server)
    }

    /// The TCP address, with the actual port if 0 was configured.
    #[must_use]
    pub fn tcp_address(&self) -> Option<SocketAddr> {
        self.tcp
    }

    /// Replaces the host names of the service besides `localhost` and its addresses, from the next request on.
    pub fn allow_hosts(&self, names: Vec<String>) {
        self.allowed_hosts.send_replace(names);
    }

    /// Accepts no more connections, ends streams, and lets running requests finish, for at most `within`.
    ///
    /// # Errors
    /// One of its threads panicked.
    pub fn stop(mut self, within: Duration) -> anyhow::Result<()> {
        self.end(within)
    }

    fn end(&mut self, within: Duration) -> anyhow::Result<()> {
        self.within.send_replace(within);
        self.stop.send_replace(true);
        // A thread that panicked has ended already; `join` reports it.
        let joined = self.threads.drain(..).map(threads::join).fold(Ok(()), Result::and);
        drop(self.broadcast_stopper.take());
        self.broadcast_threads.drain(..).map(threads::join).fold(joined, Result::and)
    }
}

impl Drop for HttpServer {
    fn drop(&mut self) {
        // A panic is reported only by `stop`.
        self.end(Duration::ZERO).ok();
    }
}

/// The runtimes of a listener.
struct Runtimes {
    /// Serves the connections, and has the threads of commands and files.
    serving: Runtime,
    /// Has the threads of work that computes.
    computing: Runtime,
}

/// A listener with its runtimes.
struct Listening<L> {
    runtimes: Runtimes,
    listener: L,
}

impl<L> Listening<L> {
    /// Listens at a place, if there is one. `mocapd view` records nothing that its work could delay.
    fn at<P>(
        place: Option<P>,
        is_viewer: bool,
        listen: impl FnOnce(P) -> anyhow::Result<L>,
    ) -> anyhow::Result<Option<Self>> {
        let Some(place) = place else { return Ok(None) };
        let computing = work_queues::computing_threads(!is_viewer)
            .context("cannot start the threads of the HTTP API")?;
        let runtime = Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .max_blocking_threads(work_queues::THREADS)
            .thread_name("mocapd-http-job")
            .build()
            .context("cannot start the runtime of the HTTP API")?;
        let inside = runtime.enter();
        let listener = listen(place)?;
        drop(inside);
        Ok(Some(Self { runtimes: Runtimes { serving: runtime, computing }, listener }))
    }
}

/// The state of a listener's thread.
struct Serving {
    acceptor: Acceptor,
    connections: watch::Sender<()>,
    how_long: watch::Receiver<Duration>,
    runtimes: Runtimes,
}

impl Serving {
    /// Accepts connections until the server stops, drops `file`, and waits for open connections up to the time limit.
    fn run<F: Future<Output = ()> + Send + 'static>(
        self,
        accept: impl FnOnce(Acceptor) -> F,
        file: impl Sized,
    ) {
        let Self { acceptor, connections, how_long, runtimes } = self;
        let deadline = runtimes.serving.block_on(async move {
            let mut stopping = acceptor.stopping.clone();
            tokio::spawn(accept(acceptor));
            // The sender lives as long as the server: an error also means the end.
            stopping.wait_for(|&stopping| stopping).await.ok();
            drop(file);
            let within = *how_long.borrow();
            let deadline = Instant::now() + within;
            tokio::time::timeout(within, connections.closed()).await.ok();
            deadline
        });
        // Work that is not finished in time is abandoned.
        for runtime in [runtimes.serving, runtimes.computing] {
            runtime.shutdown_timeout(deadline.saturating_duration_since(Instant::now()));
        }
    }
}

/// Connections that the kernel queues until they are accepted, which happens immediately.
const BACKLOG: u32 = 128;

/// The socket's mode: its owner and group may open it, and then do everything.
const SOCKET_MODE: u32 = 0o660;

/// A listening Unix socket, and its file.
#[derive(Debug)]
struct BoundSocket {
    listener: UnixListener,
    file: SocketFile,
}

/// The file of a socket; removed when dropped.
#[derive(Debug)]
struct SocketFile {
    path: PathBuf,
    inode: u64,
}

/// Listens on `path`. Replaces a socket left behind by a killed service, but not one that responds.
fn listen_unix(path: &Path) -> anyhow::Result<BoundSocket> {
    remove_stale_socket(path)?;
    let context = || format!("cannot listen on {}", path.display());
    let socket = UnixSocket::new_stream().with_context(context)?;
    socket.bind(path).with_context(context)?;
    // No client can connect before it listens, so the mode applies to all connections.
    fs::set_permissions(path, fs::Permissions::from_mode(SOCKET_MODE)).with_context(context)?;
    let inode = fs::symlink_metadata(path).with_context(context)?.ino();
    let file = SocketFile { path: path.to_owned(), inode };
    let listener = socket.listen(BACKLOG).with_context(context)?;
    Ok(BoundSocket { listener, file })
}

fn remove_stale_socket(path: &Path) -> anyhow::Result<()> {
    let found = match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        found => found.with_context(|| format!("cannot read {}", path.display()))?,
    };
    if !found.file_type().is_socket() {
        bail!("{} exists and is not a socket: choose another path, or move it", path.display());
    }
    match std::os::unix::net::UnixStream::connect(path) {
        Ok(_) => bail!("another service is running on {}: stop it first", path.display()),
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => fs::remove_file(path)
            .with_context(|| format!("cannot remove the unused socket {}", path.display())),
        // Its queue is full, or we may not connect: a service may be running.
        Err(error) => Err(error).with_context(|| {
            format!("cannot determine whether a service is running on {}", path.display())
        }),
    }
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        // It may have been replaced by another service's socket.
        if fs::symlink_metadata(&self.path).is_ok_and(|found| found.ino() == self.inode) {
            // If it cannot be removed, the next start removes it.
            fs::remove_file(&self.path).ok();
        }
    }
}

/// Listens on a TCP address.
fn listen_tcp(address: SocketAddr) -> anyhow::Result<TcpListener> {
    let context =
        || format!("cannot listen on {address}: choose another port, or stop what uses it");
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() };
    let socket = socket.with_context(context)?;
    // A port can be reused immediately after it was closed.
    socket.set_reuseaddr(true).with_context(context)?;
    socket.bind(address).with_context(context)?;
    socket.listen(BACKLOG).with_context(context)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_stale_socket_is_replaced() {
        let runtime = Builder::new_current_thread().enable_io().build().unwrap();
        let _inside = runtime.enter();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.sock");
        // Left behind: closed without removing its file.
        drop(std::os::unix::net::UnixListener::bind(&path).unwrap());
        let door = listen_unix(&path).unwrap();
        let mode = fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o660);
        let second = listen_unix(&path).unwrap_err().to_string();
        assert!(second.contains(path.to_str().unwrap()), "{second}");
        drop(door);
        assert!(!path.exists(), "the file goes with the listener");
        fs::write(&path, "mine").unwrap();
        let no_socket = listen_unix(&path).unwrap_err().to_string();
        assert!(no_socket.contains(path.to_str().unwrap()) && no_socket != second, "{no_socket}");
        assert_eq!(fs::read(&path).unwrap(), b"mine");
        assert!(listen_unix(&folder.path().join("no/s.sock")).is_err());
    }

    #[test]
    fn the_file_of_another_service_stays() {
        let runtime = Builder::new_current_thread().enable_io().build().unwrap();
        let _inside = runtime.enter();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.sock");
        let door = listen_unix(&path).unwrap();
        fs::rename(&path, folder.path().join("kept.sock")).unwrap();
        let other = listen_unix(&path).unwrap();
        drop(door);
        assert!(path.exists());
        drop(other);
        assert!(!path.exists());
    }
}

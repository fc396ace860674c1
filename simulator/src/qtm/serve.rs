//! A simulated QTM on the network: one thread that sleeps until the next frame, client or byte.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::num::NonZeroU64;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use mocapd_drivers::qtm::{ClientId, QtmServer};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::QtmDevice;
use crate::device::{FrameFate, SentLog};
use crate::line::host_ns;

/// The longest sleep, which bounds the reaction time to a stop.
const SLEEP_MAX: Duration = Duration::from_millis(20);

/// Size of one read: many times the longest command.
const READ_BYTES: usize = 4096;

/// How long clients have to take what is pending when the server ends.
const DRAIN_NS: u64 = 1_000_000_000;

/// Why serving failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// The port cannot be opened.
    #[error("cannot listen on TCP port {port} of this machine ({}): end the program that uses it, or give another port", source.kind())]
    Listen {
        /// The port.
        port: u16,
        /// The system's error.
        source: io::Error,
    },
    /// A call to the system failed.
    #[error("{action} failed")]
    Network {
        /// The operation.
        action: &'static str,
        /// The system's error.
        source: io::Error,
    },
    /// The log of sent frames could not be written.
    #[error("cannot write the log of sent frames")]
    Log(#[source] io::Error),
}

/// How to serve.
#[derive(Default)]
pub struct NetworkOptions {
    /// Return when the file has ended and the clients have all of it.
    pub once: bool,
    /// Destination of the log: the fate of every frame, one CSV row each.
    pub log: Option<Box<dyn Write + Send>>,
}

impl std::fmt::Debug for NetworkOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let log = self.log.is_some();
        f.debug_struct("NetworkOptions").field("once", &self.once).field("log", &log).finish()
    }
}

/// A port of this machine, on the loopback interface: a simulator is for this machine's programs.
#[derive(Debug)]
pub struct QtmListener {
    listener: Option<TcpListener>,
    address: SocketAddr,
    datagrams: UdpSocket,
}

impl QtmListener {
    /// Opens a port; 0 for any free one.
    ///
    /// # Errors
    /// When another program uses the port, or the system refuses it.
    pub fn open(port: u16) -> Result<Self, ServeError> {
        let failed = |source| ServeError::Listen { port, source };
        let listener = listen(SocketAddr::from((Ipv4Addr::LOCALHOST, port))).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let datagrams = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))
            .and_then(|socket| socket.set_nonblocking(true).map(|()| socket))
            .map_err(|source| ServeError::Network { action: "opening a UDP socket", source })?;
        Ok(Self { listener: Some(listener), address, datagrams })
    }

    /// Where clients connect.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The URI that a recorder opens.
    #[must_use]
    pub fn uri(&self) -> String {
        format!("qtm:{}", self.address)
    }

    /// Serves a device until `stop` is set.
    ///
    /// # Errors
    /// When the system fails to wait for the clients, or the log fails.
    pub fn serve(
        mut self,
        device: &mut QtmDevice,
        options: NetworkOptions,
        stop: &AtomicBool,
    ) -> Result<SentLog, ServeError> {
        // As for a line: a sleep must not be 50 us late. If the kernel refuses, it stays.
        rustix::thread::set_current_timer_slack(NonZeroU64::new(1)).ok();
        let mut log = options.log;
        if let Some(log) = &mut log {
            device.keep_frame_log();
            writeln!(log, "{}", FrameFate::CSV_HEADER).map_err(ServeError::Log)?;
        }
        let mut connections: Vec<Connection> = Vec::new();
        while !stop.load(Ordering::Relaxed) {
            let wake_ns = device.poll(host_ns());
            self.follow_cable(device, &mut connections)?;
            self.exchange(device, &mut connections);
            write_fates(device, log.as_mut())?;
            let is_sent = connections.iter().all(|c| device.pending(c.id).is_empty());
            if options.once && device.has_ended() && is_sent {
                break;
            }
            self.wait(device, &mut connections, wake_ns)?;
        }
        self.finish(device, connections);
        device.close();
        write_fates(device, log.as_mut())?;
        if let Some(log) = &mut log {
            log.flush().map_err(ServeError::Log)?;
        }
        Ok(device.log())
    }

    /// Closes the port while the device cannot be reached, and opens it again.
    fn follow_cable(
        &mut self,
        device: &QtmDevice,
        connections: &mut Vec<Connection>,
    ) -> Result<(), ServeError> {
        if !device.is_reachable() {
            connections.drain(..).for_each(Connection::close);
            self.listener = None;
        } else if self.listener.is_none() {
            let port = self.address.port();
            let failed = |source| ServeError::Listen { port, source };
            self.listener = Some(listen(self.address).map_err(failed)?);
        }
        Ok(())
    }

    /// Accepts clients, and moves bytes and datagrams.
    fn exchange(&self, device: &mut QtmDevice, connections: &mut Vec<Connection>) {
        loop {
            let (mut stream, peer) = match self.listener.as_ref().map(TcpListener::accept) {
                Some(Ok(accepted)) => accepted,
                Some(Err(error)) if error.kind() != ErrorKind::WouldBlock => {
                    // A client that is gone already, or no file descriptor left: not at once again.
                    std::thread::sleep(SLEEP_MAX);
                    break;
                }
                _ => break,
            };
            if stream.set_nonblocking(true).is_err() || stream.set_nodelay(true).is_err() {
                continue;
            }
            match device.connect(peer) {
                Some(id) => connections.push(Connection { id, stream, is_over: false }),
                None => {
                    if stream.write_all(&QtmServer::refusal()).is_err() {
                        // The client learns it from the closed connection.
                    }
                }
            }
        }
        // A datagram that the system does not take is lost, as on any network.
        device.send_datagrams(|datagram| {
            self.datagrams.send_to(&datagram.bytes, datagram.to).is_ok()
        });
        connections.retain_mut(|connection| {
            connection.write(device);
            let is_over = connection.is_over
                || (device.is_out_of_step(connection.id)
                    && device.pending(connection.id).is_empty());
            if is_over {
                device.disconnect(connection.id);
            }
            !is_over
        });
    }

    /// Waits for what comes next, and reads what has come.
    fn wait(
        &self,
        device: &mut QtmDevice,
        connections: &mut [Connection],
        wake_ns: u64,
    ) -> Result<(), ServeError> {
        let sleep = Duration::from_nanos(wake_ns.saturating_sub(host_ns())).min(SLEEP_MAX);
        let timeout = Timespec { tv_sec: 0, tv_nsec: i64::from(sleep.subsec_nanos()) };
        let mut fds: Vec<PollFd<'_>> = Vec::with_capacity(connections.len() + 1);
        // A connection of which nothing is wanted is left out: that its client is gone would wake this thread at once.
        let mut waiting = Vec::with_capacity(connections.len());
        for (index, connection) in connections.iter().enumerate() {
            let mut flags = PollFlags::empty();
            flags.set(PollFlags::IN, device.may_receive(connection.id));
            flags.set(PollFlags::OUT, !device.pending(connection.id).is_empty());
            if !flags.is_empty() {
                fds.push(PollFd::new(&connection.stream, flags));
                waiting.push(index);
            }
        }
        fds.extend(self.listener.as_ref().map(|listener| PollFd::new(listener, PollFlags::IN)));
        match poll(&mut fds, Some(&timeout)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => {}
            Err(source) => {
                return Err(ServeError::Network {
                    action: "waiting for clients",
                    source: source.into(),
                });
            }
        }
        let ready: Vec<bool> = fds.iter().map(|fd| !fd.revents().is_empty()).collect();
        for (index, _) in waiting.into_iter().zip(ready).filter(|(_, ready)| *ready) {
            if let Some(connection) = connections.get_mut(index)
                && device.may_receive(connection.id)
            {
                connection.read(device);
            }
        }
        Ok(())
    }

    /// Lets clients take what is pending, and closes their connections.
    fn finish(&self, device: &mut QtmDevice, mut connections: Vec<Connection>) {
        let until_ns = host_ns() + DRAIN_NS;
        loop {
            self.exchange(device, &mut connections);
            let is_sent = connections.iter().all(|c| device.pending(c.id).is_empty());
            if is_sent || host_ns() > until_ns {
                break;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        connections.into_iter().for_each(Connection::close);
    }
}

/// A client's connection.
#[derive(Debug)]
struct Connection {
    id: ClientId,
    stream: TcpStream,
    is_over: bool,
}

impl Connection {
    fn write(&mut self, device: &mut QtmDevice) {
        loop {
            let pending = device.pending(self.id);
            if pending.is_empty() {
                return;
            }
            match self.stream.write(pending) {
                Ok(n) => device.sent(self.id, n),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => {
                    self.is_over = true;
                    return;
                }
            }
        }
    }

    fn read(&mut self, device: &mut QtmDevice) {
        let mut buffer = [0; READ_BYTES];
        match self.stream.read(&mut buffer) {
            Ok(0) => self.is_over = true,
            Ok(n) => device.on_bytes(self.id, buffer.get(..n).unwrap_or_default(), host_ns()),
            Err(error)
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
            Err(_) => self.is_over = true,
        }
    }

    /// Closes the connection; what was written still reaches the client.
    fn close(self) {
        if self.stream.shutdown(Shutdown::Write).is_err() {
            // The client has closed it already.
        }
    }
}

/// Opens a port. The standard library lets a port be opened again whose connections have just been closed.
fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

fn write_fates(
    device: &mut QtmDevice,
    log: Option<&mut Box<dyn Write + Send>>,
) -> Result<(), ServeError> {
    let Some(log) = log else { return Ok(()) };
    for fate in device.take_fates() {
        writeln!(log, "{}", fate.to_csv()).map_err(ServeError::Log)?;
    }
    Ok(())
}

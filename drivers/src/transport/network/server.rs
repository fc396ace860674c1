//! The server's end of connections: accepts clients, and moves bytes between their sockets and a [`StreamServer`].
//!
//! Nothing here waits for a client: every socket is non-blocking, and the thread sleeps in [`TcpServer::wait`] alone.

use std::{
    io::{self, ErrorKind, Read, Write},
    net::{Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket},
    os::fd::AsRawFd,
    time::{Duration, Instant},
};

use nix::sys::socket::{
    setsockopt,
    sockopt::{KeepAlive, SndBuf, TcpKeepIdle, TcpKeepInterval},
};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

/// Size of one read: many times the longest command.
const READ_BYTES: usize = 4096;

/// Bytes that the kernel may hold for a client, beyond which they wait in the server, which can drop the oldest. Some 50 ms
/// of 200 markers at 1000 Hz; the kernel itself would take up to 4 MiB, and frames would be seconds old.
const SEND_BUFFER_BYTES: usize = 128 << 10;

/// A client to which nothing is sent is asked for a sign of life after this time: a machine that was switched off must not
/// occupy a place for ever. After nine questions without a sign it is given up: two minutes. Where data waits for it, the
/// system repeats that instead, for a quarter to half an hour; its limit on this also ends clients that live and do not read.
const KEEP_ALIVE_AFTER_S: u32 = 30;
const KEEP_ALIVE_EVERY_S: u32 = 10;

/// Time until a server accepts again after the system refused, mostly for want of file descriptors.
const ACCEPT_PAUSE: Duration = Duration::from_secs(1);

/// Clients that are accepted before the others are served again.
const ACCEPTED_MAX: usize = 16;

/// What a server does with its clients and their bytes. Sans-io.
pub trait StreamServer {
    /// Identifies a client.
    type Id: Copy;

    /// Accepts a client that connected to the address `local`.
    ///
    /// # Errors
    /// The bytes that it gets before its connection is closed.
    fn connect_at(&mut self, peer: SocketAddr, _local: SocketAddr) -> Result<Self::Id, Vec<u8>> {
        self.connect(peer)
    }

    /// Accepts a client of a server with one port.
    ///
    /// # Errors
    /// The bytes that it gets before its connection is closed.
    fn connect(&mut self, peer: SocketAddr) -> Result<Self::Id, Vec<u8>>;

    /// A client has closed its connection, or is to be disconnected.
    fn disconnect(&mut self, id: Self::Id);

    /// Takes bytes of a client.
    fn receive(&mut self, id: Self::Id, bytes: &[u8]);

    /// Whether more bytes of a client may be read.
    fn may_receive(&self, id: Self::Id) -> bool;

    /// Whether a client is to be disconnected once it has what is pending.
    fn is_over(&self, id: Self::Id) -> bool;

    /// The bytes to send to a client next.
    fn pending(&self, id: Self::Id) -> &[u8];

    /// The connection took the first `n` pending bytes.
    fn sent(&mut self, id: Self::Id, n: usize);
}

/// Ports and the connections of their clients.
#[derive(Debug)]
pub struct TcpServer<Id> {
    address: SocketAddr,
    listeners: Vec<TcpListener>,
    /// When accepting goes on, after the system refused.
    accepts_at: Option<Instant>,
    connections: Vec<Connection<Id>>,
}

impl<Id: Copy> TcpServer<Id> {
    /// Opens a port; 0 for any free one.
    ///
    /// # Errors
    /// The system's.
    pub fn open(address: SocketAddr) -> io::Result<Self> {
        let listener = listen(address)?;
        let address = listener.local_addr()?;
        let listeners = vec![listener];
        Ok(Self { address, listeners, accepts_at: None, connections: Vec::new() })
    }

    /// Opens one more port, which stays open until all are closed.
    ///
    /// # Errors
    /// The system's.
    pub fn open_another(&mut self, address: SocketAddr) -> io::Result<SocketAddr> {
        let listener = listen(address)?;
        let address = listener.local_addr()?;
        self.listeners.push(listener);
        Ok(address)
    }

    /// Where clients connect: the first port.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Closes all ports and connections, as if the cable were pulled; the caller forgets the clients.
    pub fn unplug(&mut self) {
        self.connections.drain(..).for_each(Connection::close);
        self.listeners.clear();
    }

    /// Opens the first port again, if it is closed.
    ///
    /// # Errors
    /// The system's.
    pub fn plug(&mut self) -> io::Result<()> {
        if self.listeners.is_empty() {
            self.listeners.push(listen(self.address)?);
        }
        Ok(())
    }

    /// Accepts clients, sends what is pending, and disconnects clients that are over.
    pub fn exchange(&mut self, server: &mut impl StreamServer<Id = Id>) {
        self.accept(server);
        self.connections.retain_mut(|connection| {
            connection.write(server);
            let is_over = connection.is_over
                || (server.is_over(connection.id) && server.pending(connection.id).is_empty());
            if is_over {
                server.disconnect(connection.id);
                connection.shut_down();
            }
            !is_over
        });
    }

    fn accept(&mut self, server: &mut impl StreamServer<Id = Id>) {
        if self.accepts_at.is_some_and(|at| Instant::now() < at) {
            return;
        }
        self.accepts_at = None;
        for listener in &self.listeners {
            for _ in 0..ACCEPTED_MAX {
                let (stream, peer) = match listener.accept() {
                    Ok(accepted) => accepted,
                    Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                    Err(error) if is_of_client(&error) => continue,
                    Err(_) => {
                        self.accepts_at = Some(Instant::now() + ACCEPT_PAUSE);
                        return;
                    }
                };
                self.connections.extend(welcome(stream, peer, server));
            }
        }
    }

    /// Waits until a client connects, sends or takes something, at most for `timeout`, and reads what has come.
    ///
    /// # Errors
    /// The system's.
    pub fn wait(
        &mut self,
        server: &mut impl StreamServer<Id = Id>,
        timeout: Duration,
    ) -> io::Result<()> {
        self.wait_also(server, timeout, &[])
    }

    /// As [`wait`](Self::wait), or until one of these sockets has something to read.
    ///
    /// # Errors
    /// The system's.
    pub fn wait_also(
        &mut self,
        server: &mut impl StreamServer<Id = Id>,
        timeout: Duration,
        others: &[&UdpSocket],
    ) -> io::Result<()> {
        let timeout = Timespec::try_from(timeout).unwrap_or_default();
        let mut fds: Vec<PollFd<'_>> = Vec::with_capacity(self.connections.len() + 1);
        // A connection of which nothing is wanted is left out: that its client is gone would wake this thread at once.
        let mut polled = Vec::with_capacity(self.connections.len());
        for (index, connection) in self.connections.iter().enumerate() {
            let mut flags = PollFlags::empty();
            flags.set(PollFlags::IN, server.may_receive(connection.id));
            flags.set(PollFlags::OUT, !server.pending(connection.id).is_empty());
            if !flags.is_empty() {
                fds.push(PollFd::new(&connection.stream, flags));
                polled.push(index);
            }
        }
        let listeners = self.listeners.iter().filter(|_| self.accepts_at.is_none());
        fds.extend(listeners.map(|listener| PollFd::new(listener, PollFlags::IN)));
        fds.extend(others.iter().map(|socket| PollFd::new(*socket, PollFlags::IN)));
        match poll(&mut fds, Some(&timeout)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
        let ready: Vec<bool> = fds.iter().map(|fd| !fd.revents().is_empty()).collect();
        for (index, _) in polled.into_iter().zip(ready).filter(|(_, ready)| *ready) {
            if let Some(connection) = self.connections.get_mut(index)
                && server.may_receive(connection.id)
            {
                connection.read(server);
            }
        }
        Ok(())
    }

    /// Closes the ports, and all connections once their clients have what is pending, at most after `timeout`.
    pub fn finish(mut self, server: &mut impl StreamServer<Id = Id>, timeout: Duration) {
        self.listeners.clear();
        let until = Instant::now() + timeout;
        loop {
            self.exchange(server);
            let is_sent = self.connections.iter().all(|c| server.pending(c.id).is_empty());
            if is_sent || Instant::now() >= until {
                break;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        self.unplug();
    }
}

/// The connection of a client, if the server accepts it.
fn welcome<Id: Copy>(
    mut stream: TcpStream,
    peer: SocketAddr,
    server: &mut impl StreamServer<Id = Id>,
) -> Option<Connection<Id>> {
    stream.set_nonblocking(true).ok()?;
    stream.set_nodelay(true).ok()?;
    // Without these, a client is served all the same.
    let fd = stream.as_raw_fd();
    setsockopt(fd, SndBuf, &SEND_BUFFER_BYTES).ok();
    setsockopt(fd, KeepAlive, &true).ok();
    setsockopt(fd, TcpKeepIdle, &KEEP_ALIVE_AFTER_S).ok();
    setsockopt(fd, TcpKeepInterval, &KEEP_ALIVE_EVERY_S).ok();
    match server.connect_at(peer, stream.local_addr().ok()?) {
        Ok(id) => Some(Connection { id, stream, is_over: false }),
        Err(message) => {
            // A fresh connection has room for a message. If it is gone, nobody reads it.
            stream.write_all(&message).ok();
            None
        }
    }
}

/// A client's connection.
#[derive(Debug)]
struct Connection<Id> {
    id: Id,
    stream: TcpStream,
    is_over: bool,
}

impl<Id: Copy> Connection<Id> {
    fn write(&mut self, server: &mut impl StreamServer<Id = Id>) {
        loop {
            let pending = server.pending(self.id);
            if pending.is_empty() {
                return;
            }
            match self.stream.write(pending) {
                Ok(n) => server.sent(self.id, n),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => {
                    self.is_over = true;
                    return;
                }
            }
        }
    }

    fn read(&mut self, server: &mut impl StreamServer<Id = Id>) {
        let mut buffer = [0; READ_BYTES];
        match self.stream.read(&mut buffer) {
            Ok(0) => self.is_over = true,
            Ok(n) => server.receive(self.id, buffer.get(..n).unwrap_or_default()),
            Err(error)
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
            Err(_) => self.is_over = true,
        }
    }

    /// Ends the connection; what was written still reaches the client.
    fn shut_down(&self) {
        if self.stream.shutdown(Shutdown::Write).is_err() {
            // The client has closed it already.
        }
    }

    fn close(self) {
        self.shut_down();
    }
}

/// Whether accepting failed because this client is gone already.
fn is_of_client(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::ConnectionAborted | ErrorKind::Interrupted)
}

/// Opens a port. The standard library lets a port be opened again whose connections have just been closed.
fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

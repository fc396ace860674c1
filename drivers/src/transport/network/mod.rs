//! Devices on the network: a TCP connection for commands, and frames on it or in UDP datagrams; or datagrams for both.
//!
//! The transport knows no protocol. It connects with a time-out, says why it cannot, and hands bytes of the stream and
//! whole datagrams to the caller, one kind per read ([`Transport::arrival`]).

mod connect;
mod datagrams;
mod multicast;
pub mod responder;
mod search;
pub mod server;
mod udp;

use std::{
    io::{self, ErrorKind, Read, Write},
    net::TcpStream,
    time::{Duration, Instant},
};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use self::datagrams::DatagramSocket;
pub(in crate::transport) use self::multicast::shared_socket;
pub use self::{
    multicast::{Interface, interfaces, multicast_sender},
    search::search,
    udp::UdpTransport,
};
use super::{Arrival, READ_TIMEOUT, Transport, TransportError, WRITE_TIMEOUT};
use crate::uri::{NetworkAddress, is_datagram_family};

/// Opens the transport to a device on the network.
///
/// # Errors
/// `Unreachable` with a remedy; `Io`.
pub fn open(address: &NetworkAddress) -> Result<Box<dyn Transport>, TransportError> {
    if is_datagram_family(address.family) {
        return Ok(Box::new(UdpTransport::open(address)?));
    }
    Ok(Box::new(NetworkTransport::open(address)?))
}

/// How long after the other end closed the connection its last datagrams are read: they may still wait, or be on their way.
const LAST_DATAGRAMS: Duration = Duration::from_millis(500);

/// An open connection to a device on the network.
#[derive(Debug)]
pub struct NetworkTransport {
    device: String,
    stream: TcpStream,
    datagrams: Option<DatagramSocket>,
    arrival: Arrival,
    /// Whether the last read was from the stream: of two sources with bytes, the other one is next.
    was_stream: bool,
    /// When the other end closed the stream.
    closed_at: Option<Instant>,
}

/// How a connection ends that the other end closes.
const CLOSED: &str = "the other end closed it";

/// What a poll found.
#[derive(Debug, Clone, Copy)]
struct Readiness {
    stream: bool,
    datagrams: bool,
}

impl NetworkTransport {
    /// Connects to a device, and opens a socket for its datagrams if the address wants one.
    ///
    /// # Errors
    /// `Unreachable` with a remedy when the name does not resolve or no connection can be made; `Io`.
    pub fn open(address: &NetworkAddress) -> Result<Self, TransportError> {
        let device = address.host_and_port();
        let failed = |action| {
            let device = device.clone();
            move |source| TransportError::Io { device, action, source }
        };
        let stream = connect::connect(address)?;
        // A command of some ten bytes must not wait for more.
        stream.set_nodelay(true).map_err(failed("disabling Nagle's algorithm"))?;
        stream.set_nonblocking(true).map_err(failed("setting the socket to non-blocking mode"))?;
        let datagrams = if address.datagrams {
            let peer = stream.peer_addr().map_err(failed("looking up its address"))?;
            let local = stream.local_addr().map_err(failed("looking up the own address"))?;
            let socket = DatagramSocket::open(local, peer.ip());
            Some(socket.map_err(failed("opening a UDP socket"))?)
        } else {
            None
        };
        let arrival = Arrival::default();
        Ok(Self { device, stream, datagrams, arrival, was_stream: false, closed_at: None })
    }

    fn lost(&self, cause: &str) -> TransportError {
        TransportError::ConnectionLost { device: self.describe(), cause: cause.to_owned() }
    }

    fn session_error(&self, action: &'static str, source: io::Error) -> TransportError {
        match source.kind() {
            ErrorKind::ConnectionReset | ErrorKind::BrokenPipe | ErrorKind::ConnectionAborted => {
                self.lost("the other end reset it")
            }
            ErrorKind::TimedOut => self.lost("the other end does not answer any more"),
            ErrorKind::HostUnreachable | ErrorKind::NetworkUnreachable | ErrorKind::NetworkDown => {
                self.lost("the network is down")
            }
            _ => TransportError::Io { device: self.device.clone(), action, source },
        }
    }

    /// Waits up to [`READ_TIMEOUT`] until one of the sockets is ready, or for `writing` until the stream takes bytes.
    fn wait(&self, writing: bool) -> io::Result<Readiness> {
        let timeout = Timespec { tv_sec: 0, tv_nsec: i64::from(READ_TIMEOUT.subsec_nanos()) };
        let wanted = if writing { PollFlags::OUT } else { PollFlags::IN };
        let stream = PollFd::new(&self.stream, wanted);
        let ready = |fd: &PollFd<'_>| !fd.revents().is_empty();
        match self.datagrams.as_ref().filter(|_| !writing) {
            Some(socket) if self.closed_at.is_some() => {
                let mut fds = [PollFd::new(socket, PollFlags::IN)];
                poll(&mut fds, Some(&timeout))?;
                Ok(Readiness { stream: false, datagrams: ready(&fds[0]) })
            }
            Some(socket) => {
                let mut fds = [stream, PollFd::new(socket, PollFlags::IN)];
                poll(&mut fds, Some(&timeout))?;
                Ok(Readiness { stream: ready(&fds[0]), datagrams: ready(&fds[1]) })
            }
            None => {
                let mut fds = [stream];
                poll(&mut fds, Some(&timeout))?;
                Ok(Readiness { stream: ready(&fds[0]), datagrams: false })
            }
        }
    }

    fn read_stream(&mut self, buf: &mut [u8]) -> Result<usize, TransportError> {
        self.was_stream = true;
        match self.stream.read(buf) {
            Ok(0) if !buf.is_empty() && self.datagrams.is_some() => {
                self.closed_at = Some(Instant::now());
                Ok(0)
            }
            Ok(0) if !buf.is_empty() => Err(self.lost(CLOSED)),
            Ok(n) => {
                self.arrival = Arrival::default();
                Ok(n)
            }
            Err(error) if is_retry(&error) => Ok(0),
            Err(error) => Err(self.session_error("reading", error)),
        }
    }

    fn read_datagram(&mut self, buf: &mut [u8]) -> Result<usize, TransportError> {
        self.was_stream = false;
        let Some(socket) = &mut self.datagrams else { return Ok(0) };
        match socket.receive(buf) {
            Ok((n, host_ns)) => {
                self.arrival = Arrival { is_datagram: true, host_ns };
                Ok(n)
            }
            Err(error) if is_retry(&error) => Ok(0),
            Err(error) => Err(self.session_error("receiving datagrams", error)),
        }
    }
}

fn is_retry(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

impl Transport for NetworkTransport {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, TransportError> {
        if self.closed_at.is_some_and(|at| at.elapsed() > LAST_DATAGRAMS) {
            return Err(self.lost(CLOSED));
        }
        match self.wait(false) {
            Ok(Readiness { datagrams: true, stream }) if !stream || self.was_stream => {
                self.read_datagram(buf)
            }
            Ok(Readiness { stream: true, .. }) => self.read_stream(buf),
            Ok(_) => Ok(0),
            Err(error) if is_retry(&error) => Ok(0),
            Err(error) => Err(self.session_error("waiting for bytes", error)),
        }
    }

    fn write_all(&mut self, mut bytes: &[u8]) -> Result<(), TransportError> {
        let mut last_progress = Instant::now();
        while !bytes.is_empty() {
            match self.stream.write(bytes) {
                Ok(n) => {
                    bytes = bytes.get(n..).unwrap_or_default();
                    last_progress = Instant::now();
                }
                Err(error) if is_retry(&error) => {
                    if last_progress.elapsed() >= WRITE_TIMEOUT {
                        return Err(self.lost("the other end reads no commands"));
                    }
                    match self.wait(true) {
                        Ok(_) => {}
                        Err(error) if is_retry(&error) => {}
                        Err(error) => return Err(self.session_error("writing", error)),
                    }
                }
                Err(error) => return Err(self.session_error("writing", error)),
            }
        }
        Ok(())
    }

    fn arrival(&self) -> Arrival {
        self.arrival
    }

    fn datagram_port(&self) -> Option<u16> {
        self.datagrams.as_ref().map(DatagramSocket::port)
    }

    fn describe(&self) -> String {
        match self.datagram_port() {
            Some(port) => format!("{} by TCP, frames by UDP to port {port}", self.device),
            None => format!("{} by TCP", self.device),
        }
    }
}

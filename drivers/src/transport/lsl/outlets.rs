//! The sockets of streams that we publish: a TCP port for each, a UDP port for time probes and questions, and one that others
//! share for questions to all machines.

use std::{
    io::{self, ErrorKind},
    net::{Ipv4Addr, SocketAddr, UdpSocket},
    time::Duration,
};

use labstream_core::net::config;

use super::feed::monotonic_ns;
use crate::{
    lsl::{InletId, OutletServer},
    transport::network::{
        interfaces,
        server::{StreamServer, TcpServer},
        shared_socket,
    },
};

/// Datagrams that are answered at once: a flood of questions must not hold up samples.
const DATAGRAMS_MAX: usize = 64;

/// Bytes of a question or a probe: those of liblsl have some hundred.
const DATAGRAM_BYTES: usize = 2048;

/// The sockets. IPv4 alone, which every program of the Lab Streaming Layer speaks.
#[derive(Debug)]
pub struct OutletSockets {
    address: Ipv4Addr,
    ports: Vec<u16>,
    connections: TcpServer<InletId>,
    /// Answers time probes and questions to this machine, and all questions.
    service: UdpSocket,
    /// Gets the questions to all machines, unless the system refuses its port.
    questions: Option<UdpSocket>,
}

impl OutletSockets {
    /// Opens the ports of one stream at this address of the machine, in the range of LSL's configuration.
    ///
    /// # Errors
    /// The system's: no port of the range is free, or the address is not there.
    pub fn open(address: Ipv4Addr) -> io::Result<Self> {
        let service = in_range(|port| UdpSocket::bind((address, port)))?;
        service.set_nonblocking(true)?;
        let connections = in_range(|port| TcpServer::open((address, port).into()))?;
        Ok(Self {
            address,
            ports: vec![connections.address().port()],
            connections,
            service,
            questions: questions(address).ok(),
        })
    }

    /// The address.
    #[must_use]
    pub fn address(&self) -> Ipv4Addr {
        self.address
    }

    /// The UDP port of time probes.
    ///
    /// # Errors
    /// The system's.
    pub fn service_port(&self) -> io::Result<u16> {
        Ok(self.service.local_addr()?.port())
    }

    /// Whether questions to all machines reach it.
    #[must_use]
    pub fn gets_questions(&self) -> bool {
        self.questions.is_some()
    }

    /// The TCP port of a stream, which is opened if there are too few.
    ///
    /// # Errors
    /// The system's: no port of the range is free.
    pub fn port(&mut self, stream: usize) -> io::Result<u16> {
        while self.ports.len() <= stream {
            let connections = &mut self.connections;
            let address = in_range(|port| connections.open_another((self.address, port).into()))?;
            self.ports.push(address.port());
        }
        Ok(self.ports.get(stream).copied().unwrap_or_default())
    }

    /// Number of ports that are open, each for a stream.
    #[must_use]
    pub fn n_opened(&self) -> usize {
        self.ports.len()
    }

    /// The port of a stream; 0 if it is not open.
    #[must_use]
    pub fn opened(&self, stream: usize) -> u16 {
        self.ports.get(stream).copied().unwrap_or_default()
    }

    /// Joins the groups of questions on interfaces that have come since.
    pub fn join_groups(&self) {
        if let Some(socket) = &self.questions {
            join_groups(socket, self.address);
        }
    }

    /// Answers the datagrams that have come: soon, because the time that they wait counts as the way here. `may_ask` says who
    /// is answered.
    pub fn answer<S: AsMut<OutletServer>>(
        &self,
        server: &mut S,
        may_ask: impl Fn(&S, SocketAddr) -> bool,
    ) {
        let mut buffer = [0; DATAGRAM_BYTES];
        for socket in [Some(&self.service), self.questions.as_ref()].into_iter().flatten() {
            for _ in 0..DATAGRAMS_MAX {
                let (n, from) = match socket.recv_from(&mut buffer) {
                    Ok(received) => received,
                    Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                    // None waits, or one that was answered is gone.
                    Err(_) => break,
                };
                if !may_ask(server, from) {
                    continue;
                }
                let datagram = buffer.get(..n).unwrap_or_default();
                let clock_s = || monotonic_ns() as f64 * 1e-9;
                for (to, bytes) in server.as_mut().answers(from, datagram, clock_s) {
                    // Who does not get it asks again.
                    self.service.send_to(&bytes, to).ok();
                }
            }
        }
    }

    /// Accepts connections, and moves what is pending.
    pub fn exchange(&mut self, server: &mut impl StreamServer<Id = InletId>) {
        self.connections.exchange(server);
    }

    /// Waits until a program connects, sends or takes something, or asks, and reads what has come.
    ///
    /// # Errors
    /// The system's.
    pub fn wait(
        &mut self,
        server: &mut impl StreamServer<Id = InletId>,
        timeout: Duration,
    ) -> io::Result<()> {
        let others: Vec<&UdpSocket> =
            [Some(&self.service), self.questions.as_ref()].into_iter().flatten().collect();
        self.connections.wait_also(server, timeout, &others)
    }

    /// Closes all ports, and connections once they have what is pending, at most after `timeout`.
    pub fn finish(self, server: &mut impl StreamServer<Id = InletId>, timeout: Duration) {
        self.connections.finish(server, timeout);
    }
}

/// Opens the first free port of LSL's range.
fn in_range<T>(mut open: impl FnMut(u16) -> io::Result<T>) -> io::Result<T> {
    let settings = config::get();
    let mut problem = io::Error::from(ErrorKind::AddrInUse);
    for offset in 0..settings.port_range {
        match open(settings.base_port.saturating_add(offset)) {
            Ok(opened) => return Ok(opened),
            Err(error) => problem = error,
        }
    }
    Err(problem)
}

/// A socket that gets questions to all machines: on the network of this address, or on all of them. Several programs of a
/// machine share the port.
fn questions(address: Ipv4Addr) -> io::Result<UdpSocket> {
    let settings = config::get();
    let socket = shared_socket(settings.multicast_port)?;
    join_groups(&socket, address);
    Ok(socket)
}

/// Joins the groups of questions by the interface with this address, or by all: a program of this machine asks by the networks.
fn join_groups(socket: &UdpSocket, address: Ipv4Addr) {
    let is_one = !address.is_loopback() && !address.is_unspecified();
    let all = interfaces().unwrap_or_default().into_iter().map(|interface| interface.address);
    let addresses: Vec<Ipv4Addr> = if is_one { vec![address] } else { all.collect() };
    for group in &config::get().multicast_addresses {
        let Some(group) = group.parse().ok().filter(Ipv4Addr::is_multicast) else { continue };
        for interface in &addresses {
            // Joined already, or an interface without multicast: questions come by others.
            socket.join_multicast_v4(&group, interface).ok();
        }
    }
}

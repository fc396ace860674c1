//! The sockets of streams, of both ends. A reader has two connections: one for the whole description of a stream, one for its
//! samples. A publisher has a TCP port for each stream, a UDP port for time probes and questions, and one that others share for
//! questions to all machines.

use std::{
    io::{self, ErrorKind, Read, Write},
    net::{Ipv4Addr, SocketAddr, TcpStream, UdpSocket},
    os::fd::AsRawFd,
    time::{Duration, Instant},
};

use labstream_core::{
    net::config,
    proto::{
        feed::{FeedClient, FeedParams, State, TestPatternError},
        header,
    },
    wire::{ByteOrder, Format},
};
use nix::sys::socket::{
    setsockopt,
    sockopt::{KeepAlive, TcpKeepCount, TcpKeepIdle, TcpKeepInterval},
};
use rustix::time::{ClockId, clock_gettime};

use crate::{
    lsl::{DESCRIPTION_BYTES_MAX, InletId, OutletServer, StreamDescription, ValueFormat, clean},
    transport::network::{
        interfaces,
        server::{StreamServer, TcpServer},
        shared_socket,
    },
};

/// Time-out of a connection and of each read of its handshake: a machine on a local network answers in milliseconds.
const TIMEOUT: Duration = Duration::from_secs(1);

/// Bytes of a handshake: headers of some hundred, and two samples of 4096 doubles or short texts.
const HANDSHAKE_BYTES_MAX: usize = 1 << 19;

/// How long the sender keeps samples that we do not read, in seconds, and how many of a stream without a rate.
const KEPT_S: f64 = 60.0;
const KEPT_IRREGULAR: i32 = 10_000;

/// A machine that vanished is noticed without data by probes of the connection: after 3 s, four times every second.
const KEEPALIVE_IDLE_S: u32 = 3;
const KEEPALIVE_INTERVAL_S: u32 = 1;
const KEEPALIVE_COUNT: u32 = 4;

/// The host's monotonic clock, in nanoseconds: LSL's clock on Linux.
pub(super) fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// Asks a stream for its whole description, an XML document, which has to be complete at this time.
///
/// # Errors
/// A phrase that says what went wrong.
pub(super) fn whole_description(address: SocketAddr, until: Instant) -> Result<String, String> {
    let mut stream = connect(address)?;
    stream.write_all(b"LSL:fullinfo\r\n").map_err(|error| broken(&error))?;
    let mut bytes = Vec::new();
    while read_more(&mut stream, &mut bytes, until)? {
        if bytes.len() > DESCRIPTION_BYTES_MAX {
            return Err(format!("its description has more than {DESCRIPTION_BYTES_MAX} bytes"));
        }
    }
    String::from_utf8(bytes).map_err(|_| "its description is no UTF-8".to_owned())
}

fn connect(address: SocketAddr) -> Result<TcpStream, String> {
    let failed = |error: io::Error| match error.kind() {
        ErrorKind::TimedOut | ErrorKind::WouldBlock => format!(
            "it was found, but TCP port {} does not answer: check that no firewall blocks TCP ports 16572 to 16604",
            address.port()
        ),
        _ => format!("it was found, but cannot be connected to ({error})"),
    };
    let stream = TcpStream::connect_timeout(&address, TIMEOUT).map_err(failed)?;
    stream.set_read_timeout(Some(TIMEOUT)).map_err(|error| broken(&error))?;
    stream.set_write_timeout(Some(TIMEOUT)).map_err(|error| broken(&error))?;
    stream.set_nodelay(true).map_err(|error| broken(&error))?;
    Ok(stream)
}

fn broken(error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::TimedOut | ErrorKind::WouldBlock => "its sender does not answer".to_owned(),
        _ => format!("the connection broke ({error})"),
    }
}

/// The open feed of a stream.
#[derive(Debug)]
pub(super) struct Feed {
    pub(super) stream: TcpStream,
    pub(super) is_big_endian: bool,
    /// What came behind the handshake.
    pub(super) rest: Vec<u8>,
}

impl Feed {
    /// Opens the feed of a stream at this address, which has to be done at this time.
    ///
    /// # Errors
    /// A phrase that says what went wrong.
    pub(super) fn open(
        description: &StreamDescription,
        address: SocketAddr,
        until: Instant,
    ) -> Result<Self, String> {
        let mut stream = connect(address)?;
        let format = wire_format(description.format);
        let mut params = FeedParams::new(&description.uid, format);
        params.source_id = header_value(&description.source_id);
        params.hostname = header_value(&crate::lsl::hostname());
        params.session_id = header_value(&config::get().session_id);
        params.max_buffer_length = match description.rate_hz {
            0.0 => KEPT_IRREGULAR,
            rate_hz => (rate_hz * KEPT_S).clamp(1000.0, f64::from(i32::MAX)) as i32,
        };
        let (mut client, request) = FeedClient::start(params, format, description.n_channels);
        stream.write_all(&request).map_err(|error| broken(&error))?;
        let mut rest = Vec::new();
        while client.state() != State::Streaming {
            let Some(used) = advance(&mut client, &rest)? else {
                if !read_more(&mut stream, &mut rest, until)? {
                    return Err("its sender closed the connection".to_owned());
                }
                if rest.len() > HANDSHAKE_BYTES_MAX {
                    return Err("its sender answers with something else than LSL does".to_owned());
                }
                continue;
            };
            rest.drain(..used);
        }
        let is_big_endian = client.agreement().is_some_and(|agreed| agreed.order == ByteOrder::Big);
        stream.set_nonblocking(true).map_err(|error| broken(&error))?;
        // Where the system refuses these, a machine that vanished is noticed later.
        let fd = stream.as_raw_fd();
        setsockopt(fd, KeepAlive, &true).ok();
        setsockopt(fd, TcpKeepIdle, &KEEPALIVE_IDLE_S).ok();
        setsockopt(fd, TcpKeepInterval, &KEEPALIVE_INTERVAL_S).ok();
        setsockopt(fd, TcpKeepCount, &KEEPALIVE_COUNT).ok();
        Ok(Self { stream, is_big_endian, rest })
    }
}

/// Takes the next step of a handshake. Returns the bytes that it used; `None` when it needs more.
fn advance(client: &mut FeedClient, bytes: &[u8]) -> Result<Option<usize>, String> {
    if client.state() == State::AwaitingTestPattern {
        return match client.on_test_pattern(bytes) {
            Ok(used) => Ok(Some(used)),
            Err(TestPatternError::Incomplete) => Ok(None),
            Err(_) => Err("its test samples are not those of its description".to_owned()),
        };
    }
    match client.on_headers(bytes) {
        Ok(used) => Ok(Some(used)),
        Err(header::Error::Incomplete) => Ok(None),
        Err(error) => Err(format!("its sender refuses ({})", clean(&error.to_string()))),
    }
}

/// Reads once; `false` when the sender has closed the connection.
fn read_more(stream: &mut TcpStream, bytes: &mut Vec<u8>, until: Instant) -> Result<bool, String> {
    if Instant::now() > until {
        return Err("its sender takes too long to answer".to_owned());
    }
    let mut buffer = [0; 8192];
    match stream.read(&mut buffer) {
        Ok(n) => {
            bytes.extend_from_slice(buffer.get(..n).unwrap_or_default());
            Ok(n > 0)
        }
        Err(error) if error.kind() == ErrorKind::Interrupted => Ok(true),
        Err(error) => Err(broken(&error)),
    }
}

/// A text as the value of a header, which ends with its line and at a `;`.
fn header_value(text: &str) -> String {
    text.chars().filter(|c| !c.is_control() && *c != ';').collect()
}

fn wire_format(format: ValueFormat) -> Format {
    match format {
        ValueFormat::Float32 => Format::Float32,
        ValueFormat::Double64 => Format::Double64,
        ValueFormat::Text => Format::String,
        ValueFormat::Int8 => Format::Int8,
        ValueFormat::Int16 => Format::Int16,
        ValueFormat::Int32 => Format::Int32,
        ValueFormat::Int64 => Format::Int64,
    }
}

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

#[cfg(test)]
mod tests {
    use std::{net::TcpListener, thread};

    use super::*;

    /// The address of a peer that answers each connection so.
    fn peer(answer: impl Fn(TcpStream) + Send + 'static) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        thread::Builder::new()
            .spawn(move || listener.incoming().flatten().for_each(answer))
            .unwrap();
        address
    }

    fn description() -> StreamDescription {
        StreamDescription { uid: "u".to_owned(), n_channels: 4, ..StreamDescription::default() }
    }

    /// Why neither a description nor a feed can be had, within 300 ms and one read.
    fn failures(address: SocketAddr) -> [String; 2] {
        let began = Instant::now();
        let until = || Instant::now() + Duration::from_millis(300);
        let found = [
            whole_description(address, until()).unwrap_err(),
            Feed::open(&description(), address, until()).unwrap_err(),
        ];
        assert!(began.elapsed() < 2 * (Duration::from_millis(600) + TIMEOUT), "{found:?}");
        found
    }

    #[test]
    fn peers_that_dribble_flood_or_hang_up_cost_bounded_time_and_memory() {
        let dribbling = peer(|mut stream| {
            while stream.write_all(b"<").is_ok() {
                thread::sleep(Duration::from_millis(50));
            }
        });
        assert!(failures(dribbling).iter().all(|text| text.contains("too long")));
        let flooding = peer(|mut stream| while stream.write_all(&[b'x'; 65_536]).is_ok() {});
        let [of_description, of_feed] = failures(flooding);
        assert!(of_description.contains("more than 1048576 bytes"), "{of_description}");
        assert!(
            of_feed.contains("something else than LSL") || of_feed.contains("too long"),
            "{of_feed}"
        );
        let refusing = peer(|mut stream| drop(stream.write_all(b"LSL/110 404 Not found\r\n\r\n")));
        // As a description it is read up to its end, or the connection is reset: it closes before the request is read.
        let until = Instant::now() + Duration::from_millis(300);
        let refused = Feed::open(&description(), refusing, until).unwrap_err();
        assert!(refused.contains("refuses"), "{refused}");
        let silent = peer(|stream| drop((thread::sleep(Duration::from_secs(3)), stream)));
        assert!(failures(silent)[0].contains("does not answer"));
    }
}

//! The line to streams of the Lab Streaming Layer: finds and describes them, opens their feeds, and merges what arrives into one stream of bytes.

mod discovery;
mod sockets;

use std::{
    collections::VecDeque,
    io::Read,
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket},
    time::{Duration, Instant},
};

use labstream_core::proto::timesync::{build_probe, parse_answer};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use self::{
    discovery::{Return, ReturnWatch, is_retry},
    sockets::{Feed, monotonic_ns, whole_description},
};
pub use discovery::{FoundStream, streams};
pub use sockets::OutletSockets;

use super::{Arrival, READ_TIMEOUT, Transport, TransportError};
use crate::{
    lsl::{
        DATA_HEADER_BYTES, Layout, LineRequest, StreamDescription, StreamMessage, data_header,
        put_message,
    },
    uri::StreamQuery,
};

/// Probes whose reply may still come: as many as the recorder sends at once.
const PROBES_MAX: usize = 16;

/// Bytes of one read of a feed: what one message holds at most.
const READ_BYTES: usize = 1 << 15;

/// Time in which all streams have to be described, and all feeds to be open: a reader that must show signs of life every 10 s
/// waits for it, after the search.
const SETUP_TIMEOUT: Duration = Duration::from_secs(3);

/// A stream of this line.
#[derive(Debug)]
struct LineStream {
    found: FoundStream,
    feed: Option<Feed>,
}

/// Streams of one machine, found by name.
#[derive(Debug)]
pub struct LslTransport {
    name: String,
    streams: Vec<LineStream>,
    /// The stream of frames, without which there is no recording.
    frames: usize,
    /// Why the stream of frames is over: the connection ends when its last samples were read.
    over: Option<String>,
    /// Waits for other streams that are over.
    returns: Option<ReturnWatch>,
    /// Messages that wait for the next read.
    waiting: VecDeque<u8>,
    probes: Option<UdpSocket>,
    /// Number of the next probe, and those without a reply: number, and the host's clock that the recorder stated.
    next_probe: i32,
    pending: VecDeque<(i32, u64)>,
    /// The stream to read first: each in turn.
    turn: usize,
    arrival: Arrival,
}

impl LslTransport {
    /// Finds the streams, and asks for their descriptions.
    ///
    /// # Errors
    /// `Unreachable` when a stream cannot be found or is one of several, `Unsupported` when they cannot be recorded, or not
    /// together. Each says what was found and what to do.
    pub fn open(query: &StreamQuery) -> Result<Self, TransportError> {
        let name = query.to_string();
        let mut waiting = Vec::new();
        let mut descriptions = Vec::new();
        let mut streams = Vec::new();
        let all = discovery::find(query)?;
        let until = Instant::now() + SETUP_TIMEOUT;
        for (number, mut found) in all.into_iter().enumerate() {
            let unreachable = |remedy| TransportError::Unreachable {
                device: format!("{name} {}", found.description.summary()),
                remedy,
            };
            let Some(address) = found.data_address() else {
                return Err(unreachable(
                    "it states no port for data: restart its program".to_owned(),
                ));
            };
            let xml = whole_description(address, until).map_err(unreachable)?;
            let whole = StreamDescription::parse(&xml).map_err(unreachable)?;
            if whole.uid != found.description.uid {
                return Err(unreachable(
                    "it is over, and another one answers at its port".to_owned(),
                ));
            }
            put_message(
                StreamMessage::Description { stream: number as u8, xml: &xml },
                &mut waiting,
            );
            found.description = whole.clone();
            descriptions.push(whole);
            streams.push(LineStream { found, feed: None });
        }
        let layout = Layout::new(query, &descriptions).map_err(TransportError::Unsupported)?;
        put_message(StreamMessage::Found, &mut waiting);
        // Of the frames: others may end, and they go on.
        let of_frames = streams.get(layout.frames.0);
        let service = of_frames.and_then(|stream: &LineStream| stream.found.service_address());
        Ok(Self {
            name,
            streams,
            frames: layout.frames.0,
            over: None,
            returns: None,
            waiting: waiting.into(),
            probes: service.and_then(probe_socket),
            next_probe: 1,
            pending: VecDeque::with_capacity(PROBES_MAX),
            turn: 0,
            arrival: Arrival::default(),
        })
    }

    /// The id of the source, if there is one stream and it states one.
    #[must_use]
    pub fn only_source_id(&self) -> Option<String> {
        let [stream] = &self.streams[..] else { return None };
        Some(stream.found.description.source_id.clone()).filter(|id| !id.is_empty())
    }

    fn lost(&self, cause: String) -> TransportError {
        TransportError::ConnectionLost { device: self.name.clone(), cause }
    }

    fn put(&mut self, message: StreamMessage<'_>) {
        let mut bytes = Vec::new();
        put_message(message, &mut bytes);
        self.waiting.extend(bytes);
    }

    fn put_data(&mut self, stream: u8, bytes: &[u8]) {
        let read_ns = monotonic_ns();
        for bytes in bytes.chunks(READ_BYTES) {
            self.put(StreamMessage::Data { stream, read_ns, bytes });
        }
    }

    fn execute(&mut self, request: LineRequest) -> Result<(), TransportError> {
        match request {
            LineRequest::Begin => self.begin(),
            LineRequest::End => {
                self.end();
                Ok(())
            }
            LineRequest::Probe { host_ns } => {
                self.probe(host_ns);
                Ok(())
            }
        }
    }

    /// Opens the feeds that are not open.
    fn begin(&mut self) -> Result<(), TransportError> {
        let until = Instant::now() + SETUP_TIMEOUT;
        for number in 0..self.streams.len() {
            let Some(stream) = self.streams.get_mut(number).filter(|stream| stream.feed.is_none())
            else {
                continue;
            };
            let LineStream { found, .. } = &*stream;
            let failed = |cause| format!("the stream '{}': {cause}", found.description.name);
            let opened = match found.data_address() {
                Some(address) => Feed::open(&found.description, address, until).map_err(failed),
                None => Err(failed("it states no port for data".to_owned())),
            };
            let mut feed = match opened {
                Ok(feed) => feed,
                Err(cause) => return Err(self.lost(cause)),
            };
            let (rest, is_big_endian) = (std::mem::take(&mut feed.rest), feed.is_big_endian);
            stream.feed = Some(feed);
            self.put(StreamMessage::Feed { stream: number as u8, is_big_endian });
            if !rest.is_empty() {
                // Behind Started, so that the recorder has begun.
                self.put(StreamMessage::Started);
                self.put_data(number as u8, &rest);
            }
        }
        self.put(StreamMessage::Started);
        Ok(())
    }

    /// Reads what has arrived, and closes the feeds.
    fn end(&mut self) {
        self.returns = None;
        for number in 0..self.streams.len() {
            let Some(mut feed) = self.streams.get_mut(number).and_then(|stream| stream.feed.take())
            else {
                continue;
            };
            let mut buffer = vec![0; READ_BYTES];
            // No more than the kernel holds, so that a fast sender does not keep this up.
            for _ in 0..DRAIN_READS_MAX {
                match feed.stream.read(&mut buffer) {
                    Ok(n @ 1..) => {
                        let (stream, read_ns) = (number as u8, monotonic_ns());
                        let bytes = buffer.get(..n).unwrap_or_default();
                        self.put(StreamMessage::Data { stream, read_ns, bytes });
                    }
                    _ => break,
                }
            }
        }
        self.put(StreamMessage::Ended);
    }

    /// Asks for the sender's time; an answer that is lost is not waited for.
    fn probe(&mut self, host_ns: u64) {
        let Some(socket) = &self.probes else { return };
        let number = self.next_probe;
        self.next_probe = number.checked_add(1).unwrap_or(1);
        self.pending.push_back((number, host_ns));
        if self.pending.len() > PROBES_MAX {
            self.pending.pop_front();
        }
        socket.send(&build_probe(number, host_ns as f64 * 1e-9)).ok();
    }

    /// Takes a reply to a probe, if one came.
    fn read_reply(&mut self) {
        let mut buffer = [0; 512];
        let Some(Ok(n)) = self.probes.as_ref().map(|socket| socket.recv(&mut buffer)) else {
            return;
        };
        let read_ns = monotonic_ns();
        let Some(answer) = parse_answer(buffer.get(..n).unwrap_or_default()) else { return };
        let place = self.pending.iter().position(|(number, _)| *number == answer.wave_id);
        let Some((_, host_ns)) = place.and_then(|at| self.pending.remove(at)) else { return };
        let sender_s = answer.t1 + (answer.t2 - answer.t1) / 2.0;
        if sender_s.is_finite() {
            self.put(StreamMessage::Time { host_ns, sender_s, read_ns });
        }
    }

    /// Waits until a socket is readable; returns which: one entry for each stream, and one for probes.
    fn wait(&self) -> Result<Vec<bool>, TransportError> {
        let timeout = Timespec { tv_sec: 0, tv_nsec: i64::from(READ_TIMEOUT.subsec_nanos()) };
        let feeds = self.streams.iter().map(|stream| stream.feed.as_ref());
        let open: Vec<Option<&Feed>> = feeds.collect();
        let mut fds: Vec<PollFd<'_>> = Vec::with_capacity(open.len() + 1);
        fds.extend(open.iter().flatten().map(|feed| PollFd::new(&feed.stream, PollFlags::IN)));
        fds.extend(self.probes.as_ref().map(|socket| PollFd::new(socket, PollFlags::IN)));
        if let Err(error) = poll(&mut fds, Some(&timeout)) {
            let source = std::io::Error::from(error);
            if is_retry(&source) {
                return Ok(Vec::new());
            }
            let device = self.name.clone();
            return Err(TransportError::Io { device, action: "waiting for samples", source });
        }
        let mut ready = fds.iter().map(|fd| !fd.revents().is_empty());
        let mut of_streams: Vec<bool> =
            open.iter().map(|feed| feed.is_some() && ready.next().unwrap_or(false)).collect();
        of_streams.push(ready.next().unwrap_or(false));
        Ok(of_streams)
    }

    /// Reads a feed into a message.
    fn read_feed(&mut self, number: usize, buf: &mut [u8]) -> Result<usize, TransportError> {
        let Some((header, content)) = buf.split_at_mut_checked(DATA_HEADER_BYTES) else {
            return Ok(0);
        };
        let Some(stream) = self.streams.get_mut(number) else { return Ok(0) };
        let Some(feed) = &mut stream.feed else { return Ok(0) };
        let n_max = content.len().min(READ_BYTES);
        let read = feed.stream.read(content.get_mut(..n_max).unwrap_or_default());
        let read_ns = monotonic_ns();
        let name = &stream.found.description.name;
        let cause = match read {
            Ok(0) => format!("the stream '{name}' is over: its program ended or closed it"),
            Ok(n) => {
                header.copy_from_slice(&data_header(number as u8, read_ns, n));
                self.arrival = Arrival { is_datagram: false, host_ns: Some(read_ns) };
                return Ok(DATA_HEADER_BYTES + n);
            }
            Err(error) if is_retry(&error) => return Ok(0),
            Err(error) => format!("the stream '{name}' cannot be read any more ({error})"),
        };
        stream.feed = None;
        let description = stream.found.description.clone();
        self.put(StreamMessage::Lost { stream: number as u8 });
        if number == self.frames {
            self.over = Some(cause);
        } else {
            // Without it there are frames all the same.
            self.returns = self.returns.take().or_else(ReturnWatch::start);
            if let Some(returns) = &self.returns {
                returns.look_for(number, description);
            }
        }
        Ok(self.waiting.read(buf).unwrap_or(0))
    }

    /// Takes the feeds of streams that were over and are back.
    fn take_returned(&mut self) {
        while let Some(report) = self.returns.as_ref().and_then(ReturnWatch::next_return) {
            match report {
                Return::Changed { number } => {
                    self.put(StreamMessage::Changed { stream: number as u8 });
                }
                Return::Back { number, found, mut feed } => {
                    let (rest, is_big_endian) =
                        (std::mem::take(&mut feed.rest), feed.is_big_endian);
                    if let Some(stream) = self.streams.get_mut(number) {
                        *stream = LineStream { found: *found, feed: Some(*feed) };
                    }
                    self.put(StreamMessage::Feed { stream: number as u8, is_big_endian });
                    self.put_data(number as u8, &rest);
                }
            }
        }
    }
}

/// Reads of a feed that is being closed: 2 MiB, what the kernel holds of a connection at most by default, is 64 times the
/// bytes of a read.
const DRAIN_READS_MAX: usize = 64;

fn probe_socket(to: SocketAddr) -> Option<UdpSocket> {
    let any: IpAddr =
        if to.is_ipv6() { Ipv6Addr::UNSPECIFIED.into() } else { Ipv4Addr::UNSPECIFIED.into() };
    let socket = UdpSocket::bind((any, 0)).ok()?;
    socket.set_nonblocking(true).ok()?;
    // From here on the system delivers this machine's datagrams only.
    socket.connect(to).ok()?;
    Some(socket)
}

impl Transport for LslTransport {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, TransportError> {
        self.arrival = Arrival::default();
        self.take_returned();
        if self.waiting.is_empty() {
            if let Some(cause) = self.over.take() {
                return Err(self.lost(cause));
            }
            let ready = self.wait()?;
            let n = self.streams.len();
            if ready.get(n).is_some_and(|ready| *ready) {
                self.read_reply();
            }
            // Datagrams, however many, do not keep samples waiting.
            if self.waiting.is_empty() {
                let turns = (0..n).map(|at| (self.turn + at) % n.max(1));
                let next = turns.into_iter().find(|at| ready.get(*at).is_some_and(|ready| *ready));
                let Some(number) = next else { return Ok(0) };
                self.turn = number + 1;
                return self.read_feed(number, buf);
            }
        }
        Ok(self.waiting.read(buf).unwrap_or(0))
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        LineRequest::all(bytes).try_for_each(|request| self.execute(request))
    }

    fn arrival(&self) -> Arrival {
        self.arrival
    }

    fn describe(&self) -> String {
        self.name.clone()
    }
}

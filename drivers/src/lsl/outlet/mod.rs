//! Streams that we publish, sans-io: what programs send goes in, descriptions and samples come out. The sockets are
//! [`OutletSockets`](crate::transport::lsl::OutletSockets).
//!
//! Each stream has a TCP port. A reader is a connection to it, with a bounded queue of samples: if it reads too slowly, the
//! oldest are dropped and counted, and nothing waits for it.

#[cfg(test)]
mod tests;

use std::{collections::VecDeque, net::SocketAddr, sync::Arc};

use labstream_core::{
    net::{Node, StreamInfo, config, make_uid},
    proto::{
        discovery::{build_answer, parse_query},
        header::parse_block,
        negotiate::{Accepted, FeedRequest, LITTLE, Outcome, ServerStream, negotiate},
        timesync,
    },
    wire::{ByteOrder, Codec, Format, TEST_PATTERN_OFFSETS, test_pattern},
};

use super::values::{put_floats, put_text};
use crate::{
    outbox::Outbox,
    transport::network::{responder::AnswerLimit, server::StreamServer},
};

/// Readers at the same time, at most: each may let 4 MiB of samples wait.
pub const INLETS_MAX: usize = 64;

/// Connections besides those of readers: descriptions are asked for before a stream is read, by one connection each.
const ASKING_MAX: usize = 32;

/// Time for a request after a connection, and for taking its answer.
const REQUEST_TIMEOUT_NS: u64 = 10_000_000_000;

/// Questions of one machine that are answered in a second: a program asks about twice. More are a flood, whose sender may be
/// forged: an answer is some twenty times as long as its question.
const QUESTIONS_PER_S: u32 = 50;

/// The same of all machines: those of the busiest laboratory.
const ALL_QUESTIONS_PER_S: u32 = 500;

/// Identifies a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InletId(u64);

/// A reader of a stream, as its owner reports it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InletReport {
    /// Its address.
    pub peer: SocketAddr,
    /// The name of the stream.
    pub stream: String,
    /// Frames, batches or events that it was sent.
    pub frames_sent: u64,
    /// Those that it missed, because it read too slowly or they did not reach the server.
    pub frames_missed: u64,
}

#[derive(Debug)]
struct OutletStream {
    port: u16,
    /// `None` while nothing is published there.
    stream: Option<Described>,
}

#[derive(Debug)]
enum InletState {
    /// Sends a request, of which these bytes have come.
    Asking(Vec<u8>),
    /// Reads samples.
    Reading(FeedForm),
    /// Is to be disconnected once it has what is pending.
    Over,
}

#[derive(Debug)]
struct Inlet {
    id: InletId,
    peer: SocketAddr,
    port: u16,
    /// The name of the stream.
    stream: String,
    state: InletState,
    outbox: Outbox,
    /// Samples of each packet of samples that waits, and of all of them.
    held: VecDeque<usize>,
    n_held: usize,
    missed: u64,
    since_ns: u64,
}

impl Inlet {
    /// Is to be disconnected once it has what is pending.
    fn end(&mut self, now_ns: u64) {
        (self.state, self.since_ns) = (InletState::Over, now_ns);
    }

    /// Is to be disconnected now.
    fn drop_now(&mut self, now_ns: u64) {
        self.missed += self.outbox.frames_waiting() as u64;
        self.outbox.clear();
        self.held.clear();
        self.n_held = 0;
        self.end(now_ns);
    }

    /// Queues samples, for which the oldest packets make room; a packet of more samples than may wait does so alone.
    fn put(&mut self, bytes: Arc<[u8]>, n_samples: usize, held_max: usize) {
        while self.n_held > 0 && self.n_held + n_samples > held_max
            || !self.outbox.has_room_for(bytes.len())
        {
            let oldest = usize::from(self.outbox.has_begun_frame());
            if !self.outbox.drop_oldest_frame() {
                if self.outbox.has_room_for(bytes.len()) {
                    break;
                }
                // The one that is being sent fills it alone.
                self.missed += 1;
                return;
            }
            self.n_held -= self.held.remove(oldest).unwrap_or_default();
            self.missed += 1;
        }
        self.held.push_back(n_samples);
        self.n_held += n_samples;
        self.outbox.put_frame(bytes);
    }

    fn sent(&mut self, n: usize) {
        self.outbox.sent(n);
        while self.held.len() > self.outbox.frames_waiting() {
            self.n_held -= self.held.pop_front().unwrap_or_default();
        }
    }

    fn report(&self) -> InletReport {
        InletReport {
            peer: self.peer,
            stream: self.stream.clone(),
            frames_sent: self.outbox.frames_sent(),
            frames_missed: self.missed,
        }
    }
}

/// The server of streams.
#[derive(Debug)]
pub struct OutletServer {
    streams: Vec<OutletStream>,
    service_port: u16,
    inlets_max: usize,
    inlets: Vec<Inlet>,
    next_id: u64,
    now_ns: u64,
    missed_by_gone: u64,
    n_refused: u64,
    questions: AnswerLimit,
}

impl OutletServer {
    /// A server whose time probes are answered at this UDP port, and which has room for so many readers.
    #[must_use]
    pub fn new(service_port: u16, inlets_max: usize) -> Self {
        Self {
            streams: Vec::new(),
            service_port,
            inlets_max: inlets_max.clamp(1, INLETS_MAX),
            inlets: Vec::new(),
            next_id: 0,
            now_ns: 0,
            missed_by_gone: 0,
            n_refused: 0,
            questions: AnswerLimit::new(QUESTIONS_PER_S, ALL_QUESTIONS_PER_S),
        }
    }

    /// Publishes a stream at a TCP port, or nothing. The readers of the one before are disconnected once they have what waits for
    /// them; they find the new one by its source id.
    pub fn set_stream(&mut self, port: u16, info: Option<StreamInfo>, now_ns: u64) {
        self.now_ns = now_ns;
        let info = info.map(|mut info| {
            info.uid = make_uid();
            info.session_id.clone_from(&config::get().session_id);
            info.created_at = now_ns as f64 * 1e-9;
            (info.v4data_port, info.v4service_port) = (port, self.service_port);
            Described::new(info)
        });
        for inlet in self.inlets.iter_mut().filter(|inlet| inlet.port == port) {
            inlet.end(now_ns);
        }
        match self.streams.iter_mut().find(|stream| stream.port == port) {
            Some(served) => served.stream = info,
            None => self.streams.push(OutletStream { port, stream: info }),
        }
    }

    fn info(&self, port: u16) -> Option<&StreamInfo> {
        let served = self.streams.iter().find(|served| served.port == port)?;
        served.stream.as_ref().map(|stream| &stream.info)
    }

    fn published(&self) -> impl Iterator<Item = &Described> {
        self.streams.iter().filter_map(|served| served.stream.as_ref())
    }

    /// Whether anybody reads the stream at this port.
    #[must_use]
    pub fn is_read(&self, port: u16) -> bool {
        let reads =
            |inlet: &Inlet| inlet.port == port && matches!(inlet.state, InletState::Reading(_));
        self.inlets.iter().any(reads)
    }

    /// Names of the streams that are published.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.published().map(|stream| stream.info.name.as_str())
    }

    /// Sends samples of numbers, one after another. The first was taken at `time_s` of LSL's clock, which is the monotonic clock
    /// of this machine; the others follow it at the stream's rate.
    pub fn push(&mut self, port: u16, time_s: f64, values: &[f32]) {
        let Some(info) = self.info(port).filter(|info| info.format == Format::Float32) else {
            return;
        };
        let n_channels = (info.channel_count as usize).max(1);
        let n_samples = values.len() / n_channels;
        self.send(port, n_samples, |form, out| {
            for (index, sample) in values.chunks_exact(n_channels).enumerate() {
                let time_s = (index == 0).then_some(time_s);
                put_floats(time_s, sample, form.is_big_endian, form.suppresses_subnormals, out);
            }
        });
    }

    /// Sends a text.
    pub fn push_text(&mut self, port: u16, time_s: f64, text: &str) {
        if self.info(port).is_some_and(|info| info.format == Format::String) {
            self.send(port, 1, |form, out| put_text(time_s, text, form.is_big_endian, out));
        }
    }

    /// Queues what `write` appends for each reader; those that want the same form share the bytes.
    fn send(&mut self, port: u16, n_samples: usize, write: impl Fn(FeedForm, &mut Vec<u8>)) {
        if n_samples == 0 {
            return;
        }
        let mut written: [Option<Arc<[u8]>>; 4] = [const { None }; 4];
        for inlet in self.inlets.iter_mut().filter(|inlet| inlet.port == port) {
            let InletState::Reading(form) = inlet.state else { continue };
            let index =
                usize::from(form.is_big_endian) * 2 + usize::from(form.suppresses_subnormals);
            let Some(place) = written.get_mut(index) else { continue };
            let bytes = place.get_or_insert_with(|| {
                let mut bytes = Vec::new();
                write(form, &mut bytes);
                bytes.into()
            });
            inlet.put(Arc::clone(bytes), n_samples, form.held_max);
        }
    }

    /// Counts frames or batches that did not reach the server as missed by all readers of a stream.
    pub fn left_out(&mut self, port: u16, n: u64) {
        for inlet in self.inlets.iter_mut().filter(|inlet| inlet.port == port) {
            inlet.missed += if matches!(inlet.state, InletState::Reading(_)) { n } else { 0 };
        }
    }

    /// Notes the time, and gives up connections that send no request, or do not take its answer.
    pub fn set_now(&mut self, now_ns: u64) {
        self.now_ns = now_ns;
        for inlet in &mut self.inlets {
            let is_late = now_ns.saturating_sub(inlet.since_ns) > REQUEST_TIMEOUT_NS;
            if is_late && !matches!(inlet.state, InletState::Reading(_)) {
                inlet.drop_now(now_ns);
            }
        }
    }

    /// The answers to a datagram: short descriptions of the streams that are meant, or our clock at the arrival and now.
    #[must_use]
    pub fn answers(
        &mut self,
        from: SocketAddr,
        datagram: &[u8],
        clock_s: impl Fn() -> f64,
    ) -> Vec<(SocketAddr, Vec<u8>)> {
        let arrived_s = clock_s();
        if let Some(query) = parse_query(datagram) {
            if !self.questions.allows(from.ip(), self.now_ns) {
                return Vec::new();
            }
            let to = SocketAddr::new(from.ip(), query.return_port);
            let meant = self.published().filter(|stream| stream.is_meant(&query.query));
            let answer = |stream: &Described| {
                (to, build_answer(&query.query_id, &stream.info.to_shortinfo_xml()))
            };
            return meant.map(answer).collect();
        }
        let probe = timesync::parse_probe(datagram);
        let reply = |probe: timesync::Probe| {
            (from, timesync::build_answer(probe.wave_id, probe.t0, arrived_s, clock_s()))
        };
        probe.map(reply).into_iter().collect()
    }

    /// The readers, in the order in which they connected.
    #[must_use]
    pub fn reports(&self) -> Vec<InletReport> {
        let readers = self.inlets.iter();
        let readers = readers.filter(|inlet| matches!(inlet.state, InletState::Reading(_)));
        readers.map(Inlet::report).collect()
    }

    /// What a reader was sent, while it is connected.
    #[must_use]
    pub fn report(&self, id: InletId) -> Option<InletReport> {
        self.inlets.iter().find(|inlet| inlet.id == id).map(Inlet::report)
    }

    /// Frames, batches and events that all readers have missed so far, also those that are gone.
    #[must_use]
    pub fn frames_missed(&self) -> u64 {
        self.missed_by_gone + self.inlets.iter().map(|inlet| inlet.missed).sum::<u64>()
    }

    /// How often a reader was refused, because there are too many.
    #[must_use]
    pub fn n_refused(&self) -> u64 {
        self.n_refused
    }

    fn find(&self, id: InletId) -> Option<&Inlet> {
        self.inlets.iter().find(|inlet| inlet.id == id)
    }

    fn n_readers(&self) -> usize {
        let reads = |inlet: &&Inlet| matches!(inlet.state, InletState::Reading(_));
        self.inlets.iter().filter(reads).count()
    }

    /// Takes the next bytes of a request, and answers it once all of it is there.
    fn ask(&mut self, id: InletId, bytes: &[u8]) {
        let (has_room, now_ns) = (self.n_readers() < self.inlets_max, self.now_ns);
        let Self { streams, inlets, .. } = self;
        let Some(inlet) = inlets.iter_mut().find(|inlet| inlet.id == id) else { return };
        let InletState::Asking(request) = &mut inlet.state else { return };
        request.extend_from_slice(bytes);
        let served = streams.iter().find(|served| served.port == inlet.port);
        let Some(stream) = served.and_then(|served| served.stream.as_ref()) else {
            inlet.end(now_ns);
            return;
        };
        match answer(request, stream, has_room) {
            None if request.len() > REQUEST_BYTES_MAX => inlet.end(now_ns),
            None => {}
            Some(Answer::Last(bytes)) => {
                self.n_refused += u64::from(!has_room && bytes.starts_with(b"LSL/"));
                inlet.outbox.put(|out| out.extend(bytes));
                inlet.end(now_ns);
            }
            Some(Answer::Feed(bytes, form)) => {
                inlet.outbox.put(|out| out.extend(bytes));
                inlet.stream.clone_from(&stream.info.name);
                inlet.state = InletState::Reading(form);
            }
        }
    }
}

impl StreamServer for OutletServer {
    type Id = InletId;

    fn connect(&mut self, peer: SocketAddr) -> Result<InletId, Vec<u8>> {
        self.connect_at(peer, peer)
    }

    fn connect_at(&mut self, peer: SocketAddr, local: SocketAddr) -> Result<InletId, Vec<u8>> {
        if self.inlets.len() >= self.inlets_max + ASKING_MAX {
            self.n_refused += 1;
            return Err(Vec::new());
        }
        let id = InletId(self.next_id);
        self.next_id += 1;
        self.inlets.push(Inlet {
            id,
            peer,
            port: local.port(),
            stream: String::new(),
            state: InletState::Asking(Vec::new()),
            outbox: Outbox::default(),
            // As many as packets wait, which the outbox bounds.
            held: VecDeque::default(),
            n_held: 0,
            missed: 0,
            since_ns: self.now_ns,
        });
        Ok(id)
    }

    fn disconnect(&mut self, id: InletId) {
        // What waits for it is not sent any more.
        let missed = |inlet: &Inlet| inlet.missed + inlet.outbox.frames_waiting() as u64;
        self.missed_by_gone += self.find(id).map_or(0, missed);
        self.inlets.retain(|inlet| inlet.id != id);
    }

    fn receive(&mut self, id: InletId, bytes: &[u8]) {
        // A reader sends nothing more; what it sends all the same is left out.
        self.ask(id, bytes);
    }

    fn may_receive(&self, id: InletId) -> bool {
        self.find(id).is_some_and(|inlet| !matches!(inlet.state, InletState::Over))
    }

    fn is_over(&self, id: InletId) -> bool {
        self.find(id).is_none_or(|inlet| matches!(inlet.state, InletState::Over))
    }

    fn pending(&self, id: InletId) -> &[u8] {
        self.find(id).map(|inlet| inlet.outbox.next()).unwrap_or_default()
    }

    fn sent(&mut self, id: InletId, n: usize) {
        if let Some(inlet) = self.inlets.iter_mut().find(|inlet| inlet.id == id) {
            inlet.sent(n);
        }
    }
}

/// Bytes of a request: its headers have some hundred.
const REQUEST_BYTES_MAX: usize = 1 << 14;

/// Bytes of a question for streams: those of liblsl have some hundred.
const QUESTION_BYTES_MAX: usize = 1 << 10;

/// Parentheses, other symbols and spaces of a question outside its texts: those of liblsl have some twenty. The parser and the
/// evaluation call themselves for each, and some thousand would overflow the stack.
const PARENTHESES_MAX: usize = 16;
const SYMBOLS_MAX: usize = 64;

/// How fast we convert the order of bytes, which decides whose order is used: as fast as any, so that a reader with another
/// order gets its own.
const ENDIAN_PERFORMANCE: f64 = 1000.0;

/// How a reader wants its samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct FeedForm {
    is_big_endian: bool,
    /// Whether the smallest numbers are sent as 0.
    suppresses_subnormals: bool,
    /// Samples that may wait, as it wants.
    held_max: usize,
}

/// The answer to a request.
#[derive(Debug, PartialEq)]
enum Answer {
    /// These bytes, and the end.
    Last(Vec<u8>),
    /// These bytes, and samples.
    Feed(Vec<u8>, FeedForm),
}

/// Answers a request, once all of it is there.
fn answer(bytes: &[u8], stream: &Described, has_room: bool) -> Option<Answer> {
    let info = &stream.info;
    let end = bytes.iter().position(|byte| *byte == b'\n')?;
    let rest = bytes.get(end + 1..)?;
    let line = String::from_utf8_lossy(bytes.get(..end)?);
    let line = line.trim();
    if line == "LSL:fullinfo" {
        return Some(Answer::Last(info.to_fullinfo_xml().into_bytes()));
    }
    if line == "LSL:shortinfo" {
        let end = rest.iter().position(|byte| *byte == b'\n')?;
        let question = String::from_utf8_lossy(rest.get(..end)?);
        let found = stream.is_meant(question.trim()).then(|| info.to_shortinfo_xml());
        return Some(Answer::Last(found.unwrap_or_default().into_bytes()));
    }
    let Some(feed) = line.strip_prefix("LSL:streamfeed/") else {
        // Also the feed of protocol 1.00, which no liblsl of the last ten years asks for.
        return Some(Answer::Last(Vec::new()));
    };
    let is_complete = rest.starts_with(b"\r\n") || rest.windows(4).any(|four| four == b"\r\n\r\n");
    is_complete.then(|| open_feed(feed, rest, info, has_room))
}

fn open_feed(line: &str, headers: &[u8], info: &StreamInfo, has_room: bool) -> Answer {
    let (version, uid) = line.split_once(' ').unwrap_or((line, ""));
    let (headers, _) = parse_block(headers).unwrap_or_default();
    let mut server = ServerStream::new(&info.uid, info.format, LITTLE, ENDIAN_PERFORMANCE);
    if info.format == Format::String {
        server.channel_bytes = 0;
    }
    let version = version.trim().parse().unwrap_or(0);
    let request = FeedRequest::from_headers(version, uid.trim(), &headers, server.channel_bytes);
    let accepted = match negotiate(&request, &server) {
        Outcome::Refuse(status) => return Answer::Last(status.to_wire().into_bytes()),
        Outcome::Accept(accepted) => accepted,
    };
    if !has_room {
        let refusal = format!("LSL/{} 503 Too many inlets\r\n\r\n", server.configured_version);
        return Answer::Last(refusal.into_bytes());
    }
    let order = accepted.codec_order().filter(|_| accepted.data_protocol_version >= 110);
    // A sample that nobody can read is not begun.
    let Some((order, patterns)) = order.and_then(|order| Some((order, patterns(info, order)?)))
    else {
        return Answer::Last(Vec::new());
    };
    let mut bytes = accepted.to_wire(server.configured_version, &info.uid).into_bytes();
    bytes.extend(patterns);
    match form(&accepted, order) {
        Some(form) => Answer::Feed(bytes, form),
        None => Answer::Last(bytes),
    }
}

/// The form of samples; `None` for a reader that wants none.
fn form(accepted: &Accepted, order: ByteOrder) -> Option<FeedForm> {
    let held_max = usize::try_from(accepted.max_buffer_length).ok().filter(|n| *n > 0)?;
    Some(FeedForm {
        is_big_endian: order == ByteOrder::Big,
        suppresses_subnormals: accepted.suppress_subnormals,
        held_max,
    })
}

/// The two samples with which every feed begins.
fn patterns(info: &StreamInfo, order: ByteOrder) -> Option<Vec<u8>> {
    let n_channels = info.channel_count as usize;
    let codec = Codec::new(info.format, n_channels, order);
    let mut bytes = Vec::new();
    for offset in TEST_PATTERN_OFFSETS {
        codec.encode(&test_pattern(info.format, n_channels, offset), &mut bytes).ok()?;
    }
    Some(bytes)
}

/// A stream, and what its short description states.
#[derive(Debug)]
struct Described {
    info: StreamInfo,
    short: StreamInfo,
}

impl Described {
    fn new(info: StreamInfo) -> Self {
        let mut short = info.clone();
        short.desc = Node::element("desc");
        Self { info, short }
    }

    /// Whether a question means it. It is compared with what the short description states.
    ///
    /// A question with conditions in brackets, `//` or `*` is not answered: a hostile one takes longer with each of them.
    fn is_meant(&self, question: &str) -> bool {
        let is_costly = ["[", "//", "*"].iter().any(|part| question.contains(part));
        let is_simple = question.len() <= QUESTION_BYTES_MAX && is_flat(question) && !is_costly;
        is_simple && self.short.matches(question)
    }
}

fn is_flat(question: &str) -> bool {
    let (mut quote, mut n_opened, mut n_symbols) = (None, 0, 0);
    for c in question.chars() {
        match quote {
            Some(end) if c == end => quote = None,
            Some(_) => {}
            None if matches!(c, '\'' | '"') => quote = Some(c),
            None => {
                n_opened += usize::from(c == '(');
                n_symbols += usize::from(!c.is_alphanumeric());
            }
        }
    }
    n_opened <= PARENTHESES_MAX && n_symbols <= SYMBOLS_MAX
}

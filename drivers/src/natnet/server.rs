//! The server's end of the protocol, sans-io: datagrams of clients go in, replies and frames come out.
//!
//! It stands in for Motive. Who owns it makes the frames, sends the datagrams, and says who may ask.

use std::net::{IpAddr, SocketAddr, SocketAddrV4};

use super::{
    frame::{FrameToSend, put_frame},
    message::{
        Bitstream, MESSAGE_BYTES_MAX, Message, MessageKind, ServerInfo, StreamInfo, put_echo,
        put_message, put_text, read_wanted_version,
    },
    model::Model,
};
use crate::{bytes::Cursor, transport::network::responder::AnswerLimit};

/// Clients that get frames of their own at the same time.
pub const CLIENTS_MAX: usize = 32;

/// A client that was silent for so long gets no more frames, if it has kept its connection alive before: each second, as NatNet's
/// documents require.
const CLIENT_TIMEOUT_NS: u64 = 10_000_000_000;

/// A client that never kept its connection alive gets frames for so long: libmotioncapture sends nothing once it has connected, but
/// goes on reading. If it is gone, its frames reach nobody for ten minutes, but a client that needs its place gets it.
const SILENT_CLIENT_TIMEOUT_NS: u64 = 600_000_000_000;

/// Definitions that a client is sent in a second, at most: one that waits for them asks four times.
const MODELS_PER_S: u32 = 10;

/// Replies to a machine in a second, and to all, at most: a client asks for the clock some ten times. Replies are up to a hundred times
/// as long as requests, and a sender's address may be forged.
const REPLIES_PER_S: u32 = 200;
const ALL_REPLIES_PER_S: u32 = 1000;

/// A client that was silent for so long makes room for another one: three of its signs of life are missing.
const REPLACED_AFTER_NS: u64 = 3_000_000_000;

/// How frames are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ServedStream {
    /// To a group.
    Multicast(SocketAddrV4),
    /// To each client: to the socket of its commands, and to this port of its machine.
    Unicast(u16),
}

/// What a server states.
#[derive(Debug, Clone, PartialEq)]
pub struct ServerSettings {
    /// The program's name.
    pub name: String,
    /// The program's version.
    pub app_version: [u8; 4],
    /// The version of the bitstream, unless a client asks for another one.
    pub bitstream: Bitstream,
    /// Frames per second.
    pub rate_hz: f32,
    /// Samples of force plates and devices in a frame.
    pub samples_per_frame: u32,
    /// Ticks of the server's clock per second.
    pub clock_hz: u64,
    /// How frames are sent.
    pub stream: ServedStream,
    /// The definitions.
    pub model: Model,
}

/// Where frames go: the socket of a client, or the group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamReport {
    /// Its address.
    pub address: SocketAddr,
    /// The version of its frames.
    pub version: Bitstream,
    /// Frames that it was sent.
    pub frames_sent: u64,
    /// Frames that it was not sent: the system did not take them, or they did not fit into a datagram.
    pub frames_missed: u64,
}

#[derive(Debug)]
struct StreamClient {
    report: StreamReport,
    last_ns: u64,
    /// Whether it has sent what clients repeat while they read.
    keeps_alive: bool,
    /// Definitions that it was sent in the second that began then.
    models: (u64, u32),
}

impl StreamClient {
    fn new(address: SocketAddr, version: Bitstream, last_ns: u64) -> Self {
        let report = StreamReport { address, version, frames_sent: 0, frames_missed: 0 };
        Self { report, last_ns, keeps_alive: false, models: (last_ns, 0) }
    }

    /// Whether it may be sent definitions now, which are many times as long as the request.
    fn may_get_model(&mut self, now_ns: u64) -> bool {
        let (since_ns, n) = self.models;
        self.models = match now_ns.saturating_sub(since_ns) {
            0..1_000_000_000 => (since_ns, n.saturating_add(1)),
            _ => (now_ns, 1),
        };
        self.models.1 <= MODELS_PER_S
    }
}

/// What a datagram has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DatagramContent {
    /// The reply to a command.
    Reply,
    /// A frame, for the group or the socket of a client's commands.
    Frame,
    /// The same, for the port of frames of the client's machine.
    Copy,
}

/// A datagram to send.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServerDatagram {
    /// Its destination.
    pub to: SocketAddr,
    /// Its content.
    pub bytes: Vec<u8>,
    /// What that is.
    pub content: DatagramContent,
}

/// A server.
#[derive(Debug)]
pub struct NatNetServer {
    settings: ServerSettings,
    clients_max: usize,
    clients: Vec<StreamClient>,
    /// Frames to the group, where there is one.
    group: StreamClient,
    /// Frames that clients missed that are gone.
    missed_by_gone: u64,
    n_refused: u64,
    datagrams: Vec<ServerDatagram>,
    /// Requests for definitions are not replied to.
    withholds_model: bool,
    n_connects: u64,
    replies: AnswerLimit,
}

impl NatNetServer {
    /// A server.
    #[must_use]
    pub fn new(settings: ServerSettings) -> Self {
        Self {
            clients_max: CLIENTS_MAX,
            clients: Vec::new(),
            group: StreamClient::new(SocketAddr::V4(settings.group()), settings.bitstream, 0),
            missed_by_gone: 0,
            n_refused: 0,
            settings,
            datagrams: Vec::new(),
            withholds_model: false,
            n_connects: 0,
            replies: AnswerLimit::new(REPLIES_PER_S, ALL_REPLIES_PER_S),
        }
    }

    /// Sends frames to at most so many clients at the same time.
    #[must_use]
    pub fn limited_to(mut self, clients_max: usize) -> Self {
        self.clients_max = clients_max.clamp(1, CLIENTS_MAX);
        self
    }

    /// What it states.
    #[must_use]
    pub fn settings(&self) -> &ServerSettings {
        &self.settings
    }

    /// Frames come at this rate, and with so many samples, from now on.
    pub fn set_rates(&mut self, rate_hz: f32, samples_per_frame: u32) {
        self.settings.rate_hz = rate_hz;
        self.settings.samples_per_frame = samples_per_frame;
    }

    /// Replaces the definitions.
    pub fn set_model(&mut self, model: Model) {
        self.settings.model = model;
    }

    /// Sends frames and definitions of another bitstream from now on.
    pub fn set_bitstream(&mut self, version: Bitstream) {
        self.settings.bitstream = version;
        self.group.report.version = version;
        self.clients.iter_mut().for_each(|client| client.report.version = version);
    }

    /// Whether the definitions fit into a datagram in every version: clients get none that do not.
    #[must_use]
    pub fn has_room_for_model(&self) -> bool {
        let mut bytes = Vec::new();
        self.settings.model.put(Bitstream::NEWEST, &mut bytes);
        bytes.len() <= MESSAGE_BYTES_MAX
    }

    /// Leaves requests for definitions without a reply, or not any more.
    pub fn withhold_model(&mut self, withholds: bool) {
        self.withholds_model = withholds;
    }

    /// How often clients have connected.
    #[must_use]
    pub fn n_connects(&self) -> u64 {
        self.n_connects
    }

    /// How often a client was refused, because there are too many.
    #[must_use]
    pub fn n_refused(&self) -> u64 {
        self.n_refused
    }

    /// Where frames go: the group, or the clients in the order in which they connected.
    #[must_use]
    pub fn reports(&self) -> Vec<StreamReport> {
        match self.settings.stream {
            ServedStream::Multicast(_) => vec![self.group.report],
            ServedStream::Unicast(_) => self.clients.iter().map(|client| client.report).collect(),
        }
    }

    /// Frames that all clients have missed so far, also those that are gone.
    #[must_use]
    pub fn frames_missed(&self) -> u64 {
        let now: u64 = self.reports().iter().map(|report| report.frames_missed).sum();
        self.missed_by_gone + now
    }

    /// Counts frames that did not reach the server as missed by all.
    pub fn left_out(&mut self, n_frames: u64) {
        self.streams().for_each(|report| report.frames_missed += n_frames);
    }

    fn streams(&mut self) -> impl Iterator<Item = &mut StreamReport> {
        let is_multicast = self.is_multicast();
        let clients = self.clients.iter_mut().filter(move |_| !is_multicast);
        let group = std::iter::once(&mut self.group).filter(move |_| is_multicast);
        group.chain(clients).map(|client| &mut client.report)
    }

    /// Whether frames reach anybody, as far as the server can know.
    #[must_use]
    pub fn has_listeners(&self) -> bool {
        self.is_multicast() || !self.clients.is_empty()
    }

    /// Forgets all clients, and what was not sent: as after a restart.
    pub fn restart(&mut self) {
        self.clients.clear();
        self.datagrams.clear();
    }

    /// Takes the datagrams to send, oldest first.
    pub fn take_datagrams(&mut self) -> Vec<ServerDatagram> {
        std::mem::take(&mut self.datagrams)
    }

    /// Counts a datagram of [`take_datagrams`](Self::take_datagrams) that the system took, or did not.
    pub fn datagram_sent(&mut self, datagram: &ServerDatagram, is_sent: bool) {
        if datagram.content != DatagramContent::Frame {
            return;
        }
        let Some(report) = self.streams().find(|report| report.address == datagram.to) else {
            return;
        };
        report.frames_sent += u64::from(is_sent);
        report.frames_missed += u64::from(!is_sent);
    }

    /// Executes a client's datagram. `ticks` is the server's clock when it arrived.
    pub fn receive(&mut self, from: SocketAddr, bytes: &[u8], ticks: u64, now_ns: u64) {
        let Some(message) = Message::of(bytes) else { return };
        if message.kind.is_some_and(MessageKind::is_of_servers) {
            // An answer to it would be answered by another server, for ever.
            return;
        }
        if let Some(client) = self.client(from) {
            client.last_ns = now_ns;
            client.keeps_alive |=
                matches!(message.kind, Some(MessageKind::KeepAlive | MessageKind::Echo));
        }
        let has_reply =
            !matches!(message.kind, Some(MessageKind::KeepAlive | MessageKind::Disconnect));
        if has_reply && !self.replies.allows(from.ip(), now_ns) {
            return;
        }
        match message.kind {
            Some(MessageKind::Connect) => self.connect(from, message.body, now_ns),
            Some(MessageKind::Discovery) => {
                let version = self.version_for(from);
                self.reply(from, |server, out| server.info(version).put(out));
            }
            Some(MessageKind::Request) => self.execute(from, &message.text()),
            Some(MessageKind::RequestModel) if self.withholds_model => {}
            Some(MessageKind::RequestModel) => {
                // Only who has connected, and not often: a sender's address may be forged.
                if !self.client(from).is_some_and(|client| client.may_get_model(now_ns)) {
                    return;
                }
                let version = self.version_for(from);
                self.reply(from, |server, out| server.settings.model.put(version, out));
            }
            Some(MessageKind::Echo) if self.settings.bitstream.has_ticks() => {
                let mut body = Cursor::new(message.body);
                if let Some(client_time) = body.get::<u64>() {
                    self.reply(from, |_, out| put_echo(client_time, Some(ticks), out));
                }
            }
            Some(MessageKind::Disconnect) => self.forget(|client| client.report.address == from),
            Some(MessageKind::KeepAlive) => {}
            _ => self.reply(from, |_, out| put_message(MessageKind::Unrecognized, out, |_| {})),
        }
    }

    fn client(&mut self, address: SocketAddr) -> Option<&mut StreamClient> {
        self.clients.iter_mut().find(|client| client.report.address == address)
    }

    fn forget(&mut self, is_gone: impl Fn(&StreamClient) -> bool) {
        let missed = &mut self.missed_by_gone;
        self.clients.retain(|client| {
            let goes = is_gone(client);
            *missed += if goes { client.report.frames_missed } else { 0 };
            !goes
        });
    }

    fn reply(&mut self, to: SocketAddr, write: impl FnOnce(&Self, &mut Vec<u8>)) {
        let mut bytes = Vec::new();
        write(self, &mut bytes);
        if bytes.len() <= MESSAGE_BYTES_MAX {
            self.datagrams.push(ServerDatagram { to, bytes, content: DatagramContent::Reply });
        }
    }

    fn version_for(&self, address: SocketAddr) -> Bitstream {
        let client = self.clients.iter().find(|client| client.report.address == address);
        client.map_or(self.settings.bitstream, |client| client.report.version)
    }

    /// What it states to a client that gets this version: readers take the layout of frames from it.
    fn info(&self, bitstream: Bitstream) -> ServerInfo {
        let ServerSettings { name, app_version, clock_hz, stream, .. } = &self.settings;
        let is_multicast = matches!(stream, ServedStream::Multicast(_));
        let group = self.settings.group();
        let (group, port) = (*group.ip(), group.port());
        let clock_hz = *clock_hz;
        ServerInfo {
            name: name.clone(),
            app_version: *app_version,
            bitstream,
            // A client of 2.10 ignores it, and one that reads nothing else finds the port.
            stream: Some(StreamInfo { clock_hz, port, is_multicast, group }),
        }
    }

    /// A client that asks for a version with the request gets its frames in it, as from the SDK of Motive 3 on.
    fn connect(&mut self, from: SocketAddr, body: &[u8], now_ns: u64) {
        if self.client(from).is_none() && !self.make_room(now_ns) {
            self.n_refused += 1;
            return;
        }
        self.n_connects += 1;
        let version = read_wanted_version(body).filter(|version| self.may_send(*version));
        match (self.client(from), version) {
            (Some(client), Some(version)) => client.report.version = version,
            (Some(_), None) => {}
            (None, version) => {
                let version = version.unwrap_or(self.settings.bitstream);
                self.clients.push(StreamClient::new(from, version, now_ns));
            }
        }
        let version = self.version_for(from);
        self.reply(from, |server, out| server.info(version).put(out));
    }

    fn is_multicast(&self) -> bool {
        matches!(self.settings.stream, ServedStream::Multicast(_))
    }

    /// Whether there is room for one more client. One that has been silent, and is gone most likely, makes it; by multicast the
    /// one that has been silent for longest, because it needs none.
    fn make_room(&mut self, now_ns: u64) -> bool {
        if self.clients.len() < self.clients_max {
            return true;
        }
        let oldest = self.clients.iter().map(|client| client.last_ns).min().unwrap_or(now_ns);
        if !self.is_multicast() && now_ns.saturating_sub(oldest) <= REPLACED_AFTER_NS {
            return false;
        }
        let gone = self.clients.iter().find(|client| client.last_ns == oldest);
        if let Some(address) = gone.map(|client| client.report.address) {
            self.forget(|client| client.report.address == address);
        }
        true
    }

    /// Whether a client can have frames of this version.
    fn may_send(&self, version: Bitstream) -> bool {
        !self.is_multicast()
            && (Bitstream::OLDEST..=Bitstream::NEWEST).contains(&version)
            && self.settings.bitstream.can_change()
    }

    fn execute(&mut self, from: SocketAddr, text: &str) {
        let response = |bytes: [u8; 4]| {
            move |_: &Self, out: &mut Vec<u8>| {
                put_message(MessageKind::Response, out, |out| out.extend_from_slice(&bytes));
            }
        };
        let ServerSettings { rate_hz, samples_per_frame, .. } = self.settings;
        match text.split_once(',') {
            None if text == "FrameRate" => self.reply(from, response(rate_hz.to_le_bytes())),
            None if text == "AnalogSamplesPerMocapFrame" => {
                self.reply(from, response(samples_per_frame.to_le_bytes()));
            }
            None if text == "UnitsToMillimeters" => {
                self.reply(from, response(1000_f32.to_le_bytes()));
            }
            None if text == "Bitstream" => {
                let text = format!("Bitstream,{}", self.version_for(from));
                self.reply(from, |_, out| put_text(MessageKind::Response, &text, out));
            }
            Some(("Bitstream", version)) => {
                let wanted = version.parse().ok().filter(|version| self.may_send(*version));
                let is_done = match (wanted, self.client(from)) {
                    (Some(version), Some(client)) => {
                        client.report.version = version;
                        true
                    }
                    _ => false,
                };
                self.reply(from, response(i32::from(!is_done).to_le_bytes()));
            }
            _ => self.reply(from, |_, out| put_message(MessageKind::Unrecognized, out, |_| {})),
        }
    }

    /// Forgets clients that have been silent for too long.
    pub fn forget_silent(&mut self, now_ns: u64) {
        self.forget(|client| {
            let timeout_ns =
                if client.keeps_alive { CLIENT_TIMEOUT_NS } else { SILENT_CLIENT_TIMEOUT_NS };
            now_ns.saturating_sub(client.last_ns) > timeout_ns
        });
    }

    /// Sends a frame to all who want it. Returns how many datagrams it takes; `None` when it does not fit into one.
    pub fn frame(&mut self, frame: &FrameToSend<'_>, now_ns: u64) -> Option<usize> {
        self.forget_silent(now_ns);
        let before = self.datagrams.len();
        let port = match self.settings.stream {
            ServedStream::Multicast(_) => None,
            ServedStream::Unicast(port) => Some(port),
        };
        // The bytes of each version, and the port of frames of each machine, which has the version of its last client.
        let mut written: Vec<(Bitstream, Vec<u8>)> = Vec::new();
        let mut copies: Vec<(IpAddr, Vec<u8>)> = Vec::new();
        let mut frames = Vec::new();
        let mut fits = true;
        for report in self.streams() {
            let found = written.iter().position(|(version, _)| *version == report.version);
            let index = found.unwrap_or_else(|| {
                let mut bytes = Vec::new();
                put_frame(frame, report.version, &mut bytes);
                written.push((report.version, bytes));
                written.len() - 1
            });
            let Some((_, bytes)) = written.get(index) else { continue };
            if bytes.len() > MESSAGE_BYTES_MAX {
                report.frames_missed += 1;
                fits = false;
                continue;
            }
            let (to, content) = (report.address, DatagramContent::Frame);
            frames.push(ServerDatagram { to, bytes: bytes.clone(), content });
            if port.is_some_and(|port| port != to.port()) {
                copies.retain(|(ip, _)| *ip != to.ip());
                copies.push((to.ip(), bytes.clone()));
            }
        }
        // One whose own socket is at that port has it already.
        copies.retain(|(ip, _)| {
            let at = port.map(|port| SocketAddr::new(*ip, port));
            frames.iter().all(|frame| Some(frame.to) != at)
        });
        self.datagrams.append(&mut frames);
        let copies = copies.into_iter().map(|(ip, bytes)| {
            let to = SocketAddr::new(ip, port.unwrap_or_default());
            ServerDatagram { to, bytes, content: DatagramContent::Copy }
        });
        self.datagrams.extend(copies);
        fits.then(|| self.datagrams.len() - before)
    }
}

impl ServerSettings {
    /// The group of frames; the default one where they go to clients.
    fn group(&self) -> SocketAddrV4 {
        match self.stream {
            ServedStream::Multicast(group) => group,
            ServedStream::Unicast(port) => SocketAddrV4::new(super::GROUP, port),
        }
    }
}

//! The server's end of the protocol, sans-io: datagrams of clients go in, replies and frames come out.
//!
//! It stands in for Motive. Who owns it makes the frames.

use std::net::{IpAddr, SocketAddr, SocketAddrV4};

use super::{
    frame::{FrameToSend, put_frame},
    message::{
        Bitstream, MESSAGE_BYTES_MAX, Message, MessageKind, ServerInfo, StreamInfo, put_echo,
        put_message, put_text,
    },
    model::Model,
};
use crate::bytes::Cursor;

/// Clients that get frames of their own at the same time.
pub const CLIENTS_MAX: usize = 32;

/// A client that was silent for so long gets no more frames.
const CLIENT_TIMEOUT_NS: u64 = 10_000_000_000;

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

#[derive(Debug)]
struct StreamClient {
    address: SocketAddr,
    version: Bitstream,
    last_ns: u64,
}

/// A datagram to send.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServerDatagram {
    /// Its destination.
    pub to: SocketAddr,
    /// Its content.
    pub bytes: Vec<u8>,
}

/// A server.
#[derive(Debug)]
pub struct NatNetServer {
    settings: ServerSettings,
    clients: Vec<StreamClient>,
    datagrams: Vec<ServerDatagram>,
    /// Requests for definitions are not replied to.
    withholds_model: bool,
    n_connects: u64,
}

impl NatNetServer {
    /// A server.
    #[must_use]
    pub fn new(settings: ServerSettings) -> Self {
        Self {
            settings,
            clients: Vec::new(),
            datagrams: Vec::new(),
            withholds_model: false,
            n_connects: 0,
        }
    }

    /// What it states.
    #[must_use]
    pub fn settings(&self) -> &ServerSettings {
        &self.settings
    }

    /// Replaces the definitions.
    pub fn set_model(&mut self, model: Model) {
        self.settings.model = model;
    }

    /// Sends frames and definitions of another bitstream from now on.
    pub fn set_bitstream(&mut self, version: Bitstream) {
        self.settings.bitstream = version;
        self.clients.iter_mut().for_each(|client| client.version = version);
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

    /// Whether frames reach anybody, as far as the server can know.
    #[must_use]
    pub fn has_listeners(&self) -> bool {
        matches!(self.settings.stream, ServedStream::Multicast(_)) || !self.clients.is_empty()
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

    /// Executes a client's datagram. `ticks` is the server's clock when it arrived.
    pub fn receive(&mut self, from: SocketAddr, bytes: &[u8], ticks: u64, now_ns: u64) {
        let Some(message) = Message::of(bytes) else { return };
        if let Some(client) = self.clients.iter_mut().find(|client| client.address == from) {
            client.last_ns = now_ns;
        }
        match message.kind {
            Some(MessageKind::Connect) => self.connect(from, now_ns),
            Some(MessageKind::Discovery) => self.reply(from, |server, out| server.info().put(out)),
            Some(MessageKind::Request) => self.execute(from, &message.text()),
            Some(MessageKind::RequestModel) if self.withholds_model => {}
            Some(MessageKind::RequestModel) => {
                let version = self.version_for(from);
                self.reply(from, |server, out| server.settings.model.put(version, out));
            }
            Some(MessageKind::Echo) if self.settings.bitstream.has_ticks() => {
                let mut body = Cursor::new(message.body);
                if let Some(client_time) = body.get::<u64>() {
                    self.reply(from, |_, out| put_echo(client_time, Some(ticks), out));
                }
            }
            Some(MessageKind::Disconnect) => self.clients.retain(|client| client.address != from),
            Some(MessageKind::KeepAlive) => {}
            _ => self.reply(from, |_, out| put_message(MessageKind::Unrecognized, out, |_| {})),
        }
    }

    fn reply(&mut self, to: SocketAddr, write: impl FnOnce(&Self, &mut Vec<u8>)) {
        let mut bytes = Vec::new();
        write(self, &mut bytes);
        self.push(to, bytes);
    }

    fn push(&mut self, to: SocketAddr, bytes: Vec<u8>) -> bool {
        let fits = bytes.len() <= MESSAGE_BYTES_MAX;
        if fits {
            self.datagrams.push(ServerDatagram { to, bytes });
        }
        fits
    }

    fn version_for(&self, address: SocketAddr) -> Bitstream {
        let client = self.clients.iter().find(|client| client.address == address);
        client.map_or(self.settings.bitstream, |client| client.version)
    }

    fn info(&self) -> ServerInfo {
        let ServerSettings { name, app_version, bitstream, clock_hz, stream, .. } = &self.settings;
        let (is_multicast, group, port) = match stream {
            ServedStream::Multicast(group) => (true, *group.ip(), group.port()),
            ServedStream::Unicast(port) => (false, super::GROUP, *port),
        };
        let clock_hz = *clock_hz;
        ServerInfo {
            name: name.clone(),
            app_version: *app_version,
            bitstream: *bitstream,
            // A client of 2.10 ignores it, and one that reads nothing else finds the port.
            stream: Some(StreamInfo { clock_hz, port, is_multicast, group }),
        }
    }

    fn connect(&mut self, from: SocketAddr, now_ns: u64) {
        self.n_connects += 1;
        self.reply(from, |server, out| server.info().put(out));
        let is_known = self.clients.iter().any(|client| client.address == from);
        let is_multicast = matches!(self.settings.stream, ServedStream::Multicast(_));
        if !is_multicast && !is_known {
            if self.clients.len() >= CLIENTS_MAX {
                // The one that has been silent for longest is gone most likely.
                let oldest = self.clients.iter().enumerate().min_by_key(|(_, one)| one.last_ns);
                if let Some(index) = oldest.map(|(index, _)| index) {
                    self.clients.remove(index);
                }
            }
            let version = self.settings.bitstream;
            self.clients.push(StreamClient { address: from, version, last_ns: now_ns });
        }
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
                let wanted = version.parse().ok().filter(|version: &Bitstream| {
                    (Bitstream::OLDEST..=Bitstream::NEWEST).contains(version)
                        && self.settings.bitstream.can_change()
                });
                let client = self.clients.iter_mut().find(|client| client.address == from);
                let is_done = match (wanted, client) {
                    (Some(version), Some(client)) => {
                        client.version = version;
                        true
                    }
                    _ => false,
                };
                self.reply(from, response(i32::from(!is_done).to_le_bytes()));
            }
            _ => self.reply(from, |_, out| put_message(MessageKind::Unrecognized, out, |_| {})),
        }
    }

    /// Sends a frame to all who want it. Returns how many datagrams it takes; `None` when it does not fit into one.
    pub fn frame(&mut self, frame: &FrameToSend<'_>, now_ns: u64) -> Option<usize> {
        self.clients.retain(|client| now_ns.saturating_sub(client.last_ns) <= CLIENT_TIMEOUT_NS);
        let before = self.datagrams.len();
        let mut fits = true;
        match self.settings.stream {
            ServedStream::Multicast(group) => {
                let mut bytes = Vec::new();
                put_frame(frame, self.settings.bitstream, &mut bytes);
                fits = self.push(SocketAddr::V4(group), bytes);
            }
            ServedStream::Unicast(port) => {
                let mut machines: Vec<IpAddr> = Vec::new();
                for client in std::mem::take(&mut self.clients) {
                    let mut bytes = Vec::new();
                    put_frame(frame, client.version, &mut bytes);
                    let ip = client.address.ip();
                    fits &= self.push(client.address, bytes.clone());
                    if !machines.contains(&ip) && client.address.port() != port {
                        machines.push(ip);
                        self.push(SocketAddr::new(ip, port), bytes);
                    }
                    self.clients.push(client);
                }
            }
        }
        fits.then(|| self.datagrams.len() - before)
    }
}

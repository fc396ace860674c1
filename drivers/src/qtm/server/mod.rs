//! The server's end of the protocol, sans-io: connections and their bytes go in, replies, frames and datagrams come out.
//!
//! It stands in for a QTM with one measurement: a file that it plays, or what a recorder records ([`QtmServer::of_recorder`]).
//! Who owns it makes the frames, and knows by [`QtmServer::is_playing`] whether they are wanted.

mod control;
mod delivery;
mod recorder;
mod samples;

use std::net::SocketAddr;

use self::recorder::Password;
use self::samples::SampleHistory;
pub use self::{
    delivery::{Datagram, Delivery, ServedFrame},
    recorder::{ClientReport, OwnerCommand, OwnerRequest},
};
use super::{
    command::{
        ClientCommand, Components, DatagramTarget, StreamRate, StreamRequest, VERSIONS, WELCOME,
    },
    packet::{Event, Packet, PacketKind, PacketReader, put_event, put_packet, put_text},
    settings::ServedSettings,
};
use crate::outbox::Outbox;

/// "Number of simultaneous connections is limited to 10."
pub const CLIENTS_MAX: usize = 10;

/// Longest packet of a client: many times the longest command. Settings are refused, so that none has to fit.
const COMMAND_BYTES_MAX: usize = 64 << 10;

/// A connected client, until it is disconnected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct ClientId(u64);

/// What is open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Measurement {
    /// Nothing.
    Closed,
    /// A file that is not played.
    File,
    /// A file that is played in real time.
    PlayedFile,
    /// The cameras' preview.
    Live,
    /// A capture.
    Capture,
}

/// For whom a server speaks.
#[derive(Debug)]
enum Role {
    /// A simulated QTM, which every client may control.
    Simulated,
    /// A recorder, which executes what a client with this password requests; without one, nobody controls it.
    Recorder { password: Option<Password> },
}

#[derive(Debug)]
struct Client {
    id: ClientId,
    peer: SocketAddr,
    reader: PacketReader,
    /// Version in use, as the number after `1.`; 1 until it is set.
    minor: u32,
    stream: Option<Stream>,
    one_frame: Option<Components>,
    /// Places at which the samples of its next frame begin, by device.
    samples_from: Vec<u64>,
    outbox: Outbox,
    is_out_of_step: bool,
    /// Whether the owner executes a command of it; later ones wait.
    awaits_owner: bool,
    /// Frames that it requested and did not get.
    frames_missed: u64,
    /// Samples that were not kept until its next frame.
    samples_missed: u64,
    /// Frames that left in datagrams, and whether a datagram of the present one was lost.
    datagram_frames: u64,
    is_part_lost: bool,
    wrong_passwords: u32,
}

#[derive(Debug, Clone, Copy)]
struct Stream {
    rate: StreamRate,
    components: Components,
    target: Option<SocketAddr>,
    /// Number of the stream, in the order of their starts.
    number: u64,
    /// Frames since its start.
    frames: u64,
    /// Whether a frame did not fit into datagrams.
    is_too_large: bool,
}

/// A server.
#[derive(Debug)]
pub struct QtmServer {
    settings: ServedSettings,
    histories: Vec<SampleHistory>,
    /// What it replies to `QTMVersion`.
    version: String,
    clients: Vec<Client>,
    next_client: u64,
    n_streams: u64,
    master: Option<ClientId>,
    measurement: Measurement,
    state: Event,
    datagrams: Vec<Datagram>,
    role: Role,
    clients_max: usize,
    requests: Vec<OwnerRequest>,
    /// Frames that clients missed which are gone.
    missed_by_gone: u64,
    /// Clients that gave a wrong password.
    wrong_passwords: Vec<SocketAddr>,
    /// Clients whose frames do not fit into datagrams.
    too_large: Vec<SocketAddr>,
}

impl QtmServer {
    /// A server with an open file, which it plays as soon as a client requests frames.
    #[must_use]
    pub fn new(settings: ServedSettings, version: String) -> Self {
        Self {
            histories: SampleHistory::of(&settings),
            settings,
            version,
            clients: Vec::new(),
            next_client: 0,
            n_streams: 0,
            master: None,
            measurement: Measurement::File,
            state: Event::RtFromFileStopped,
            datagrams: Vec::new(),
            role: Role::Simulated,
            clients_max: CLIENTS_MAX,
            requests: Vec::new(),
            missed_by_gone: 0,
            wrong_passwords: Vec::new(),
            too_large: Vec::new(),
        }
    }

    /// The message for a client that cannot connect because there are too many.
    #[must_use]
    pub fn refusal() -> Vec<u8> {
        let mut bytes = Vec::new();
        let text = "Connection refused. Max number of clients reached.";
        put_text(PacketKind::Error, text, &mut bytes);
        bytes
    }

    /// Accepts a client and greets it; `None` when there are too many.
    pub fn connect(&mut self, peer: SocketAddr) -> Option<ClientId> {
        if self.clients.len() >= self.clients_max {
            return None;
        }
        let id = ClientId(self.next_client);
        self.next_client += 1;
        let mut client = Client {
            id,
            peer,
            reader: PacketReader::with_limit(COMMAND_BYTES_MAX),
            minor: 1,
            stream: None,
            one_frame: None,
            samples_from: Vec::new(),
            outbox: Outbox::default(),
            is_out_of_step: false,
            awaits_owner: false,
            frames_missed: 0,
            samples_missed: 0,
            datagram_frames: 0,
            is_part_lost: false,
            wrong_passwords: 0,
        };
        client.outbox.put(|out| put_text(PacketKind::Command, WELCOME, out));
        self.clients.push(client);
        Some(id)
    }

    /// Forgets a client; the frames that wait for it are missed. Returns its last report.
    pub fn disconnect(&mut self, id: ClientId) -> Option<ClientReport> {
        if let Some(client) = self.client(id) {
            client.frames_missed += client.outbox.frames_waiting() as u64;
        }
        let report = self.report(id);
        self.missed_by_gone += report.as_ref().map_or(0, |report| report.frames_missed);
        self.clients.retain(|client| client.id != id);
        self.datagrams.retain(|datagram| datagram.client != id);
        if self.master == Some(id) {
            self.master = None;
        }
        report
    }

    /// Changes the settings while frames are sent. Clients learn of it, in front of the first frame with the new ones.
    pub fn change_settings(&mut self, settings: ServedSettings) {
        if self.settings != settings {
            self.use_settings(settings);
            self.send_event(Event::CameraSettingsChanged);
        }
    }

    fn use_settings(&mut self, settings: ServedSettings) {
        let devices = |of: &ServedSettings| (of.analog.clone(), of.plates.clone());
        if devices(&self.settings) != devices(&settings) {
            self.histories = SampleHistory::of(&settings);
            self.clients.iter_mut().for_each(|client| client.samples_from.fill(0));
        }
        self.settings = settings;
    }

    /// Forgets all clients; the measurement goes on.
    pub fn disconnect_all(&mut self) {
        self.clients.clear();
        self.datagrams.clear();
        self.master = None;
    }

    /// Forgets all clients, and opens the file again: as after a restart.
    pub fn restart(&mut self) {
        self.disconnect_all();
        (self.measurement, self.state) = (Measurement::File, Event::RtFromFileStopped);
    }

    fn client(&mut self, id: ClientId) -> Option<&mut Client> {
        self.clients.iter_mut().find(|client| client.id == id)
    }

    /// Executes the commands that these bytes complete.
    pub fn receive(&mut self, id: ClientId, bytes: &[u8]) {
        if let Some(client) = self.client(id) {
            client.reader.extend(bytes);
            self.execute_received(id);
        }
    }

    /// Executes the commands that have arrived, until the replies to them fill the client's output.
    fn execute_received(&mut self, id: ClientId) {
        let Some(client) = self.client(id) else { return };
        // Taken out while its packets are executed.
        let mut reader = std::mem::take(&mut client.reader);
        let mut is_garbage = false;
        while !is_garbage && self.may_receive(id) {
            match reader.next_packet() {
                Ok(Some(packet)) => self.execute(id, &packet),
                Ok(None) => break,
                Err(_) => is_garbage = true,
            }
        }
        let Some(client) = self.client(id) else { return };
        client.reader = reader;
        if is_garbage {
            client.set_out_of_step();
            client.outbox.put(|out| put_text(PacketKind::Error, "Parse error", out));
        }
    }

    /// Whether a client's bytes may be read: it reads its own.
    #[must_use]
    pub fn may_receive(&self, id: ClientId) -> bool {
        let client = self.clients.iter().find(|client| client.id == id);
        client.is_some_and(|client| {
            !client.outbox.is_full() && !client.is_out_of_step && !client.awaits_owner
        })
    }

    /// Whether a client sent no packets, and is to be disconnected once it has what is pending.
    #[must_use]
    pub fn is_out_of_step(&self, id: ClientId) -> bool {
        self.clients.iter().any(|client| client.id == id && client.is_out_of_step)
    }

    /// The bytes to send to a client next: those of one packet.
    #[must_use]
    pub fn pending(&self, id: ClientId) -> &[u8] {
        self.clients.iter().find(|client| client.id == id).map_or(&[], |c| c.outbox.next())
    }

    /// All bytes that wait for a client, in several packets.
    #[must_use]
    pub fn bytes_waiting(&self, id: ClientId) -> usize {
        self.clients.iter().find(|client| client.id == id).map_or(0, |c| c.outbox.waiting())
    }

    /// Takes all that waits for a client, as a connection does that is fast enough.
    pub fn take_pending(&mut self, id: ClientId) -> Vec<u8> {
        let mut bytes = Vec::new();
        // Commands that waited for room add replies, of which this takes no more than there were bytes.
        for _ in 0..self.bytes_waiting(id) {
            let n = self.pending(id).len();
            bytes.extend_from_slice(self.pending(id));
            self.sent(id, n);
            if n == 0 {
                break;
            }
        }
        bytes
    }

    /// Whether no client has bytes pending.
    #[must_use]
    pub fn is_all_sent(&self) -> bool {
        self.clients.iter().all(|client| client.outbox.waiting() == 0)
    }

    /// The connection took the first `n` pending bytes.
    pub fn sent(&mut self, id: ClientId, n: usize) {
        if let Some(client) = self.client(id) {
            client.outbox.sent(n);
            // Commands may have waited for this room.
            self.execute_received(id);
        }
    }

    /// Bytes ever sent to a client.
    #[must_use]
    pub fn bytes_sent(&self, id: ClientId) -> u64 {
        let client = self.clients.iter().find(|client| client.id == id);
        client.map_or(0, |client| client.outbox.queued() - client.outbox.waiting() as u64)
    }

    /// Takes the datagrams to send, oldest first.
    pub fn take_datagrams(&mut self) -> Vec<Datagram> {
        std::mem::take(&mut self.datagrams)
    }

    /// Whether frames are to be made.
    #[must_use]
    pub fn is_playing(&self) -> bool {
        !matches!(self.measurement, Measurement::Closed | Measurement::File)
    }

    /// Number of streams that were started so far.
    #[must_use]
    pub fn n_streams(&self) -> u64 {
        self.n_streams
    }

    /// Number of the stream whose frames [`Delivery`] is about, counted from 1; `None` when there is none.
    #[must_use]
    pub fn first_stream(&self) -> Option<u64> {
        self.clients.iter().filter_map(|client| client.stream).map(|stream| stream.number).min()
    }

    /// The file is over, or a capture.
    pub fn end_measurement(&mut self) {
        let event = match self.measurement {
            Measurement::PlayedFile => Event::RtFromFileStopped,
            Measurement::Capture => Event::CaptureStopped,
            Measurement::Live => Event::ConnectionClosed,
            Measurement::Closed | Measurement::File => return,
        };
        self.measurement = Measurement::File;
        self.send_event(event);
        self.send_no_more_data();
    }

    /// Sends an event to all clients, and keeps it as the state if it is one.
    pub fn send_event(&mut self, event: Event) {
        let is_state = !matches!(
            event,
            Event::CameraSettingsChanged
                | Event::ShuttingDown
                | Event::CaptureSaved
                | Event::Trigger
        );
        if is_state {
            self.state = event;
        }
        for client in &mut self.clients {
            client.put_unasked(|out| put_event(event, out));
        }
    }

    fn send_no_more_data(&mut self) {
        let mut bytes = Vec::new();
        put_packet(PacketKind::NoMoreData, &mut bytes, |_| {});
        for client in &mut self.clients {
            match client.stream.map(|stream| stream.target) {
                Some(Some(to)) => self.datagrams.push(Datagram {
                    client: client.id,
                    to,
                    bytes: bytes.clone(),
                    is_of_frame: false,
                    ends_frame: false,
                }),
                Some(None) => client.put_unasked(|out| out.extend_from_slice(&bytes)),
                None if client.one_frame.take().is_some() => {
                    client.put_unasked(|out| out.extend_from_slice(&bytes));
                }
                None => {}
            }
        }
    }

    fn execute(&mut self, id: ClientId, packet: &Packet<'_>) {
        match packet.kind {
            Some(PacketKind::Command) => {
                let command = ClientCommand::parse(&packet.text());
                self.execute_command(id, &command);
            }
            // Settings of this server do not change.
            Some(PacketKind::Xml) => self.reply(id, Err("Setting parameters failed")),
            _ => self.reply(id, Err("Parse error")),
        }
    }

    fn execute_command(&mut self, id: ClientId, command: &ClientCommand) {
        let has_no_settings = self.has_no_settings();
        let Some(client) = self.client(id) else { return };
        let minor = client.minor;
        match command {
            ClientCommand::Version(None) => self.reply(id, Ok(&format!("Version is 1.{minor}"))),
            ClientCommand::Version(Some(minor)) if VERSIONS.contains(minor) => {
                client.minor = *minor;
                self.reply(id, Ok(&format!("Version set to 1.{minor}")));
            }
            ClientCommand::Version(_) | ClientCommand::VersionOther => {
                self.reply(id, Err("Version NOT supported"));
            }
            ClientCommand::QtmVersion => {
                let text = format!("QTM Version is {}", self.version);
                self.reply(id, Ok(&text));
            }
            ClientCommand::ByteOrder => self.reply(id, Ok("Byte order is little endian")),
            ClientCommand::GetState => {
                let state = self.state;
                if let Some(client) = self.client(id) {
                    client.outbox.put(|out| put_event(state, out));
                }
            }
            ClientCommand::GetParameters(_) if has_no_settings => {
                self.reply(id, Err("Parameters not available"));
            }
            ClientCommand::GetParameters(request) => match self.settings.to_xml(minor, *request) {
                Some(xml) => {
                    if let Some(client) = self.client(id) {
                        client.outbox.put(|out| put_text(PacketKind::Xml, &xml, out));
                    }
                }
                None => self.reply(id, Err("Parameters not available")),
            },
            // Frames of earlier versions have another layout.
            ClientCommand::GetCurrentFrame(_) | ClientCommand::StreamFrames(_)
                if !VERSIONS.contains(&minor) =>
            {
                self.reply(id, Err("Version NOT supported"));
            }
            ClientCommand::GetCurrentFrame(components) => {
                client.one_frame = Some(*components);
                self.play_for(id);
            }
            ClientCommand::StreamFrames(request) => self.start_stream(id, request),
            ClientCommand::StreamFramesStop => client.stream = None,
            other => self.control(id, other),
        }
    }

    /// Whether a recorder receives nothing, so that nothing is known of its frames.
    fn has_no_settings(&self) -> bool {
        matches!(self.role, Role::Recorder { .. }) && self.measurement == Measurement::Closed
    }

    fn start_stream(&mut self, id: ClientId, request: &StreamRequest) {
        let number = self.n_streams + 1;
        let Some(client) = self.client(id) else { return };
        let own = client.peer.ip().to_canonical();
        let target = match request.datagrams {
            None => None,
            // Frames for a third machine would let anybody flood it.
            Some(DatagramTarget { address: Some(other), .. }) if other.to_canonical() != own => {
                return self.reply(id, Err("Parse error"));
            }
            Some(DatagramTarget { port, .. }) => {
                // With the interface of a link-local address.
                let mut to = client.peer;
                to.set_port(port);
                Some(to)
            }
        };
        let StreamRequest { rate, components, .. } = *request;
        if target.is_some() && self.is_too_large(components, rate) {
            return self.reply(id, Err(delivery::TOO_LARGE));
        }
        let Some(client) = self.client(id) else { return };
        client.stream =
            Some(Stream { rate, components, target, number, frames: 0, is_too_large: false });
        let starts = self.sample_starts();
        if let Some(client) = self.client(id) {
            client.samples_from = starts;
        }
        self.n_streams = number;
        self.play_for(id);
    }

    /// A client requests frames: an open file is played; without a measurement there are none.
    fn play_for(&mut self, id: ClientId) {
        match self.measurement {
            Measurement::File => {
                self.measurement = Measurement::PlayedFile;
                self.send_event(Event::RtFromFileStarted);
            }
            Measurement::Closed => {
                if let Some(client) = self.client(id) {
                    client.one_frame = None;
                    client.outbox.put(|out| put_packet(PacketKind::NoMoreData, out, |_| {}));
                }
            }
            Measurement::PlayedFile | Measurement::Live | Measurement::Capture => {}
        }
    }

    /// Replies to a command: with its success, or with an error.
    fn reply(&mut self, id: ClientId, text: Result<&str, &str>) {
        let Some(client) = self.client(id) else { return };
        match text {
            Ok(text) => client.outbox.put(|out| put_text(PacketKind::Command, text, out)),
            Err(text) => client.outbox.put(|out| put_text(PacketKind::Error, text, out)),
        }
    }
}

impl Client {
    /// It sends no packets, or reads none: it gets what waits, and is disconnected.
    fn set_out_of_step(&mut self) {
        self.is_out_of_step = true;
        (self.stream, self.one_frame) = (None, None);
    }

    /// Appends what the client did not ask for. One that reads nothing is disconnected, since it would miss it.
    fn put_unasked(&mut self, write: impl FnOnce(&mut Vec<u8>)) {
        if self.outbox.is_full() {
            self.set_out_of_step();
            self.frames_missed += self.outbox.frames_waiting() as u64;
            self.outbox.clear();
        } else if !self.is_out_of_step {
            self.outbox.put(write);
        }
    }
}

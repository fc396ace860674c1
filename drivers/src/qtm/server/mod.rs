//! The server's end of the protocol, sans-io: connections and their bytes go in, replies, frames and datagrams come out.
//!
//! It stands in for a QTM with one measurement. Who owns it makes the frames, and knows by [`QtmServer::is_playing`]
//! whether they are wanted.

mod control;

use std::net::SocketAddr;

use super::{
    command::{
        ClientCommand, Components, DatagramTarget, SettingsRequest, StreamRate, StreamRequest,
        VERSIONS, WELCOME,
    },
    frame::{ComponentToSend, FrameHeader, WireMarker, put_frame},
    packet::{Event, Packet, PacketKind, PacketReader, put_event, put_packet, put_text},
    settings::ServedSettings,
};

/// "Number of simultaneous connections is limited to 10."
pub const CLIENTS_MAX: usize = 10;

/// Bytes that wait for a client that does not read: a second of 200 markers at 1000 Hz. Beyond it frames are dropped whole,
/// and its commands wait.
const OUTPUT_BYTES_MAX: usize = 4 << 20;

/// Largest datagram of UDP over IPv4.
const DATAGRAM_BYTES_MAX: usize = 65_507;

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

#[derive(Debug)]
struct Client {
    id: ClientId,
    peer: SocketAddr,
    reader: PacketReader,
    /// Version in use, as the number after `1.`; 1 until it is set.
    minor: u32,
    stream: Option<Stream>,
    one_frame: Option<Components>,
    output: Vec<u8>,
    /// Bytes at the front of `output` that were sent.
    sent: usize,
    /// Bytes ever queued.
    queued: u64,
    is_out_of_step: bool,
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
}

/// A datagram to send.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Datagram {
    /// Its destination.
    pub to: SocketAddr,
    /// Its content.
    pub bytes: Vec<u8>,
}

/// A frame to send to all who want it.
#[derive(Debug, Clone, Copy)]
pub struct ServedFrame<'a> {
    /// Its number and time.
    pub header: FrameHeader,
    /// 2D frames lost, and out of sync, per thousand.
    pub rates: [u16; 2],
    /// The labelled markers, in the order of the labels.
    pub labelled: &'a [WireMarker],
    /// The unlabelled markers that are visible.
    pub unlabelled: &'a [WireMarker],
}

/// What became of a frame for the stream that was started first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// It is queued on the connection, up to this many bytes ever queued.
    Queued {
        /// The client.
        client: ClientId,
        /// Bytes ever queued for it, with this frame.
        end: u64,
    },
    /// Its datagrams are the next ones to take, so many.
    Datagrams(usize),
    /// The client reads too slowly, or the frame does not fit into datagrams.
    Dropped,
    /// The stream has another rate, and leaves it out.
    NotRequested,
    /// Nobody requests frames.
    NoStream,
}

/// A server.
#[derive(Debug)]
pub struct QtmServer {
    settings: ServedSettings,
    /// What it replies to `QTMVersion`.
    version: String,
    clients: Vec<Client>,
    next_client: u64,
    n_streams: u64,
    master: Option<ClientId>,
    measurement: Measurement,
    state: Event,
    datagrams: Vec<Datagram>,
    bytes: Vec<u8>,
}

impl QtmServer {
    /// A server with an open file, which it plays as soon as a client requests frames.
    #[must_use]
    pub fn new(settings: ServedSettings, version: String) -> Self {
        Self {
            settings,
            version,
            clients: Vec::new(),
            next_client: 0,
            n_streams: 0,
            master: None,
            measurement: Measurement::File,
            state: Event::RtFromFileStopped,
            datagrams: Vec::new(),
            bytes: Vec::new(),
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

    /// Accepts a client and greets it; `None` when there are [`CLIENTS_MAX`].
    pub fn connect(&mut self, peer: SocketAddr) -> Option<ClientId> {
        if self.clients.len() >= CLIENTS_MAX {
            return None;
        }
        let id = ClientId(self.next_client);
        self.next_client += 1;
        let mut client = Client {
            id,
            peer,
            reader: PacketReader::default(),
            minor: 1,
            stream: None,
            one_frame: None,
            output: Vec::new(),
            sent: 0,
            queued: 0,
            is_out_of_step: false,
        };
        client.put(|out| put_text(PacketKind::Command, WELCOME, out));
        self.clients.push(client);
        Some(id)
    }

    /// Forgets a client.
    pub fn disconnect(&mut self, id: ClientId) {
        self.clients.retain(|client| client.id != id);
        if self.master == Some(id) {
            self.master = None;
        }
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
        let mut is_out_of_step = client.is_out_of_step;
        while !is_out_of_step && self.pending(id).len() < OUTPUT_BYTES_MAX {
            match reader.next_packet() {
                Ok(Some(packet)) => self.execute(id, &packet),
                Ok(None) => break,
                Err(_) => is_out_of_step = true,
            }
        }
        let Some(client) = self.client(id) else { return };
        client.reader = reader;
        if is_out_of_step && !client.is_out_of_step {
            client.is_out_of_step = true;
            client.put(|out| put_text(PacketKind::Error, "Parse error", out));
        }
    }

    /// Whether a client's bytes may be read: it reads its own.
    #[must_use]
    pub fn may_receive(&self, id: ClientId) -> bool {
        let client = self.clients.iter().find(|client| client.id == id);
        client.is_some_and(|c| c.pending().len() < OUTPUT_BYTES_MAX && !c.is_out_of_step)
    }

    /// Whether a client sent no packets, and is to be disconnected once it has what is pending.
    #[must_use]
    pub fn is_out_of_step(&self, id: ClientId) -> bool {
        self.clients.iter().any(|client| client.id == id && client.is_out_of_step)
    }

    /// The bytes to send to a client next.
    #[must_use]
    pub fn pending(&self, id: ClientId) -> &[u8] {
        self.clients.iter().find(|client| client.id == id).map_or(&[], Client::pending)
    }

    /// The connection took the first `n` pending bytes.
    pub fn sent(&mut self, id: ClientId, n: usize) {
        if let Some(client) = self.client(id) {
            client.sent = (client.sent + n).min(client.output.len());
            if client.sent == client.output.len() {
                client.output.clear();
                client.sent = 0;
            } else if client.sent > client.output.len() / 2 {
                client.output.drain(..client.sent);
                client.sent = 0;
            }
            // Commands may have waited for this room.
            self.execute_received(id);
        }
    }

    /// Bytes ever sent to a client.
    #[must_use]
    pub fn bytes_sent(&self, id: ClientId) -> u64 {
        let client = self.clients.iter().find(|client| client.id == id);
        client.map_or(0, |client| client.queued - client.pending().len() as u64)
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

    /// Sends a frame to all who want it.
    pub fn frame(&mut self, frame: &ServedFrame<'_>) -> Delivery {
        let first = self.first_stream();
        let mut delivery = Delivery::NoStream;
        let (hz, mut clients) = (self.settings.frequency_hz, std::mem::take(&mut self.clients));
        for client in &mut clients {
            if let Some(components) = client.one_frame.take() {
                let components = components_of(frame, components);
                client.put(|out| put_frame(frame.header, &components, out));
            }
            let Some(stream) = &mut client.stream else { continue };
            stream.frames += 1;
            let stream = *stream;
            let outcome = if stream.rate.includes(stream.frames - 1, hz) {
                self.deliver(client, &stream, frame)
            } else {
                Delivery::NotRequested
            };
            if Some(stream.number) == first {
                delivery = outcome;
            }
        }
        self.clients = clients;
        delivery
    }

    fn deliver(
        &mut self,
        client: &mut Client,
        stream: &Stream,
        frame: &ServedFrame<'_>,
    ) -> Delivery {
        let components = components_of(frame, stream.components);
        let Some(to) = stream.target else {
            self.bytes.clear();
            put_frame(frame.header, &components, &mut self.bytes);
            if client.pending().len() + self.bytes.len() > OUTPUT_BYTES_MAX {
                return Delivery::Dropped;
            }
            client.put(|out| out.extend_from_slice(&self.bytes));
            return Delivery::Queued { client: client.id, end: client.queued };
        };
        let Some(parts) = divided(frame.header, &components) else { return Delivery::Dropped };
        let n = parts.len();
        self.datagrams.extend(parts.into_iter().map(|bytes| Datagram { to, bytes }));
        Delivery::Datagrams(n)
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
                Some(Some(to)) => self.datagrams.push(Datagram { to, bytes: bytes.clone() }),
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
                    client.put(|out| put_event(state, out));
                }
            }
            ClientCommand::GetParameters(SettingsRequest { general: false, markers: false }) => {
                self.reply(id, Err("Parameters not available"));
            }
            ClientCommand::GetParameters(SettingsRequest { general, markers }) => {
                let xml = self.settings.to_xml(minor, *general, *markers);
                if let Some(client) = self.client(id) {
                    client.put(|out| put_text(PacketKind::Xml, &xml, out));
                }
            }
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
            Some(DatagramTarget { port, .. }) => Some(SocketAddr::new(client.peer.ip(), port)),
        };
        let StreamRequest { rate, components, .. } = *request;
        client.stream = Some(Stream { rate, components, target, number, frames: 0 });
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
                    client.put(|out| put_packet(PacketKind::NoMoreData, out, |_| {}));
                }
            }
            Measurement::PlayedFile | Measurement::Live | Measurement::Capture => {}
        }
    }

    /// Replies to a command: with its success, or with an error.
    fn reply(&mut self, id: ClientId, text: Result<&str, &str>) {
        let Some(client) = self.client(id) else { return };
        match text {
            Ok(text) => client.put(|out| put_text(PacketKind::Command, text, out)),
            Err(text) => client.put(|out| put_text(PacketKind::Error, text, out)),
        }
    }
}

impl Client {
    fn put(&mut self, write: impl FnOnce(&mut Vec<u8>)) {
        let before = self.output.len();
        write(&mut self.output);
        self.queued += (self.output.len() - before) as u64;
    }

    /// Appends what the client did not ask for. One that reads nothing is disconnected, since it would miss it.
    fn put_unasked(&mut self, write: impl FnOnce(&mut Vec<u8>)) {
        if self.pending().len() >= OUTPUT_BYTES_MAX {
            self.is_out_of_step = true;
            self.output.clear();
            self.sent = 0;
        } else if !self.is_out_of_step {
            self.put(write);
        }
    }

    fn pending(&self) -> &[u8] {
        self.output.get(self.sent..).unwrap_or_default()
    }
}

impl StreamRate {
    /// Whether a stream has the frame `index` of a measurement at `hz`, counted from 0.
    fn includes(self, index: u64, hz: f64) -> bool {
        match self {
            Self::All => true,
            Self::Divisor(n) => index.is_multiple_of(u64::from(n)),
            Self::Frequency(wanted) if f64::from(wanted) < hz => {
                let due = |index: u64| (index as f64 * f64::from(wanted) / hz).floor();
                index == 0 || due(index) > due(index - 1)
            }
            Self::Frequency(_) => true,
        }
    }
}

fn components_of<'a>(frame: &ServedFrame<'a>, wanted: Components) -> Vec<ComponentToSend<'a>> {
    let component = |kind: super::frame::MarkerComponentKind| ComponentToSend {
        kind,
        rates: frame.rates,
        markers: if kind.is_labelled() { frame.labelled } else { frame.unlabelled },
    };
    wanted.markers().map(component).collect()
}

/// The datagrams of a frame: as many components in each as fit. `None` when one does not fit into any.
fn divided(header: FrameHeader, components: &[ComponentToSend<'_>]) -> Option<Vec<Vec<u8>>> {
    /// Packet header, time, number and count.
    const FRAME_HEADER_BYTES: usize = 24;
    let mut parts = Vec::new();
    let mut rest = components;
    loop {
        let mut bytes = FRAME_HEADER_BYTES;
        let fits = |component: &&ComponentToSend<'_>| {
            bytes += component.bytes();
            bytes <= DATAGRAM_BYTES_MAX
        };
        let n = rest.iter().take_while(fits).count();
        if n == 0 && !rest.is_empty() {
            return None;
        }
        let (now, later) = rest.split_at(n);
        let mut part = Vec::new();
        put_frame(header, now, &mut part);
        parts.push(part);
        if later.is_empty() {
            return Some(parts);
        }
        rest = later;
    }
}

//! OptiTrack systems through NatNet, both ends: `docs/natnet.md`.
//!
//! [`NatNetHost`] is the client's end, sans-io; it sends [line commands](crate::transport::polled). What a server says and
//! understands is in the same modules, so that both ends have one description of every message.

mod assets;
mod bring_up;
mod frame;
mod message;
mod model;
mod run;
mod sampled;
mod server;

use std::net::Ipv4Addr;

pub(crate) use self::bring_up::candidates;
pub use self::{
    assets::{AssetTable, ServedMarker, in_m},
    bring_up::find_servers,
    frame::{
        ACTIVE, ChannelSamples, FrameEnd, FrameOfData, FrameToSend, HAS_MODEL, MEASURED,
        MODEL_FILLED, MODELS_CHANGED, NatNetMarker, OCCLUDED, SampledData, SampledToSend,
        SetPositions, SetToSend, UNLABELLED, WireBody, put_frame,
    },
    message::{
        Bitstream, HEADER_BYTES, MESSAGE_BYTES_MAX, Message, MessageKind, ServerInfo, StreamInfo,
        put_connect, put_discovery, put_echo, put_message, put_text, read_echo_reply,
        read_wanted_version,
    },
    model::{Asset, AssetKind, MarkerSet, Model, ModelError, SampledDescription},
    server::{
        CLIENTS_MAX, DatagramContent, NatNetServer, ServedStream, ServerDatagram, ServerSettings,
        StreamReport,
    },
};
use self::{
    assets::{BodyTable, MarkerNames},
    run::NatNetRun,
    sampled::DeviceGroups,
};
use crate::{
    axis::FrameAxis,
    device::{
        Claim, Command, DeviceEvent, Family, Hello, LinkCounters, MarkerSample, Pong, Protocol,
        rate_reply,
    },
    marker_ids::{LabelTable, UnlabelledIds},
    transport::{
        DatagramSource, Transport,
        polled::{LineCommand, LineCommandSender, PolledTransport, Request, line_command_channel},
    },
    uri::{Location, NetworkAddress, StreamMode},
};

/// UDP port of commands.
pub const COMMAND_PORT: u16 = 1510;

/// UDP port of frames, unless the server states another.
pub const DATA_PORT: u16 = 1511;

/// The multicast group of frames, unless the server states another.
pub const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 42, 99);

pub(crate) const FAMILY: Family = Family {
    name: "natnet",
    claims: |candidate| match candidate.location {
        Location::Network(NetworkAddress { family: "natnet", .. }) => Claim::Certain,
        _ => Claim::No,
    },
    protocol: |location| {
        // A sender without a receiver, until `attach` connects the protocol to a line.
        let (sender, _) = line_command_channel();
        Box::new(NatNetHost::new(location, sender))
    },
};

const MS: u64 = 1_000_000;

/// Receiver of the decoded events.
type Events<'a> = &'a mut dyn FnMut(DeviceEvent<'_>);

/// Time after which a request is repeated: a datagram may be lost. Servers reply in milliseconds.
const REPEAT_NS: u64 = 250 * MS;

/// Time that the server has for a reply, with all repetitions.
const REPLY_TIMEOUT_NS: u64 = 3_000 * MS;

/// A server from which nothing has arrived for this long is asked whether it is there.
const CHECK_AFTER_NS: u64 = 2_000 * MS;

/// A stream without a frame for this long is joined again, and explained.
const NO_FRAMES_NS: u64 = 3_000 * MS;

/// How often a server that sends frames to this machine alone is told that it is still there: several times before any
/// server is known to give up.
const KEEP_ALIVE_NS: u64 = 1_000 * MS;

/// What the driver waits for while it is set up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum SetupStep {
    Connect,
    /// Whether the server changes to the newest bitstream that is known.
    Bitstream,
    FrameRate,
    Model,
    /// How many samples force plates and devices have in a frame.
    SamplesPerFrame,
    /// A frame, of which the samples are counted.
    FirstFrame,
}

/// State of the driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum HostPhase {
    /// Not begun.
    Off,
    /// Failed: nothing that arrives is decoded.
    Over,
    /// Asking for what has to be known.
    BringUp(SetupStep),
    /// Set up; frames are not wanted.
    Ready,
    /// Frames are wanted from the reply to a request on: what waits in front of it was sent before.
    Starting,
    /// Frames are wanted.
    Streaming,
}

/// Commands of the recorder that are not completed yet.
#[derive(Debug, Clone, Copy, Default)]
struct OpenCommands {
    hello: bool,
    start: bool,
    stop: bool,
    set_rate: Option<u32>,
    ping_ns: Option<u64>,
}

/// The [`Protocol`] of NatNet, sans-io.
#[derive(Debug)]
pub struct NatNetHost {
    line: LineCommandSender,
    /// The URI, for messages.
    name: String,
    /// How frames are to travel, if the user says so.
    wanted_mode: Option<StreamMode>,
    state: HostPhase,
    todo: OpenCommands,
    /// When the last request was sent, and when the step began that it belongs to.
    request_ns: u64,
    step_ns: u64,
    last_message_ns: u64,
    /// When the server was asked whether it is there, if it has not answered.
    check_ns: Option<u64>,
    /// Whether `Ping` alone was the request to connect that the server answered, or the last one.
    connects_by_ping: bool,
    keep_alive_ns: u64,
    counters: LinkCounters,
    hello: Hello,
    server: Option<ServerInfo>,
    /// The layout of frames and definitions, and the one with which the stream began.
    version: Bitstream,
    first_version: Bitstream,
    /// The group of frames; `None` when they are sent to this machine.
    source: Option<DatagramSource>,
    model: Model,
    names: MarkerNames,
    labels: LabelTable,
    unlabelled: UnlabelledIds,
    bodies: BodyTable,
    sampled: DeviceGroups,
    samples_per_frame: Option<u32>,
    /// When the definitions were requested during the stream, if they have not come.
    awaits_model_ns: Option<u64>,
    model_request_ns: u64,
    /// Whether frames came, on this line or an earlier one.
    had_frames: bool,
    samples: Vec<MarkerSample>,
    /// The frame, counted from 1, in which each labelled marker was last.
    seen: Vec<u64>,
    axis: FrameAxis,
    run: NatNetRun,
    /// What the server leaves open: one line each, for the take.
    remarks: Vec<String>,
    /// The system's remark about the line.
    line_remark: Option<String>,
    /// The end of the session, until the line has taken it.
    unsent_end: Option<LineCommand>,
}

impl NatNetHost {
    /// Makes a driver for a server at this location.
    #[must_use]
    pub fn new(location: &Location, line: LineCommandSender) -> Self {
        let address = match location {
            Location::Network(address) => address.clone(),
            other => NetworkAddress::new("natnet", &other.to_string(), 0),
        };
        Self {
            line,
            wanted_mode: address.mode,
            name: Location::Network(address).to_string(),
            state: HostPhase::Off,
            todo: OpenCommands::default(),
            request_ns: 0,
            step_ns: 0,
            last_message_ns: 0,
            check_ns: None,
            connects_by_ping: false,
            keep_alive_ns: 0,
            counters: LinkCounters::default(),
            hello: Hello::default(),
            server: None,
            version: Bitstream::NEWEST,
            first_version: Bitstream::NEWEST,
            source: None,
            model: Model::default(),
            names: MarkerNames::default(),
            labels: LabelTable::default(),
            unlabelled: UnlabelledIds::default(),
            bodies: BodyTable::default(),
            sampled: DeviceGroups::default(),
            samples_per_frame: None,
            awaits_model_ns: None,
            model_request_ns: 0,
            had_frames: false,
            samples: Vec::new(),
            seen: Vec::new(),
            axis: FrameAxis::default(),
            run: NatNetRun::default(),
            remarks: Vec::new(),
            line_remark: None,
            unsent_end: None,
        }
    }

    fn send(&mut self, message: &[u8]) {
        // None has more bytes than `put_connect` writes.
        if let Some(request) = Request::new(message) {
            self.line.send(LineCommand::Write { request, not_before_ns: 0 });
        }
    }

    fn send_text(&mut self, kind: MessageKind, text: &str) {
        let mut message = Vec::new();
        put_text(kind, text, &mut message);
        self.send(&message);
        self.request_ns = self.line.now_ns();
    }

    fn send_connect(&mut self) {
        if self.connects_by_ping {
            return self.send_text(MessageKind::Connect, "Ping");
        }
        let mut message = Vec::new();
        put_connect(None, &mut message);
        self.send(&message);
        self.request_ns = self.line.now_ns();
    }

    fn send_empty(&mut self, kind: MessageKind) {
        let mut message = Vec::new();
        put_message(kind, &mut message, |_| {});
        self.send(&message);
        self.request_ns = self.line.now_ns();
    }

    /// Ends the session with a message: trying again is of no use. But where frames came before, the recorder waits.
    fn fail(&mut self, message: &str) {
        if self.had_frames {
            return self.lose(message.to_owned());
        }
        self.end_session(LineCommand::Fail(format!("{}: {message}", self.name)));
    }

    /// Ends the session; the recorder waits for the server to come back.
    fn lose(&mut self, cause: String) {
        self.end_session(LineCommand::Lost(cause));
    }

    /// Nothing is decoded from here on. If the queue is full of requests, the end waits for the next read.
    fn end_session(&mut self, command: LineCommand) {
        self.state = HostPhase::Over;
        if !self.line.send(command.clone()) {
            self.unsent_end = Some(command);
        }
    }

    fn on_message(&mut self, message: &Message<'_>, on_event: Events<'_>) {
        let Some(kind) = message.kind else {
            self.counters.messages_unknown += 1;
            return;
        };
        self.counters.messages += 1;
        self.last_message_ns = self.line.now_ns();
        self.check_ns = None;
        match (kind, self.state) {
            (_, HostPhase::Off | HostPhase::Over) => {}
            (MessageKind::Frame, HostPhase::Streaming) => self.on_frame(message.body, on_event),
            (MessageKind::Frame, HostPhase::BringUp(SetupStep::FirstFrame)) => {
                self.on_first_frame(message.body);
            }
            (MessageKind::Model, HostPhase::Streaming) => self.on_new_model(message, on_event),
            (MessageKind::EchoReply, HostPhase::Streaming) => self.on_echo(message, on_event),
            (MessageKind::Model, HostPhase::Starting) => self.on_new_model(message, on_event),
            (MessageKind::Response, HostPhase::Starting) => {
                self.state = HostPhase::Streaming;
                self.report_started(on_event);
            }

            (MessageKind::DisconnectByTimeout, HostPhase::Streaming) => {
                self.note("the server took mocapd for gone: connecting again", on_event);
                self.send_connect();
            }
            (MessageKind::Text, HostPhase::Streaming) => {
                self.note(&format!("the server says: {}", message.text()), on_event);
            }
            (_, HostPhase::BringUp(step)) => self.on_bring_up_reply(step, kind, message),
            _ => {}
        }
    }

    fn on_echo(&mut self, message: &Message<'_>, on_event: Events<'_>) {
        match read_echo_reply(message.body) {
            Some((host_ns, ticks)) => {
                let device_ticks = self.in_ns(ticks);
                on_event(DeviceEvent::Pong(Pong { host_ns, device_ticks }));
            }
            None => self.counters.messages_damaged += 1,
        }
    }

    /// What is due by the clock.
    fn tick(&mut self, on_event: Events<'_>) {
        if let Some(command) = self.unsent_end.take() {
            self.end_session(command);
        }
        let now_ns = self.line.now_ns();
        let since = |at_ns: u64| now_ns.saturating_sub(at_ns);
        let is_overdue = since(self.request_ns) > REPEAT_NS;
        match self.state {
            HostPhase::BringUp(step) => {
                self.tick_bring_up(step, since(self.step_ns), is_overdue);
            }
            HostPhase::Starting if since(self.step_ns) > REPLY_TIMEOUT_NS => {
                self.lose("the server does not answer any more".to_owned());
            }
            HostPhase::Starting if is_overdue => self.send_fence(),
            HostPhase::Streaming => {
                self.tick_stream(on_event);
                self.check_silence();
            }
            _ => {}
        }
        let is_alone = self.server.is_some() && self.source.is_none();
        let is_up =
            matches!(self.state, HostPhase::Ready | HostPhase::Starting | HostPhase::Streaming);
        if is_alone && is_up && since(self.keep_alive_ns) > KEEP_ALIVE_NS {
            self.keep_alive_ns = now_ns;
            let request_ns = self.request_ns;
            self.send_empty(MessageKind::KeepAlive);
            // It has no reply that would be overdue.
            self.request_ns = request_ns;
        }
    }

    /// Asks a silent server whether it is there, and gives up one that is not.
    fn check_silence(&mut self) {
        let now_ns = self.line.now_ns();
        let silent_ns = now_ns.saturating_sub(self.last_message_ns);
        match self.check_ns {
            None if silent_ns > CHECK_AFTER_NS => {
                self.check_ns = Some(now_ns);
                self.send_connect();
            }
            Some(asked_ns) if now_ns.saturating_sub(asked_ns) > REPLY_TIMEOUT_NS => {
                let seconds = silent_ns / (1_000 * MS);
                self.lose(format!("the server has not answered for {seconds} s"));
            }
            Some(_) if now_ns.saturating_sub(self.request_ns) > 4 * REPEAT_NS => {
                self.send_connect();
            }
            _ => {}
        }
    }

    /// Asks for the definitions, which may have changed since the bring-up, and sends a request whose reply separates the
    /// frames of this stream from those that wait.
    fn send_fence(&mut self) {
        self.send_empty(MessageKind::RequestModel);
        self.send_text(MessageKind::Request, "FrameRate");
    }

    /// Completes pending commands as soon as the state permits.
    fn complete_commands(&mut self, on_event: Events<'_>) {
        if self.state != HostPhase::Ready {
            return;
        }
        if std::mem::take(&mut self.todo.hello) {
            on_event(DeviceEvent::Hello(&self.hello));
            on_event(DeviceEvent::Markers(&self.labels.markers()));
            on_event(DeviceEvent::Bodies(&self.bodies.infos));
            self.sampled.infos().for_each(|info| on_event(DeviceEvent::SampledGroup(info)));
        }
        if std::mem::take(&mut self.todo.stop) {
            self.report_end(on_event);
            on_event(DeviceEvent::EndOfStream(self.run.status()));
        }
        if let Some(rate_millihertz) = self.todo.set_rate.take() {
            on_event(rate_reply(rate_millihertz, self.hello.rate_millihertz));
        }
        if let Some(host_ns) = self.todo.ping_ns.take() {
            // Not the server's clock, which only a stream measures: it says that the server is there.
            on_event(DeviceEvent::Pong(Pong { host_ns, device_ticks: self.run.last_ticks }));
        }
        if std::mem::take(&mut self.todo.start) {
            self.run = NatNetRun::new(&self.hello);
            self.seen.clear();
            self.awaits_model_ns = None;
            self.model_request_ns = self.line.now_ns();
            self.state = HostPhase::Starting;
            self.step_ns = self.line.now_ns();
            if let Some(source) = self.source {
                self.line.send(LineCommand::Listen(source));
            }
            self.send_fence();
        }
    }

    /// Forgets what is remarked, but not what the system says of the line.
    fn reset_remarks(&mut self) {
        self.remarks.clear();
        self.remarks.extend(self.line_remark.clone());
    }
}

impl Protocol for NatNetHost {
    fn attach(&mut self, line: Box<dyn Transport>) -> Box<dyn Transport> {
        let (sender, receiver) = line_command_channel();
        self.line = sender;
        self.line_remark = line.remark();
        self.state = HostPhase::Off;
        self.todo = OpenCommands::default();
        self.server = None;
        self.check_ns = None;
        (self.last_message_ns, self.keep_alive_ns) = (0, 0);
        (self.awaits_model_ns, self.model_request_ns) = (None, 0);
        self.unsent_end = None;
        self.run = NatNetRun::default();
        Box::new(PolledTransport::new(line, receiver))
    }

    fn push(&mut self, bytes: &[u8], on_event: &mut dyn FnMut(DeviceEvent<'_>)) {
        self.counters.bytes += bytes.len() as u64;
        if !bytes.is_empty() {
            match Message::of(bytes) {
                Some(message) => self.on_message(&message, on_event),
                None => {
                    self.counters.messages_damaged += 1;
                    self.counters.bytes_skipped += bytes.len() as u64;
                }
            }
        }
        self.tick(on_event);
        self.complete_commands(on_event);
    }

    /// Appends an Echo for a ping during a stream; other requests are line commands, because they are repeated.
    fn command(&mut self, command: Command, out: &mut Vec<u8>) {
        match command {
            Command::Identify => {
                self.todo.hello = true;
                if !matches!(self.state, HostPhase::BringUp(_)) {
                    self.begin_bring_up();
                }
            }
            Command::Start { .. } => self.todo.start = true,
            Command::Stop => {
                self.todo.start = false;
                match self.state {
                    HostPhase::Starting | HostPhase::Streaming => {
                        self.todo.stop = true;
                        self.state = HostPhase::Ready;
                        self.line.send(LineCommand::StopListening);
                    }
                    HostPhase::Ready => self.todo.stop = true,
                    HostPhase::Off | HostPhase::Over | HostPhase::BringUp(_) => {}
                }
            }
            Command::SetRate(rate_millihertz) => self.todo.set_rate = Some(rate_millihertz),
            Command::Ping { host_ns } if self.state == HostPhase::Streaming => {
                if self.has_clock() {
                    put_echo(host_ns, None, out);
                }
            }
            Command::Ping { host_ns } => self.todo.ping_ns = Some(host_ns),
        }
    }

    fn checks_silence(&self) -> bool {
        true
    }

    fn counters(&self) -> LinkCounters {
        self.counters
    }
}

//! The driver of QTM: its state, and the commands of the recorder.

use super::{
    axis::FrameAxis,
    command::VERSIONS,
    groups::SampledGroups,
    labels::{LabelTable, UnlabelledIds},
    named_bodies::NamedBodies,
    packet::{OutOfStep, PACKET_BYTES_MAX, Packet, PacketKind, PacketReader, printable, put_text},
    stream_run::{Renewal, StreamRun},
};
use crate::{
    device::{Command, DeviceEvent, Hello, LinkCounters, MarkerSample, Pong, Protocol, rate_reply},
    transport::{
        Transport,
        polled::{LineCommand, LineCommandSender, PolledTransport, Request, line_command_channel},
    },
    uri::{Location, NetworkAddress},
};

pub(super) const MS: u64 = 1_000_000;

/// Receiver of the decoded events.
pub(super) type EventSink<'a> = &'a mut dyn FnMut(DeviceEvent<'_>);

/// Time that QTM has for a reply. It replies in milliseconds; settings of many cameras take some tens of them. Below the
/// 5 s after which the recorder gives up with a message that knows less.
const REPLY_TIMEOUT_NS: u64 = 3_000 * MS;

/// A connection on which nothing has arrived for this long is checked, which tells a silent QTM from an idle one.
const CHECK_AFTER_NS: u64 = 2_000 * MS;

/// Longest reply of one line: QTM's have some tens of bytes. A longer one is a sign that its size was misread.
const LINE_BYTES_MAX: usize = 4096;

/// How long frames that were sent before the end may still arrive in datagrams, which overtake the stream and each other.
const STRAGGLERS_NS: u64 = 250 * MS;

/// What the driver waits for while it is set up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    Welcome,
    /// Whether QTM speaks version `1.n`.
    Version(u32),
    QtmVersion,
    ByteOrder,
    State,
    General,
    Markers,
    Bodies,
    Analog,
    Force,
}

/// Connection of the driver to its QTM.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SessionState {
    /// Not begun.
    Off,
    /// Failed: nothing that arrives is decoded.
    Over,
    /// Asking for what has to be known.
    BringUp(Step),
    /// Set up; no frames requested.
    Ready,
    /// Frames are requested.
    Streaming,
    /// Frames are not requested any more; the last ones may still arrive until this time, if it is known.
    Ending(Option<u64>),
}

/// A request whose reply tells that what was sent before it has arrived. QTM answers in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fence {
    /// Behind a request for frames.
    Started,
    /// Behind the end of that request.
    Stopped,
    /// On a connection that was silent.
    Alive,
}

/// Commands of the recorder that are not completed yet.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct UnfinishedCommands {
    hello: bool,
    start: bool,
    stop: bool,
    set_rate: Option<u32>,
    ping_ns: Option<u64>,
}

/// The [`Protocol`] of QTM, sans-io.
#[derive(Debug)]
pub struct QtmHost {
    pub(super) line: LineCommandSender,
    /// The URI, for messages.
    pub(super) name: String,
    /// The UDP port to which frames go; `None` for TCP.
    pub(super) datagram_port: Option<u16>,
    pub(super) state: SessionState,
    todo: UnfinishedCommands,
    pub(super) fence: Option<Fence>,
    /// Requests for the byte order that were not replied to yet; the reply to the last of them is that of the fence.
    pub(super) fences_due: u32,
    /// When the last request was written, and when the last packet was complete.
    pub(super) request_ns: u64,
    last_packet_ns: u64,
    reader: PacketReader,
    pub(super) counters: LinkCounters,
    pub(super) hello: Hello,
    /// The version in use, as the number after `1.`.
    pub(super) minor: u32,
    pub(super) labels: LabelTable,
    pub(super) unlabelled: UnlabelledIds,
    pub(super) sampled: SampledGroups,
    pub(super) bodies: NamedBodies,
    pub(super) renewal: Renewal,
    /// Whether frames came, on this connection or an earlier one.
    pub(super) had_frames: bool,
    pub(super) samples: Vec<MarkerSample>,
    pub(super) axis: FrameAxis,
    pub(super) run: StreamRun,
    /// What QTM offers and the driver does not request, and what its settings leave open: one line each, for the take.
    pub(super) remarks: Vec<String>,
    /// QTM plays a file: when that is over, so is the stream.
    pub(super) plays_file: bool,
    /// The end of the connection, until the line has taken it.
    unsent_end: Option<LineCommand>,
}

impl QtmHost {
    /// Makes a driver for a QTM at this location. Its line takes the datagrams of frames at this port, if it has one.
    #[must_use]
    pub fn new(location: &Location, line: LineCommandSender, datagram_port: Option<u16>) -> Self {
        let address = match location {
            Location::Network(address) => address.clone(),
            other => NetworkAddress::new("qtm", &other.to_string(), 0),
        };
        Self {
            line,
            name: Location::Network(address).to_string(),
            datagram_port,
            state: SessionState::Off,
            todo: UnfinishedCommands::default(),
            fence: None,
            fences_due: 0,
            request_ns: 0,
            last_packet_ns: 0,
            reader: PacketReader::default(),
            counters: LinkCounters::default(),
            hello: Hello::default(),
            minor: *VERSIONS.end(),
            labels: LabelTable::default(),
            unlabelled: UnlabelledIds::default(),
            sampled: SampledGroups::default(),
            bodies: NamedBodies::default(),
            renewal: Renewal::default(),
            had_frames: false,
            samples: Vec::new(),
            axis: FrameAxis::default(),
            run: StreamRun::default(),
            remarks: Vec::new(),
            plays_file: false,
            unsent_end: None,
        }
    }

    /// Writes a command.
    pub(super) fn send(&mut self, command: &str) {
        let mut packet = Vec::new();
        put_text(PacketKind::Command, command, &mut packet);
        // The longest of them, StreamFrames, has 64 bytes.
        if let Some(request) = Request::new(&packet) {
            self.line.send(LineCommand::Write { request, not_before_ns: 0 });
        }
        self.request_ns = self.line.now_ns();
    }

    /// Writes a command whose reply tells that everything before it has arrived.
    pub(super) fn send_fence(&mut self, fence: Fence) {
        self.fence = Some(fence);
        self.fences_due += 1;
        self.send("ByteOrder");
    }

    /// Ends the session with a message: trying again is of no use. But where frames came before, the recorder waits.
    pub(super) fn fail(&mut self, message: &str) {
        if self.had_frames {
            return self.lose(message.to_owned());
        }
        self.end_connection(LineCommand::Fail(format!("{}: {message}", self.name)));
    }

    /// Ends the connection; the recorder waits for QTM to come back.
    pub(super) fn lose(&mut self, cause: String) {
        self.end_connection(LineCommand::Lost(cause));
    }

    /// Nothing is decoded from here on. If the queue is full of requests, the end waits for the next read.
    fn end_connection(&mut self, command: LineCommand) {
        self.state = SessionState::Over;
        if !self.line.send(command.clone()) {
            self.unsent_end = Some(command);
        }
    }

    /// Begins to end the stream: its last frames are waited for.
    pub(super) fn begin_end(&mut self) {
        let stragglers_ns = if self.datagram_port.is_some() { STRAGGLERS_NS } else { 0 };
        self.state = SessionState::Ending(Some(self.line.now_ns().saturating_add(stragglers_ns)));
    }

    fn receive(&mut self, bytes: &[u8], on_event: EventSink<'_>) {
        if self.line.is_datagram() {
            // Replies and events come by the stream: a datagram's sender can be forged.
            let is_stream = |packet: &Packet<'_>| {
                matches!(packet.kind, Some(PacketKind::Data | PacketKind::NoMoreData))
            };
            match Packet::of(bytes) {
                Some(packet) if is_stream(&packet) => self.on_packet(&packet, on_event),
                Some(_) => self.counters.messages_unknown += 1,
                None => {
                    self.counters.messages_damaged += 1;
                    self.counters.bytes_skipped += bytes.len() as u64;
                }
            }
            return;
        }
        // Taken out while its packets are handled.
        let mut reader = std::mem::take(&mut self.reader);
        reader.extend(bytes);
        // Before it begins, packets wait.
        while !matches!(self.state, SessionState::Off | SessionState::Over) {
            match reader.next_packet() {
                Ok(Some(packet)) => self.on_packet(&packet, on_event),
                Ok(None) => break,
                Err(problem) => {
                    self.counters.messages_damaged += 1;
                    self.out_of_step(problem);
                }
            }
        }
        let is_too_much = reader.waiting() > PACKET_BYTES_MAX;
        if self.state == SessionState::Over || (self.state == SessionState::Off && is_too_much) {
            self.counters.bytes_skipped += reader.waiting() as u64;
            reader.clear();
        }
        self.reader = reader;
    }

    /// What arrives is no packet, and nothing marks where the next one begins.
    fn out_of_step(&mut self, problem: OutOfStep) {
        if !matches!(self.state, SessionState::BringUp(_)) {
            self.lose("what it sends is no packet of the QTM RT protocol".to_owned());
            return;
        }
        self.fail(match problem {
            OutOfStep::BigEndian => {
                "this is QTM's port for the other byte order: give its little-endian port, the base port + 1 (22223 \
                 by default)"
            }
            OutOfStep::Text => {
                "what answers sends plain text, as QTM's Telnet port does (22221): give its little-endian port, the \
                 base port + 1 (22223 by default)"
            }
            OutOfStep::Size(_) => {
                "what answers does not speak the QTM RT protocol: check the host, and give QTM's little-endian port, \
                 the base port + 1 (22223 by default)"
            }
        });
    }

    fn on_packet(&mut self, packet: &Packet<'_>, on_event: EventSink<'_>) {
        let is_line = matches!(packet.kind, Some(PacketKind::Error | PacketKind::Command));
        if is_line && packet.body.len() > LINE_BYTES_MAX {
            self.counters.messages_damaged += 1;
            return self.out_of_step(OutOfStep::Size(packet.body.len() as u32));
        }
        self.counters.messages += 1;
        self.last_packet_ns = self.line.now_ns();
        match (packet.kind, self.state) {
            (None, _) => self.counters.messages_unknown += 1,
            (Some(PacketKind::Event), _) => self.on_state_change(packet, on_event),
            (Some(PacketKind::Data), SessionState::Streaming | SessionState::Ending(_)) => {
                self.on_data(packet.body, on_event);
            }
            (Some(PacketKind::NoMoreData), SessionState::Streaming) => {
                self.on_no_more_data(on_event);
            }
            (Some(PacketKind::Error | PacketKind::Command | PacketKind::Xml), _) => {
                self.on_reply(packet, on_event);
            }
            // Frames that were requested before this session, and files that nobody asked for.
            _ => {}
        }
    }

    fn on_reply(&mut self, packet: &Packet<'_>, on_event: EventSink<'_>) {
        match self.state {
            SessionState::BringUp(step) => self.on_bring_up_reply(step, packet),
            // An error before the stream is accepted is about its request.
            _ if packet.kind == Some(PacketKind::Xml)
                || self.renewal.is_awaited()
                    && packet.kind == Some(PacketKind::Error)
                    && self.fence != Some(Fence::Started) =>
            {
                self.on_renewed(packet, on_event);
            }
            _ if packet.kind == Some(PacketKind::Error) => self.on_error(packet, on_event),
            _ if is_byte_order(packet) => self.on_fence(on_event),
            _ => {}
        }
    }

    /// QTM refused a request during the stream.
    fn on_error(&mut self, packet: &Packet<'_>, on_event: EventSink<'_>) {
        let text = printable(&packet.text());
        match (self.state, self.fence) {
            // Replies come in order: what was sent before the fence is the request for frames.
            (SessionState::Streaming, Some(Fence::Started)) => {
                self.fail(&format!("QTM does not send frames ({text}): check its version"));
            }
            _ => self.note_refusal(&text, on_event),
        }
    }

    /// Reports a request that was refused, once in a stream.
    pub(super) fn note_refusal(&mut self, text: &str, on_event: EventSink<'_>) {
        if !std::mem::replace(&mut self.run.is_refusal_noted, true) {
            self.note(&format!("QTM refuses a request: {text}"), on_event);
        }
    }

    fn on_fence(&mut self, on_event: EventSink<'_>) {
        self.fences_due = self.fences_due.saturating_sub(1);
        if self.fences_due > 0 {
            return;
        }
        match self.fence.take() {
            Some(Fence::Started) => self.report_started(on_event),
            Some(Fence::Stopped) => self.begin_end(),
            // A silent QTM does not get here.
            Some(Fence::Alive) => self.note_idle(on_event),
            None => {}
        }
    }

    /// What is due by the clock.
    fn tick(&mut self, on_event: EventSink<'_>) {
        if let Some(command) = self.unsent_end.take() {
            self.end_connection(command);
        }
        if matches!(self.state, SessionState::Streaming | SessionState::Ending(_)) {
            self.release_excess(on_event);
        }
        let now_ns = self.line.now_ns();
        if self.run.is_part_overdue(now_ns) {
            self.pass_open(on_event);
        }
        let since_request_ns = now_ns.saturating_sub(self.request_ns);
        let silent_ns = now_ns.saturating_sub(self.last_packet_ns);
        match self.state {
            SessionState::BringUp(step) if since_request_ns > REPLY_TIMEOUT_NS => {
                self.on_bring_up_timeout(step);
            }
            SessionState::Ending(Some(until_ns)) if now_ns >= until_ns => self.end(on_event),
            SessionState::Streaming if silent_ns > CHECK_AFTER_NS => match self.fence {
                None => self.send_fence(Fence::Alive),
                Some(_) if since_request_ns > REPLY_TIMEOUT_NS => {
                    let seconds = silent_ns / (1_000 * MS);
                    self.lose(format!("QTM has not answered for {seconds} s"));
                }
                Some(_) => {}
            },
            _ => {}
        }
    }

    /// Completes pending commands as soon as the state permits.
    fn complete_commands(&mut self, on_event: EventSink<'_>) {
        if self.state != SessionState::Ready {
            return;
        }
        if std::mem::take(&mut self.todo.hello) {
            on_event(DeviceEvent::Hello(&self.hello));
            on_event(DeviceEvent::Markers(&self.labels.markers()));
            let bodies = self.bodies.infos();
            if !bodies.is_empty() {
                on_event(DeviceEvent::Bodies(&bodies));
            }
            self.sampled.infos().for_each(|group| on_event(DeviceEvent::SampledGroup(group)));
        }
        if std::mem::take(&mut self.todo.stop) {
            on_event(DeviceEvent::EndOfStream(self.run.status()));
        }
        if let Some(rate_millihertz) = self.todo.set_rate.take() {
            on_event(rate_reply(rate_millihertz, self.hello.rate_millihertz));
        }
        if let Some(host_ns) = self.todo.ping_ns.take() {
            // QTM has no request for its time: the pong only says that it is there.
            on_event(DeviceEvent::Pong(Pong { host_ns, device_ticks: self.run.last_us }));
        }
        if std::mem::take(&mut self.todo.start) {
            self.start_stream();
        }
    }
}

/// Whether a packet is the reply to `ByteOrder`.
pub(super) fn is_byte_order(packet: &Packet<'_>) -> bool {
    packet.kind == Some(PacketKind::Command) && packet.text().starts_with("Byte order is")
}

impl Protocol for QtmHost {
    fn attach(&mut self, line: Box<dyn Transport>) -> Box<dyn Transport> {
        let (sender, receiver) = line_command_channel();
        self.line = sender;
        self.datagram_port = line.datagram_port();
        self.state = SessionState::Off;
        self.todo = UnfinishedCommands::default();
        (self.fence, self.fences_due) = (None, 0);
        self.renewal = Renewal::default();
        self.last_packet_ns = 0;
        self.reader.clear();
        self.unsent_end = None;
        self.run = StreamRun::default();
        Box::new(PolledTransport::new(line, receiver))
    }

    fn push(&mut self, bytes: &[u8], on_event: &mut dyn FnMut(DeviceEvent<'_>)) {
        self.counters.bytes += bytes.len() as u64;
        if !bytes.is_empty() {
            self.receive(bytes, on_event);
        }
        self.tick(on_event);
        self.complete_commands(on_event);
    }

    /// Appends nothing: requests are line commands.
    fn command(&mut self, command: Command, _: &mut Vec<u8>) {
        match command {
            Command::Identify => {
                self.todo.hello = true;
                match self.state {
                    SessionState::Off | SessionState::Over => self.begin_bring_up(),
                    // By contract a device is stopped after its Hello, which has what is true then.
                    SessionState::Ready => self.ask_again(),
                    SessionState::Streaming => {
                        self.send("StreamFrames Stop");
                        self.ask_again();
                    }
                    SessionState::BringUp(_) | SessionState::Ending(_) => {}
                }
            }
            Command::Start { .. } => self.todo.start = true,
            Command::Stop => {
                self.todo.start = false;
                match self.state {
                    SessionState::Streaming => {
                        self.state = SessionState::Ending(None);
                        self.send("StreamFrames Stop");
                        self.send_fence(Fence::Stopped);
                    }
                    SessionState::Ready => self.todo.stop = true,
                    SessionState::Off
                    | SessionState::Over
                    | SessionState::BringUp(_)
                    | SessionState::Ending(_) => {}
                }
            }
            Command::SetRate(rate_millihertz) => self.todo.set_rate = Some(rate_millihertz),
            // Frames show that QTM is there.
            Command::Ping { .. } if self.state == SessionState::Streaming => {}
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

//! Streams of the Lab Streaming Layer (LSL): `docs/lsl.md`.
//!
//! Discovery, the handshake of a feed and time probes are those of the crate `labstream-core`, sans-io; bounds and what
//! becomes of samples are here. The [transport](crate::transport::lsl) finds the streams and merges what they send into one
//! stream of [messages](StreamMessage), which [`LslHost`] decodes.

mod decoder;
mod description;
mod envelope;
mod layout;
mod outlet;
mod values;

use self::{
    decoder::{EventReceiver, StreamDecoder},
    envelope::NextMessage,
    layout::TICK_HZ,
};
pub(crate) use self::{
    description::clean,
    envelope::{DATA_HEADER_BYTES, data_header},
};
pub use self::{
    description::{
        ChannelDescription, DESCRIPTION_BYTES_MAX, Publisher, StreamDescription, StreamInfo,
        hostname,
    },
    envelope::{LineRequest, MessageReader, StreamMessage, put_message},
    layout::{GroupLayout, Layout, MarkerColumns, StreamRole},
    outlet::{INLETS_MAX, InletId, InletReport, OutletServer},
    values::ValueFormat,
};
use crate::{
    device::{
        Claim, Command, DeviceEvent, Family, LinkBudget, LinkCounters, Pong, Protocol, Status,
    },
    transport::{
        Transport,
        polled::{LineCommand, LineCommandSender, PolledTransport, line_command_channel},
    },
    uri::{Location, STREAMS_MAX, StreamQuery},
};

pub(crate) const FAMILY: Family = Family {
    name: "lsl",
    claims: |candidate| match candidate.location {
        Location::Streams(_) => Claim::Certain,
        _ => Claim::No,
    },
    protocol: |location| {
        let query = match location {
            Location::Streams(query) => query.clone(),
            _ => StreamQuery::default(),
        };
        Box::new(LslHost::new(query))
    },
};

/// How far a time stamp may lie behind LSL's clock, and ahead of it, in seconds, to be one of that clock: senders may hold
/// samples back, and compensate for delays.
const BEHIND_MAX_S: f64 = 60.0;
const AHEAD_MAX_S: f64 = 0.5;

/// Notes about streams that come and go: one that does so again and again must fill neither the take nor the screen.
const STREAM_NOTES_MAX: u32 = 64;

/// Time stamps that are off LSL's clock in so many messages, and for so long, are of another one: a backlog is read in less.
const OFF_MESSAGES: u32 = 8;
const OFF_NS: u64 = 2_000_000_000;

/// The clock of time stamps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum StampClock {
    /// None was judged on this connection.
    Unknown,
    /// LSL's, for which time probes ask.
    Lsl,
    /// Off LSL's clock in so many messages, since this time.
    Doubted { n: u32, since_ns: u64 },
    /// Another one, as long as the connection lasts.
    Other,
}

impl StampClock {
    fn judged(self, is_of_clock: bool, read_ns: u64) -> Self {
        match self {
            Self::Other => Self::Other,
            _ if is_of_clock => Self::Lsl,
            Self::Unknown | Self::Lsl => Self::Doubted { n: 1, since_ns: read_ns },
            Self::Doubted { n, since_ns } => {
                let n = n.saturating_add(1);
                let is_other = n >= OFF_MESSAGES && read_ns.saturating_sub(since_ns) >= OFF_NS;
                if is_other { Self::Other } else { Self::Doubted { n, since_ns } }
            }
        }
    }
}

/// What the streams are doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// Their descriptions have not arrived, or the connection is over.
    Off,
    /// Described, and no samples requested.
    Ready,
    /// Samples were requested.
    Starting,
    Streaming,
    /// The feeds are being closed.
    Ending,
}

/// Commands of the recorder that are not completed yet.
#[derive(Debug, Clone, Copy, Default)]
struct AwaitedCommands {
    hello: bool,
    stop: bool,
    set_rate: Option<u32>,
    ping_ns: Option<u64>,
}

/// The [`Protocol`] of LSL's streams, sans-io.
#[derive(Debug)]
pub struct LslHost {
    query: StreamQuery,
    line: LineCommandSender,
    state: State,
    todo: AwaitedCommands,
    reader: MessageReader,
    counters: LinkCounters,
    descriptions: Vec<StreamDescription>,
    layout: Option<Layout>,
    decoders: Vec<StreamDecoder>,
    /// Seconds of the sender's clock less those of the host's, by the last time probe.
    offset_s: Option<f64>,
    /// The clock of the frames' time stamps.
    clock: StampClock,
    /// Why the connection cannot go on, until the line has taken it.
    unsent_end: Option<String>,
    /// Whether the remarks about the streams were made.
    has_remarked: bool,
    stream_notes: u32,
    /// Whether each stream was lost, and is not back.
    lost: [bool; STREAMS_MAX],
    /// Infinite positions of streams that were described otherwise.
    not_finite_before: u64,
}

impl LslHost {
    /// Makes a driver for these streams.
    #[must_use]
    pub fn new(query: StreamQuery) -> Self {
        // A sender without a receiver, until `attach` connects the protocol to a line.
        let (line, _) = line_command_channel();
        Self {
            query,
            line,
            state: State::Off,
            todo: AwaitedCommands::default(),
            reader: MessageReader::default(),
            counters: LinkCounters::default(),
            descriptions: Vec::new(),
            layout: None,
            decoders: Vec::new(),
            offset_s: None,
            clock: StampClock::Unknown,
            unsent_end: None,
            has_remarked: false,
            stream_notes: 0,
            lost: [false; STREAMS_MAX],
            not_finite_before: 0,
        }
    }

    fn receive(&mut self, bytes: &[u8], on_event: EventReceiver<'_>) {
        let mut reader = std::mem::take(&mut self.reader);
        reader.extend(bytes);
        loop {
            match reader.next_message() {
                NextMessage::Whole(message) => {
                    self.counters.messages += 1;
                    self.on_message(message, on_event);
                }
                NextMessage::Unknown => self.counters.messages_unknown += 1,
                NextMessage::Partial => break,
            }
        }
        self.reader = reader;
    }

    fn on_message(&mut self, message: StreamMessage<'_>, on_event: EventReceiver<'_>) {
        match message {
            StreamMessage::Description { xml, .. } => match StreamDescription::parse(xml) {
                Ok(description) if self.descriptions.len() < STREAMS_MAX => {
                    self.descriptions.push(description);
                }
                _ => self.counters.messages_damaged += 1,
            },
            StreamMessage::Found => self.on_found(),
            StreamMessage::Feed { stream, is_big_endian } => {
                if let Some(decoder) = self.decoders.get_mut(usize::from(stream)) {
                    decoder.open(is_big_endian);
                }
                if self.lost.get_mut(usize::from(stream)).is_some_and(std::mem::take) {
                    self.note_stream(stream, "is back", on_event);
                }
            }
            StreamMessage::Changed { stream } => {
                let text = "is back with another rate or other channels: start again to record it";
                self.note_stream(stream, text, on_event);
            }
            StreamMessage::Lost { stream } => {
                if let Some(is_lost) = self.lost.get_mut(usize::from(stream)) {
                    *is_lost = true;
                }
                if let Some(decoder) = self.decoders.get_mut(usize::from(stream)) {
                    // What cannot be decoded any more was reported when it came.
                    decoder.flush(on_event).ok();
                    decoder.close();
                }
                let has_frames = |decoder: &StreamDecoder| decoder.has_frames();
                // Without frames the line ends the connection, with its cause.
                if !self.decoders.get(usize::from(stream)).is_some_and(has_frames) {
                    let text = "is over: the recording goes on without it until it is back";
                    self.note_stream(stream, text, on_event);
                }
            }
            StreamMessage::Started => self.on_started(on_event),
            StreamMessage::Data { stream, read_ns, bytes } => {
                self.on_data(stream, read_ns, bytes, on_event);
            }
            StreamMessage::Time { host_ns, sender_s, read_ns } => {
                self.on_time((host_ns, read_ns), sender_s, on_event);
            }
            StreamMessage::Ended => self.on_ended(on_event),
        }
    }

    /// All streams are described. Those that are as before an outage go on where they were.
    fn on_found(&mut self) {
        // The line refuses streams that cannot be recorded, with the reason.
        let Ok(layout) = Layout::new(&self.query, &self.descriptions) else { return };
        let (of_frames, every) = layout.frames;
        let mut before = std::mem::take(&mut self.decoders).into_iter();
        for (at, (role, of)) in layout.roles.iter().zip(&self.descriptions).enumerate() {
            let frame_every = (at == of_frames).then_some(every);
            self.decoders.push(match before.next() {
                Some(mut same) if same.is_for(role, frame_every, of) => {
                    same.close();
                    same
                }
                other => {
                    self.not_finite_before += other.map_or(0, |decoder| decoder.not_finite);
                    StreamDecoder::new(role.clone(), frame_every, of)
                }
            });
        }
        self.not_finite_before += before.map(|decoder| decoder.not_finite).sum::<u64>();
        self.layout = Some(layout);
        self.state = State::Ready;
    }

    /// A note about a stream that comes or goes.
    fn note_stream(&mut self, stream: u8, what: &str, on_event: EventReceiver<'_>) {
        if self.stream_notes < STREAM_NOTES_MAX {
            self.stream_notes += 1;
            let name = self.descriptions.get(usize::from(stream)).map_or("", |of| &of.name);
            on_event(DeviceEvent::Note(&format!("the stream '{name}' {what}")));
        }
    }

    fn on_started(&mut self, on_event: EventReceiver<'_>) {
        let Some(layout) = self.layout.as_ref().filter(|_| self.state == State::Starting) else {
            return;
        };
        self.state = State::Streaming;
        self.decoders.iter_mut().for_each(StreamDecoder::begin);
        on_event(DeviceEvent::Started(LinkBudget {
            needed_bytes_per_s: 0,
            available_bytes_per_s: u64::MAX,
            rate_fits_millihertz: layout.hello.rate_millihertz,
        }));
        if !std::mem::replace(&mut self.has_remarked, true) {
            layout.remarks.iter().for_each(|remark| on_event(DeviceEvent::Note(remark)));
        }
    }

    fn on_data(&mut self, stream: u8, read_ns: u64, bytes: &[u8], on_event: EventReceiver<'_>) {
        if !matches!(self.state, State::Streaming | State::Ending) {
            return;
        }
        let Some(decoder) = self.decoders.get_mut(usize::from(stream)) else {
            self.counters.messages_unknown += 1;
            return;
        };
        if !decoder.is_open() {
            // Of a stream that was given up.
            self.counters.bytes_skipped += bytes.len() as u64;
            return;
        }
        if let Err(cause) = decoder.receive(bytes, (read_ns, self.line.now_ns()), on_event) {
            self.counters.messages_damaged += 1;
            self.counters.bytes_skipped += bytes.len() as u64;
            self.lose(stream, &cause, on_event);
            return;
        }
        self.check_clock(usize::from(stream), read_ns, on_event);
    }

    /// Judges whether the time stamps that the last bytes completed are of the clock that time probes ask for.
    fn check_clock(&mut self, stream: usize, read_ns: u64, on_event: EventReceiver<'_>) {
        let Some(decoder) = self.decoders.get_mut(stream) else { return };
        let (Some(offset_s), Some(time_s)) = (self.offset_s, decoder.newest_s()) else { return };
        let behind_s = read_ns as f64 * 1e-9 + offset_s - time_s;
        let is_of_clock = (-AHEAD_MAX_S..=BEHIND_MAX_S).contains(&behind_s);
        let what = if decoder.has_frames() {
            self.clock = self.clock.judged(is_of_clock, read_ns);
            "the take's clock is fitted to arrivals alone"
        } else {
            "its samples have times of another clock than the frames"
        };
        let is_other = !is_of_clock && (!decoder.has_frames() || self.clock == StampClock::Other);
        if is_other && !std::mem::replace(&mut decoder.is_clock_noted, true) {
            let name = self.descriptions.get(stream).map_or("", |of| &of.name);
            let text = format!(
                "the time stamps of the stream '{name}' are {behind_s:.1} s behind LSL's clock: they are of another clock, and {what}"
            );
            on_event(DeviceEvent::Note(&text));
        }
    }

    fn on_time(
        &mut self,
        (host_ns, read_ns): (u64, u64),
        sender_s: f64,
        on_event: EventReceiver<'_>,
    ) {
        self.offset_s = Some(sender_s - u64::midpoint(host_ns, read_ns) as f64 * 1e-9);
        let ticks = (sender_s * TICK_HZ as f64).round();
        // Not before it is known that frames are of this clock.
        if self.state == State::Streaming
            && self.clock == StampClock::Lsl
            && (0.0..u64::MAX as f64).contains(&ticks)
        {
            on_event(DeviceEvent::Pong(Pong { host_ns, device_ticks: ticks as u64 }));
        }
    }

    fn on_ended(&mut self, on_event: EventReceiver<'_>) {
        if self.state != State::Ending {
            return;
        }
        self.state = State::Ready;
        for decoder in &mut self.decoders {
            // What cannot be decoded any more was reported when it came.
            decoder.flush(on_event).ok();
        }
        self.note_counts(on_event);
        on_event(DeviceEvent::EndOfStream(self.status()));
    }

    /// The final counters. LSL numbers no samples: these are frames by their time stamps.
    fn status(&self) -> Status {
        let frames = self.decoders.iter().find(|decoder| decoder.has_frames());
        Status {
            frames_produced: frames.map_or(0, StreamDecoder::produced),
            frames_dropped: frames.map_or(0, StreamDecoder::missing),
            temperature_c_100: i16::MIN,
        }
    }

    fn note_counts(&self, on_event: EventReceiver<'_>) {
        for (decoder, of) in self.decoders.iter().zip(&self.descriptions) {
            let counts = decoder.counts;
            let notes = [
                (counts.rounded, "values that float32 does not have were rounded"),
                (
                    counts.bad_stamps,
                    "time stamps are negative or no numbers: the one before stands in",
                ),
                (counts.cut_texts, "texts were longer than an event can be, and were cut off"),
            ];
            for (n, what) in notes.into_iter().filter(|(n, _)| *n > 0) {
                on_event(DeviceEvent::Note(&format!("the stream '{}': {n} {what}", of.name)));
            }
        }
    }

    /// Gives a stream up whose bytes cannot be decoded. Without frames the recorder waits for the streams to come back.
    fn lose(&mut self, stream: u8, cause: &str, on_event: EventReceiver<'_>) {
        let Some(decoder) = self.decoders.get_mut(usize::from(stream)) else { return };
        if !decoder.has_frames() {
            decoder.close();
            let text = format!("cannot be read: {cause}; the recording goes on without it");
            self.note_stream(stream, &text, on_event);
            return;
        }
        let name = self.descriptions.get(usize::from(stream)).map_or("", |of| &of.name);
        self.end_connection(format!("the stream '{name}' cannot be read: {cause}"));
    }

    fn end_connection(&mut self, cause: String) {
        self.state = State::Off;
        if !self.line.send(LineCommand::Lost(cause.clone())) {
            self.unsent_end = Some(cause);
        }
    }

    /// What is due by the clock.
    fn tick(&mut self, on_event: EventReceiver<'_>) {
        if let Some(cause) = self.unsent_end.take() {
            self.end_connection(cause);
        }
        let now_ns = self.line.now_ns();
        for decoder in &mut self.decoders {
            if decoder.is_waiting_since(now_ns) {
                decoder.flush(on_event).ok();
            }
        }
    }

    /// Completes pending commands as soon as the state permits.
    fn complete_commands(&mut self, on_event: EventReceiver<'_>) {
        let Some(layout) = self.layout.as_ref().filter(|_| self.state == State::Ready) else {
            return;
        };
        if std::mem::take(&mut self.todo.hello) {
            on_event(DeviceEvent::Hello(&layout.hello));
            on_event(DeviceEvent::Markers(&layout.markers));
            layout.groups().for_each(|group| on_event(DeviceEvent::SampledGroup(group)));
        }
        let rate_millihertz = layout.hello.rate_millihertz;
        match self.todo.set_rate.take() {
            Some(wanted) if wanted == rate_millihertz => on_event(DeviceEvent::RateSet(wanted)),
            Some(_) => on_event(DeviceEvent::Refused(LinkBudget {
                needed_bytes_per_s: 0,
                available_bytes_per_s: u64::MAX,
                rate_fits_millihertz: rate_millihertz,
            })),
            None => {}
        }
        if std::mem::take(&mut self.todo.stop) {
            on_event(DeviceEvent::EndOfStream(self.status()));
        }
        if let Some(host_ns) = self.todo.ping_ns.take() {
            // Before the start the pong only says that the streams are there.
            on_event(DeviceEvent::Pong(Pong { host_ns, device_ticks: 0 }));
        }
    }
}

impl Protocol for LslHost {
    fn attach(&mut self, line: Box<dyn Transport>) -> Box<dyn Transport> {
        let (sender, receiver) = line_command_channel();
        self.line = sender;
        self.state = State::Off;
        self.todo = AwaitedCommands::default();
        self.reader.clear();
        self.descriptions.clear();
        self.offset_s = None;
        self.clock = StampClock::Unknown;
        self.lost = [false; STREAMS_MAX];
        self.unsent_end = None;
        Box::new(PolledTransport::new(line, receiver))
    }

    fn push(&mut self, bytes: &[u8], on_event: &mut dyn FnMut(DeviceEvent<'_>)) {
        self.counters.bytes += bytes.len() as u64;
        if !bytes.is_empty() {
            self.receive(bytes, on_event);
        }
        let not_finite: u64 = self.decoders.iter().map(|decoder| decoder.not_finite).sum();
        self.counters.samples_not_finite = self.not_finite_before + not_finite;
        self.tick(on_event);
        self.complete_commands(on_event);
    }

    fn command(&mut self, command: Command, out: &mut Vec<u8>) {
        match command {
            Command::Identify => {
                self.todo.hello = true;
                // By contract a device is stopped after its Hello.
                if matches!(self.state, State::Starting | State::Streaming) {
                    self.state = State::Ending;
                    LineRequest::End.put(out);
                }
            }
            Command::Start { .. } => {
                if matches!(self.state, State::Ready | State::Starting) {
                    self.state = State::Starting;
                    LineRequest::Begin.put(out);
                }
            }
            Command::Stop => match self.state {
                State::Starting | State::Streaming => {
                    self.state = State::Ending;
                    LineRequest::End.put(out);
                }
                State::Ready => self.todo.stop = true,
                State::Off | State::Ending => {}
            },
            Command::SetRate(rate_millihertz) => self.todo.set_rate = Some(rate_millihertz),
            Command::Ping { .. }
                if self.state == State::Streaming && self.clock == StampClock::Other => {}
            Command::Ping { host_ns } if self.state == State::Streaming => {
                LineRequest::Probe { host_ns }.put(out);
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

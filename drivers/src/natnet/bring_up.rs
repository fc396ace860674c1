//! From a network to a server that is ready: the search for servers; then versions, rate, definitions and samples, one
//! request at a time, each repeated until its reply comes.

use std::{io, net::SocketAddrV4, time::Duration};

use super::{
    COMMAND_PORT, DATA_PORT, GROUP, HostPhase, MS, NatNetHost, REPLY_TIMEOUT_NS, SetupStep,
    assets::MarkerNames,
    frame::FrameOfData,
    message::{Bitstream, Message, MessageKind, ServerInfo, put_discovery, put_message},
    model::{AssetKind, Model, ModelError},
    sampled::{DeviceGroups, SAMPLES_PER_FRAME_MAX},
};
use crate::{
    axis::FrameAxis,
    bytes::WireValue,
    device::{BODIES_MAX, Candidate, Hello},
    marker_ids::{LABELS_MAX, UNLABELLED_MAX},
    transport::{
        DatagramSource,
        network::search,
        polled::{LineCommand, Request},
    },
    uri::{Location, NetworkAddress, StreamMode},
};

/// Frame rates that cameras have, in Hz: more than the fastest at a reduced image.
const RATE_HZ: std::ops::RangeInclusive<f32> = 1.0..=100_000.0;

/// Ticks of a second, as the driver reports them.
const TICK_HZ: u64 = 1_000_000_000;

/// Time that the definitions have: a server that is busy with them lets the names come during the stream.
const MODEL_TIMEOUT_NS: u64 = 2_000 * MS;

/// Time that a frame has of which the samples are counted: several frames at the lowest rates.
const FIRST_FRAME_TIMEOUT_NS: u64 = 500 * MS;

impl NatNetHost {
    /// Asks the server who it is. Everything that was known is asked again: it may have changed.
    pub(super) fn begin_bring_up(&mut self) {
        self.reset_remarks();
        self.line.send(LineCommand::StopListening);
        self.ask(SetupStep::Connect);
    }

    fn ask(&mut self, step: SetupStep) {
        self.state = HostPhase::BringUp(step);
        self.step_ns = self.line.now_ns();
        if step == SetupStep::FirstFrame
            && let Some(source) = self.source
        {
            self.line.send(LineCommand::Listen(source));
        }
        self.send_request(step);
    }

    fn send_request(&mut self, step: SetupStep) {
        match step {
            SetupStep::Connect => self.send_connect(),
            SetupStep::Bitstream => {
                self.send_text(MessageKind::Request, &format!("Bitstream,{}", Bitstream::NEWEST));
            }
            SetupStep::FrameRate => self.send_text(MessageKind::Request, "FrameRate"),
            SetupStep::Model => self.send_empty(MessageKind::RequestModel),
            SetupStep::SamplesPerFrame => {
                self.send_text(MessageKind::Request, "AnalogSamplesPerMocapFrame");
            }
            SetupStep::FirstFrame => {}
        }
    }

    /// Repeats the request of a step whose reply is overdue, or gives it up.
    pub(super) fn tick_bring_up(&mut self, step: SetupStep, waited_ns: u64, is_overdue: bool) {
        let timeout_ns = match step {
            SetupStep::Model => MODEL_TIMEOUT_NS,
            SetupStep::FirstFrame => FIRST_FRAME_TIMEOUT_NS,
            _ => REPLY_TIMEOUT_NS,
        };
        if waited_ns <= timeout_ns {
            if is_overdue {
                // Servers that read only one of the two forms answer each second request.
                self.connects_by_ping ^= step == SetupStep::Connect;
                self.send_request(step);
            }
            return;
        }
        match step {
            SetupStep::Connect => self.fail(&match self.line.stranger() {
                Some(stranger) => format!(
                    "no NatNet server answers at this address, but datagrams come from {}: use natnet:{}",
                    stranger.ip(),
                    stranger.ip()
                ),
                None => format!(
                "no NatNet server answers: start Motive on that machine, switch on streaming in its Data Streaming pane, \
                 choose the network to this machine under Local Interface, and let its firewall pass UDP port \
                 {COMMAND_PORT}; local= names another interface of this machine"
                ),
            }),
            SetupStep::Bitstream => self.ask(SetupStep::FrameRate),
            SetupStep::FrameRate => self.fail(
                "the server answers, but does not state its frame rate: it may be busy with another task; try again, or \
                 restart it",
            ),
            SetupStep::Model => {
                self.remarks.push(
                    "the server has not sent its definitions yet: markers get their names when it does".to_owned(),
                );
                self.model = Model::default();
                self.model_request_ns = self.line.now_ns();
                self.use_model();
                self.after_model();
            }
            SetupStep::SamplesPerFrame => self.ask(SetupStep::FirstFrame),
            SetupStep::FirstFrame => self.set_ready(None),
        }
    }

    pub(super) fn on_bring_up_reply(
        &mut self,
        step: SetupStep,
        kind: MessageKind,
        message: &Message<'_>,
    ) {
        match (step, kind) {
            (SetupStep::Connect, MessageKind::ServerInfo) => match ServerInfo::read(message.body) {
                Some(server) => self.on_server_info(server),
                None => self.counters.messages_damaged += 1,
            },
            (SetupStep::Bitstream, MessageKind::Response | MessageKind::Unrecognized) => {
                // Servers reply with 0, or with the version.
                let is_granted = kind == MessageKind::Response
                    && (message.body == [0; 4] || message.text().starts_with("Bitstream"));
                if !is_granted {
                    self.remarks.push(format!(
                        "the server does not change its bitstream to {}: what is unknown in its frames is skipped",
                        Bitstream::NEWEST
                    ));
                }
                self.ask(SetupStep::FrameRate);
            }
            (SetupStep::FrameRate, MessageKind::Response) => {
                let rate_hz = f32::decode(message.body).filter(|hz| RATE_HZ.contains(hz));
                if let Some(rate_hz) = rate_hz {
                    self.hello.rate_millihertz = (f64::from(rate_hz) * 1000.0).round() as u32;
                    self.ask(SetupStep::Model);
                }
            }
            (SetupStep::Model, MessageKind::Model) => {
                self.read_model(message.body);
                self.use_model();
                self.after_model();
            }
            (SetupStep::SamplesPerFrame, MessageKind::Response) => {
                // A late reply to an earlier request is a float, which is a large number here.
                let n_samples = u32::decode(message.body);
                if let Some(n) = n_samples.filter(|n| *n <= SAMPLES_PER_FRAME_MAX) {
                    // Motive states 0 while it takes none.
                    self.samples_per_frame = Some(n).filter(|n| *n > 0);
                    self.ask(SetupStep::FirstFrame);
                }
            }
            (SetupStep::SamplesPerFrame, MessageKind::Unrecognized) => {
                self.ask(SetupStep::FirstFrame);
            }
            _ => {}
        }
    }

    fn on_server_info(&mut self, server: ServerInfo) {
        let stated = server.bitstream;
        if stated < Bitstream::OLDEST || stated.major > Bitstream::NEWEST.major {
            let (oldest, newest) = (Bitstream::OLDEST, Bitstream::NEWEST);
            self.fail(&format!(
                "{} {} sends bitstream {stated}, and mocapd reads {oldest} to {newest}: install another version of it",
                server.name,
                server.app_version_text()
            ));
            return;
        }
        let stream = server.stream;
        let states_multicast = stream.is_none_or(|stream| stream.is_multicast);
        let is_multicast = match self.wanted_mode {
            Some(mode) => mode == StreamMode::Multicast,
            None => states_multicast,
        };
        if is_multicast != states_multicast {
            let [set, wanted] = [states_multicast, is_multicast]
                .map(|multicast| if multicast { "multicast" } else { "unicast" });
            self.remarks.push(format!(
                "the server streams by {set}: where mode={wanted} brings no frames, change Transmission Type in Motive, or \
                 leave it out"
            ));
        }
        let group = stream.map_or(GROUP, |stream| stream.group);
        // Some servers that do not use multicast state none.
        let group = if group.is_multicast() { group } else { GROUP };
        let port = stream.map(|stream| stream.port).filter(|port| *port > 0).unwrap_or(DATA_PORT);
        if !is_multicast {
            // So that the server stops to send when the line is closed.
            let mut message = Vec::new();
            put_message(MessageKind::Disconnect, &mut message, |_| {});
            let goodbye = Request::new(&message).into_iter().collect();
            self.line.send(LineCommand::Goodbye(goodbye));
        }
        self.source = is_multicast.then_some(DatagramSource { group: Some(group), port });
        self.version = stated.min(Bitstream::NEWEST);
        self.server = Some(server);
        if stated == self.version {
            return self.ask(SetupStep::FrameRate);
        }
        if is_multicast {
            self.remarks.push(format!(
                "the server sends bitstream {stated}, which is read as {}: what is unknown in it is skipped",
                self.version
            ));
            return self.ask(SetupStep::FrameRate);
        }
        self.ask(SetupStep::Bitstream);
    }

    /// Reads definitions in the layout that is in use, or in another one that fits.
    pub(super) fn read_model(&mut self, body: &[u8]) {
        let others =
            [Bitstream::NEWEST, Bitstream::new(4, 0), Bitstream::new(3, 1), Bitstream::OLDEST];
        let first = Model::read(body, self.version);
        let found = match first {
            Ok(model) => Ok(model),
            Err(error) => {
                others.into_iter().find_map(|version| Model::read(body, version).ok()).ok_or(error)
            }
        };
        match found {
            Ok(model) => self.model = model,
            Err(error) => {
                self.counters.messages_damaged += 1;
                let version = self.version;
                self.remarks.push(match error {
                    ModelError::UnknownType(kind) => format!(
                        "the definitions of bitstream {version} have a description of the unknown type {kind}: markers \
                         have no names"
                    ),
                    ModelError::Layout => format!(
                        "the definitions are not those of bitstream {version}: markers have no names"
                    ),
                });
            }
        }
    }

    /// Takes over the names of the definitions.
    pub(super) fn use_model(&mut self) {
        let (names, labels) = MarkerNames::new(&self.model);
        self.names = names;
        self.bodies.update(&self.model);
        let n_excess = self.labels.update(&labels);
        if n_excess > 0 {
            self.remarks.push(format!(
                "{n_excess} labels are too many: their markers are recorded without names"
            ));
        }
    }

    fn after_model(&mut self) {
        let has_bones = |kind| matches!(kind, AssetKind::Skeleton | AssetKind::Trained);
        let n_skeletons = self.model.assets.iter().filter(|asset| has_bones(asset.kind)).count();
        if n_skeletons > 0 {
            self.remarks.push(format!(
                "{n_skeletons} skeletons or trained marker sets: their markers are recorded, and not their bones"
            ));
        }
        if self.bodies.n_excess > 0 {
            let n = self.bodies.n_excess;
            self.remarks
                .push(format!("{n} rigid bodies are left out: at most {BODIES_MAX} are recorded"));
        }
        if self.model.n_unknown > 0 {
            let n = self.model.n_unknown;
            self.remarks.push(format!("{n} descriptions of a type that mocapd does not know"));
        }
        self.samples_per_frame = None;
        // Before 3.0 force plates are not described.
        match (self.version.has_ticks(), self.model.sampled.is_empty()) {
            (true, true) => self.set_ready(None),
            (true, false) => self.ask(SetupStep::SamplesPerFrame),
            (false, _) => self.ask(SetupStep::FirstFrame),
        }
    }

    /// A frame arrived, whose samples tell how many there are.
    pub(super) fn on_first_frame(&mut self, body: &[u8]) {
        let body = body.to_vec();
        if let Some(frame) = self.read_frame(&body) {
            self.set_ready(Some(&frame));
        }
    }

    /// Whether the server's clock can be asked for.
    pub(super) fn has_clock(&self) -> bool {
        self.clock_hz().is_some()
    }

    fn clock_hz(&self) -> Option<u64> {
        let stream = self.server.as_ref()?.stream?;
        (self.version.has_ticks() && stream.clock_hz > 0).then_some(stream.clock_hz)
    }

    fn set_ready(&mut self, frame: Option<&FrameOfData<'_>>) {
        let rate_millihertz = self.hello.rate_millihertz;
        self.sampled =
            DeviceGroups::new(&self.model.sampled, self.samples_per_frame, frame, rate_millihertz);
        self.remarks.extend(self.sampled.remarks());
        let (model, version) = self.server.as_ref().map_or_else(Default::default, |server| {
            (server.name.clone(), server.app_version_text())
        });
        self.hello = Hello {
            model,
            firmware: format!("{version}, NatNet {}", self.version),
            rate_millihertz,
            rate_min_millihertz: rate_millihertz,
            rate_max_millihertz: rate_millihertz,
            tick_hz: TICK_HZ,
            markers_max: (self.labels.n_labels().min(LABELS_MAX) + UNLABELLED_MAX) as u16,
            ..Hello::default()
        };
        self.axis = FrameAxis::new(rate_millihertz);
        self.line.send(LineCommand::StopListening);
        self.first_version = self.version;
        self.state = HostPhase::Ready;
    }

    /// The server's clock in nanoseconds: a take states one rate of the clock, and a server that comes back may have another.
    pub(super) fn in_ns(&self, ticks: u64) -> u64 {
        let hz = u128::from(self.clock_hz().unwrap_or(TICK_HZ));
        u64::try_from(u128::from(ticks) * u128::from(TICK_HZ) / hz).unwrap_or(u64::MAX)
    }
}

/// Time that servers have for a reply: they take milliseconds.
const WAIT: Duration = Duration::from_millis(300);

/// The servers that answer a search at a port.
///
/// # Errors
/// The system's, when no socket can be opened.
pub fn find_servers(port: u16) -> io::Result<Vec<(SocketAddrV4, ServerInfo)>> {
    let mut message = Vec::new();
    put_discovery("mocapd", [0, 1, 0, 0], Bitstream::NEWEST, &mut message);
    let replies = search(|_| message.clone(), port, WAIT)?;
    let server = |(from, bytes): &(SocketAddrV4, Vec<u8>)| {
        let message = Message::of(bytes)?;
        let info = (message.kind == Some(MessageKind::ServerInfo))
            .then(|| ServerInfo::read(message.body))??;
        Some((*from, info))
    };
    Ok(replies.iter().filter_map(server).collect())
}

/// The servers on the networks of this machine as devices. A machine without a network has none.
pub(crate) fn candidates() -> Vec<Candidate> {
    let servers = find_servers(COMMAND_PORT).unwrap_or_default();
    let candidate = |(from, info): (SocketAddrV4, ServerInfo)| {
        let host = from.ip().to_string();
        let address = NetworkAddress::new("natnet", &host, COMMAND_PORT);
        let (app, version) = (info.app_version_text(), info.bitstream);
        Candidate {
            product: Some(format!("{} {app}, NatNet {version}", info.name)),
            ..Candidate::at(Location::Network(address))
        }
    };
    servers.into_iter().map(candidate).collect()
}

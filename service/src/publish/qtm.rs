//! A server of the QTM RT protocol for what is recorded (docs/qtm.md).

mod samples;

use std::{
    io,
    net::{SocketAddr, UdpSocket},
    sync::Arc,
    time::{Duration, Instant},
};

use anyhow::{Context, anyhow};
use crossbeam_channel::{Receiver, Sender, bounded};
use mocapd_acquire::{
    pipeline::{TappedBatch, TappedFrame},
    threads,
};
use mocapd_drivers::{
    device::{Pose, PoseStatus},
    qtm::{
        BodySettings, CLIENTS_MAX, ClientId, DISCOVERY_PORT, OwnerCommand, OwnerRequest, QtmServer,
        ServedBody, ServedFrame, ServedSettings, discovery_reply, read_discovery_request,
    },
    transport::network::{
        responder::Responder,
        server::{StreamServer, TcpServer},
    },
};
use mocapd_take::poses::{self, PoseState};

use self::samples::SampleMap;
use super::{
    LivePublisher, PublishedDevice, PublishedFeed, PublisherName, RunningPublisher, WantedKinds,
    clients::{ClientLimits, NotAccepted},
    markers::{MarkerMap, header_of},
    runner,
};
use crate::{
    config::QtmPublishConfig,
    control::{Control, EventFeed, Mark, Request, Start},
    http::Token,
    status::{PublishStatus, PublishedClient, ServiceEvent, ServiceEventKind, State},
};

/// The QTM RT protocol.
pub const QTM: PublisherName = PublisherName { id: "qtm", title: "QTM" };

/// What the server says to be.
const VERSION: &str = concat!("mocapd ", env!("CARGO_PKG_VERSION"));

/// A client that has set no version for so long makes room for another one: programs set it first, and get no frames before.
const VERSION_TIMEOUT: Duration = Duration::from_secs(10);

/// How long clients have to take what is pending when the service stops.
const DRAIN: Duration = Duration::from_millis(500);

/// Opens the port and publishes.
///
/// # Errors
/// The password file cannot be used; the message says what to do.
pub fn open(
    config: &QtmPublishConfig,
    feed: PublishedFeed,
    control: &Arc<dyn Control>,
) -> anyhow::Result<RunningPublisher> {
    let password = match &config.password_file {
        Some(file) if config.control => {
            Some(Token::read(file).context("publish.qtm.password_file")?.into_text())
        }
        _ => None,
    };
    let (requests, requested) = bounded(CLIENTS_MAX);
    let (replies, replied) = bounded(CLIENTS_MAX);
    let has_control = password.is_some();
    let (listen, config, owner) = (config.listen, config.clone(), Arc::clone(control));
    let open = move || {
        let sockets = Sockets::open(config.listen)?;
        let server =
            QtmServer::of_recorder(VERSION.to_owned(), config.clients_max, password.clone());
        let limits = ClientLimits::new(QTM, &config.allow_from, config.clients_max);
        Ok(QtmPublisher {
            sockets,
            server: AllowedServer::new(server, limits),
            map: MarkerMap::default(),
            samples: SampleMap::default(),
            bodies: Vec::new(),
            events: owner.events(),
            rig: owner.status().rig,
            control: Arc::clone(&owner),
            requests: requests.clone(),
            replied: replied.clone(),
            n_executing: 0,
        })
    };
    let mut running = runner::start(feed, control, listen, open)?;
    if has_control {
        let control = Arc::clone(control);
        let execute = move || execute_requests(control.as_ref(), &requested, &replies);
        running.add_thread(threads::spawn("mocapd-qtm-ctl", execute)?);
    }
    Ok(running)
}

/// What the publisher listens at and sends from.
#[derive(Debug)]
struct Sockets {
    clients: TcpServer<ClientId>,
    datagrams: UdpSocket,
    /// Answers searches, unless another program uses their port alone.
    responder: Option<Responder>,
}

impl Sockets {
    fn open(listen: SocketAddr) -> anyhow::Result<Self> {
        let clients = TcpServer::open(listen).map_err(|error| {
            anyhow!(
                "cannot publish at publish.qtm.listen = {listen}: {error}; `ss -tlpn` shows which program uses the port, \
                 `ip address` lists the addresses of this machine"
            )
        })?;
        // With the interface of a link-local address.
        let mut any_port = listen;
        any_port.set_port(0);
        let datagrams = UdpSocket::bind(any_port).context("cannot open a UDP socket")?;
        datagrams.set_nonblocking(true).context("cannot make a UDP socket non-blocking")?;
        Ok(Self { clients, datagrams, responder: Responder::open(DISCOVERY_PORT).ok() })
    }
}

/// The server, and who may connect to it.
#[derive(Debug)]
struct AllowedServer {
    server: QtmServer,
    limits: ClientLimits,
    /// Messages about clients that left, for the events.
    news: Vec<String>,
    /// Frames that clients were sent which are gone.
    sent_to_gone: u64,
    /// Those that are connected, and since when.
    connected: Vec<(ClientId, Instant)>,
}

impl AllowedServer {
    fn new(server: QtmServer, limits: ClientLimits) -> Self {
        Self { server, limits, news: Vec::new(), sent_to_gone: 0, connected: Vec::new() }
    }

    /// Where there are as many clients as there may be, disconnects the first one that has set no version.
    fn make_room(&mut self, now: Instant) {
        if self.server.reports().len() < self.limits.clients_max() {
            return;
        }
        let is_silent = |(id, since): &&(ClientId, Instant)| {
            let report = self.server.report(*id);
            now.saturating_duration_since(*since) >= VERSION_TIMEOUT
                && report.is_some_and(|report| report.minor.is_none())
        };
        let Some((id, _)) = self.connected.iter().find(is_silent).copied() else { return };
        if let Some(report) = self.server.report(id) {
            self.news.push(format!(
                "QTM client {} disconnected: it has set no version for {} s, and another client connects",
                report.peer,
                VERSION_TIMEOUT.as_secs()
            ));
        }
        self.disconnect(id);
    }
}

impl StreamServer for AllowedServer {
    type Id = ClientId;

    fn connect(&mut self, peer: SocketAddr) -> Result<ClientId, Vec<u8>> {
        if self.limits.is_allowed(peer.ip()) {
            self.make_room(Instant::now());
        }
        self.limits.check(peer, self.server.reports().len()).map_err(|refusal| match refusal {
            NotAccepted::Address => QtmServer::exclusion(),
            NotAccepted::Full => QtmServer::refusal(),
        })?;
        let id = self.server.connect(peer).ok_or_else(QtmServer::refusal)?;
        self.connected.push((id, Instant::now()));
        Ok(id)
    }

    fn disconnect(&mut self, id: ClientId) {
        self.connected.retain(|(connected, _)| *connected != id);
        let Some(report) = self.server.disconnect(id) else { return };
        self.sent_to_gone += report.frames_sent;
        if report.frames_missed > 0 || report.samples_missed > 0 {
            self.news.push(format!(
                "QTM client {} has left: it read too slowly, and missed {} of {} frames, and {} analog samples or forces \
                 of others",
                report.peer,
                report.frames_missed,
                report.frames_missed + report.frames_sent,
                report.samples_missed
            ));
        }
    }

    fn receive(&mut self, id: ClientId, bytes: &[u8]) {
        self.server.receive(id, bytes);
    }

    fn may_receive(&self, id: ClientId) -> bool {
        self.server.may_receive(id)
    }

    fn is_over(&self, id: ClientId) -> bool {
        // Or was disconnected to make room.
        self.server.is_out_of_step(id)
            || self.connected.iter().all(|(connected, _)| *connected != id)
    }

    fn pending(&self, id: ClientId) -> &[u8] {
        self.server.pending(id)
    }

    fn sent(&mut self, id: ClientId, n: usize) {
        self.server.sent(id, n);
    }
}

/// The server with its sockets, and the owner of the measurement.
#[derive(Debug)]
struct QtmPublisher {
    sockets: Sockets,
    server: AllowedServer,
    map: MarkerMap,
    samples: SampleMap,
    /// The bodies of a frame.
    bodies: Vec<ServedBody>,
    events: EventFeed,
    control: Arc<dyn Control>,
    /// The name of the rig.
    rig: String,
    requests: Sender<OwnerRequest>,
    replied: Receiver<OwnerReply>,
    /// Commands that are being executed.
    n_executing: usize,
}

impl LivePublisher for QtmPublisher {
    fn address(&self) -> SocketAddr {
        self.sockets.clients.address()
    }

    fn set_device(&mut self, device: Option<&PublishedDevice>) {
        let settings = device.map(|device| {
            self.map = MarkerMap::default();
            self.map.follow(device.header.channels.len(), &device.progress);
            self.samples = SampleMap::new(device);
            self.settings(device)
        });
        self.server.server.set_source(settings);
        // A take may have begun already; later ones are events.
        let is_recording = device.is_some() && self.control.status().state == State::Recording;
        self.server.server.set_capturing(is_recording);
    }

    fn wanted(&self) -> WantedKinds {
        let server = &self.server.server;
        WantedKinds { frames: server.wants_frames(), samples: server.wants_samples() }
    }

    fn wants_poses(&self) -> bool {
        self.server.server.wants_bodies()
    }

    fn frame(&mut self, device: &PublishedDevice, frame: &TappedFrame) {
        self.server.server.left_out(frame.frames_left_out);
        if self.map.follow(frame.markers.len(), &device.progress) {
            let settings = self.settings(device);
            self.server.server.set_source(Some(settings));
        }
        self.map.fill(&frame.markers);
        self.bodies.clear();
        self.bodies.extend(frame.poses.iter().map(wire_body));
        // Frames have all bodies of the settings, also without poses.
        self.bodies.resize(device.bodies.len(), ServedBody::LOST);
        let tick_hz = device.header.device.as_ref().map_or(1_000_000, |device| device.tick_hz);
        let header = header_of(frame, tick_hz);
        let MarkerMap { labelled, unlabelled, .. } = &self.map;
        let (bodies, lacks_bodies) = (&self.bodies[..], !frame.wants_poses);
        let frame =
            ServedFrame { header, labelled, unlabelled, bodies, lacks_bodies, rates: [0; 2] };
        self.server.server.frame(&frame);
    }

    fn samples(&mut self, _: &PublishedDevice, batch: &TappedBatch) {
        self.samples.add(batch, &mut self.server.server);
    }

    fn exchange(&mut self, timeout: Duration) -> io::Result<()> {
        self.pass_requests();
        self.follow_takes();
        self.send_datagrams();
        self.answer_searches();
        self.sockets.clients.exchange(&mut self.server);
        self.sockets.clients.wait(&mut self.server, timeout)
    }

    fn take_news(&mut self) -> Vec<String> {
        let mut news = self.server.limits.take_news();
        news.append(&mut self.server.news);
        news.extend(
            self.server
                .server
                .take_wrong_passwords()
                .into_iter()
                .map(|peer| format!("QTM client {peer} gave a wrong password for control")),
        );
        news.extend(self.server.server.take_too_large().into_iter().map(|peer| {
            format!(
                "QTM client {peer} misses frames that do not fit into datagrams of UDP: it is to request them by TCP, or fewer \
                 components or samples"
            )
        }));
        news
    }

    fn status(&self) -> PublishStatus {
        let AllowedServer { server, limits, sent_to_gone, .. } = &self.server;
        let clients: Vec<_> = server.reports().into_iter().map(PublishedClient::from).collect();
        let sent: u64 = clients.iter().map(|client| client.frames_sent).sum();
        PublishStatus {
            protocol: QTM.id.to_owned(),
            listen: self.address().to_string(),
            clients_max: limits.clients_max(),
            clients_refused: limits.refused(),
            frames_sent: sent + sent_to_gone,
            frames_missed: server.frames_missed(),
            clients,
            ..PublishStatus::default()
        }
    }

    fn close(mut self) {
        self.send_datagrams();
        self.sockets.clients.finish(&mut self.server, DRAIN);
    }
}

impl QtmPublisher {
    /// What the settings of the device state now.
    fn settings(&self, device: &PublishedDevice) -> ServedSettings {
        let body = |body: &mocapd_drivers::device::BodyInfo| BodySettings {
            name: body.name.clone(),
            ..BodySettings::default()
        };
        let (analog, plates) = self.samples.devices();
        ServedSettings {
            bodies: device.bodies.iter().map(body).collect(),
            analog,
            plates,
            ..self.map.settings(&device.header)
        }
    }

    /// Tells clients of takes that began or ended, after the reply to a command that caused it.
    fn follow_takes(&mut self) {
        while self.n_executing == 0
            && let Some(event) = self.events.next(Duration::ZERO)
        {
            if let Some(is_recording) = is_recording(&event) {
                self.server.server.set_capturing(is_recording);
            }
        }
        if self.n_executing == 0 && self.events.missed() > 0 {
            let is_recording = self.control.status().state == State::Recording;
            self.server.server.set_capturing(is_recording);
        }
    }

    /// Answers those who may connect, with the name of the rig.
    fn answer_searches(&mut self) {
        let port = self.address().port();
        let Self { sockets, server, rig, .. } = self;
        let Some(responder) = &mut sockets.responder else { return };
        responder.serve(|from, question| {
            let reply_port = read_discovery_request(question)?;
            let is_allowed = server.limits.is_allowed(from);
            is_allowed.then(|| (reply_port, discovery_reply(rig, VERSION, port)))
        });
    }

    fn send_datagrams(&mut self) {
        let server = &mut self.server.server;
        for datagram in server.take_datagrams() {
            let is_sent = self.sockets.datagrams.send_to(&datagram.bytes, datagram.to).is_ok();
            server.datagram_sent(&datagram, is_sent);
        }
    }

    /// Passes commands of the client in control on, and replies to those that were executed.
    fn pass_requests(&mut self) {
        for request in self.server.server.take_requests() {
            let client = request.client;
            // A client has one request at a time, so that there is room.
            match self.requests.try_send(request) {
                Ok(()) => self.n_executing += 1,
                Err(_) => self.server.server.complete(client, Err("The recorder is busy")),
            }
        }
        while let Ok(OwnerReply { client, reply }) = self.replied.try_recv() {
            self.n_executing = self.n_executing.saturating_sub(1);
            let reply = reply.as_ref().map(|text| *text).map_err(String::as_str);
            self.server.server.complete(client, reply);
        }
    }
}

/// A body as QTM sends it: without a pose it is lost.
fn wire_body(pose: &poses::Pose) -> ServedBody {
    let poses::Pose { state, position_mm, quaternion, residual_mm } = *pose;
    let status = if state == PoseState::Tracked { PoseStatus::Tracked } else { PoseStatus::Lost };
    ServedBody::of_pose(&Pose { body: 0, status, position_mm, quaternion, residual_mm })
}

/// Whether a take is recorded after an event; `None` if it says nothing of that. Other events may overtake those of takes.
fn is_recording(event: &ServiceEvent) -> Option<bool> {
    match event.kind {
        ServiceEventKind::TakeStarted => Some(true),
        ServiceEventKind::TakeStopped => Some(false),
        _ => None,
    }
}

impl From<mocapd_drivers::qtm::ClientReport> for PublishedClient {
    fn from(report: mocapd_drivers::qtm::ClientReport) -> Self {
        Self {
            address: report.peer.to_string(),
            version: report.minor.map_or_else(String::new, |minor| format!("1.{minor}")),
            transport: if report.by_datagrams { "udp" } else { "tcp" }.to_owned(),
            stream: String::new(),
            is_streaming: report.is_streaming,
            is_in_control: report.is_master,
            frames_sent: report.frames_sent,
            frames_missed: report.frames_missed,
            ..Self::default()
        }
    }
}

/// A reply to a client's command.
#[derive(Debug)]
struct OwnerReply {
    client: ClientId,
    reply: Result<&'static str, String>,
}

/// Executes commands of clients, which wait for frames and disks, one at a time.
fn execute_requests(
    control: &dyn Control,
    requests: &Receiver<OwnerRequest>,
    replies: &Sender<OwnerReply>,
) {
    for OwnerRequest { client, peer, command } in requests {
        let reply = match command {
            OwnerCommand::Start => {
                let notes = Some(format!("started by the QTM client {}", peer.ip().to_canonical()));
                let start = Start { notes, ..Start::default() };
                control.start(&start).map(|_| "Starting measurement")
            }
            OwnerCommand::Stop => control.stop(&Request::default()).map(|_| "Stopping measurement"),
            OwnerCommand::Mark(text) => {
                control.mark(&Mark { text, ..Mark::default() }).map(|_| "Event set")
            }
        };
        let reply = reply.map_err(|refusal| refusal.message);
        if replies.send(OwnerReply { client, reply }).is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use mocapd_drivers::qtm::{PacketKind, put_text};

    use super::*;

    #[test]
    fn a_client_that_sets_no_version_makes_room_after_ten_seconds() {
        let server = QtmServer::of_recorder("mocapd".to_owned(), 2, None);
        let mut server = AllowedServer::new(server, ClientLimits::new(QTM, &[], 2));
        let peer = |port| SocketAddr::from(([127, 0, 0, 1], port));
        let first = server.connect(peer(1)).unwrap();
        let silent = server.connect(peer(2)).unwrap();
        let mut version = Vec::new();
        put_text(PacketKind::Command, "Version 1.23", &mut version);
        server.receive(first, &version);
        assert!(server.connect(peer(3)).is_err());
        server.make_room(Instant::now() + VERSION_TIMEOUT);
        assert_eq!((server.is_over(first), server.is_over(silent)), (false, true));
        // Its connection is closed then.
        server.disconnect(silent);
        let third = server.connect(peer(3)).unwrap();
        assert!(!server.is_over(third) && server.connect(peer(4)).is_err());
        assert_eq!(server.news.len(), 1);
        assert!(server.news[0].contains("127.0.0.1:2 disconnected: it has set no version"));
    }
}

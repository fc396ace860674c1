//! A server of the QTM RT protocol for what is recorded (docs/qtm.md).

use std::{
    net::{SocketAddr, UdpSocket},
    sync::Arc,
    thread::JoinHandle,
    time::{Duration, Instant},
};

use anyhow::{Context, anyhow};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use mocapd_acquire::threads::{self, StopReceiver, StopSender};
use mocapd_drivers::{
    qtm::{
        CLIENTS_MAX, ClientId, DISCOVERY_PORT, OwnerCommand, OwnerRequest, QtmServer, ServedFrame,
        discovery_reply, read_discovery_request,
    },
    transport::network::{
        responder::Responder,
        server::{StreamServer, TcpServer},
    },
};

use super::{
    PublishedFeed, PublishedSource,
    markers::{MarkerMap, header_of},
};
use crate::{
    config::QtmPublishConfig,
    control::{Control, EventFeed, Mark, Request, Start},
    http::Token,
    status::{PublishStatus, PublishedClient, ServiceEvent, ServiceEventKind, State},
    trigger::{Network, RateLimit},
};

/// Time between two looks at the frames while a client requests them: well below the 3 ms in which they reach its socket.
const POLL_STREAMING: Duration = Duration::from_millis(1);

/// Frames between two looks at the clients: their sockets take as many at once.
const FRAMES_A_TURN: usize = 16;

/// The same while nobody does: the rings hold half a second.
const POLL_IDLE: Duration = Duration::from_millis(20);

/// Time between two reports of the clients to the status.
const REPORT_INTERVAL: Duration = Duration::from_millis(200);

/// What the server says to be.
const VERSION: &str = concat!("mocapd ", env!("CARGO_PKG_VERSION"));

/// Time between two attempts to open the port: an address that comes with the network needs some seconds.
const REOPEN_INTERVAL: Duration = Duration::from_secs(5);

/// How long clients have to take what is pending when the service stops.
const DRAIN: Duration = Duration::from_millis(500);

/// The publisher, until it is closed.
#[derive(Debug)]
pub struct QtmPublisher {
    address: SocketAddr,
    stopper: StopSender,
    threads: Vec<JoinHandle<()>>,
}

impl QtmPublisher {
    /// Opens the port and publishes; `None` if the configuration does not want it.
    ///
    /// A port that cannot be opened is a warning, and tried again until it can: the recording does without clients.
    ///
    /// # Errors
    /// The password file cannot be used; the message says what to do.
    pub fn open(
        config: &QtmPublishConfig,
        feed: PublishedFeed,
        control: &Arc<dyn Control>,
    ) -> anyhow::Result<Option<Self>> {
        if !config.enabled {
            return Ok(None);
        }
        let password = match &config.password_file {
            Some(file) if config.control => {
                Some(Token::read(file).context("publish.qtm.password_file")?.into_text())
            }
            _ => None,
        };
        let listen = config.listen;
        let sockets = Sockets::open(listen);
        let address = sockets.as_ref().map_or(listen, |sockets| sockets.clients.address());
        let message = match &sockets {
            Ok(_) => format!("published for clients of QTM at {address}"),
            Err(error) => format!("{error:#}; tried again every {} s", REOPEN_INTERVAL.as_secs()),
        };
        let kind =
            if sockets.is_ok() { ServiceEventKind::State } else { ServiceEventKind::Warning };
        control.notify(kind, &message);
        let (requests, requested) = bounded(CLIENTS_MAX);
        let (replies, replied) = bounded(CLIENTS_MAX);
        let (stopper, stopped) = threads::stop_channel();
        let has_control = password.is_some();
        let (opener, until) = (Arc::clone(control), stopped.clone());
        let owner = Arc::clone(control);
        let config = config.clone();
        let worker = move |Sockets { clients, datagrams, responder }| PublishWorker {
            clients,
            datagrams,
            responder,
            server: AllowedServer {
                server: QtmServer::of_recorder(VERSION.to_owned(), config.clients_max, password),
                allow_from: config.allow_from.clone(),
                refused: 0,
                news: Vec::new(),
            },
            config,
            feed,
            source: None,
            map: MarkerMap::default(),
            markers: Vec::new(),
            events: owner.events(),
            control: owner,
            requests,
            replied,
            n_executing: 0,
            is_behind: false,
            rate_limit: RateLimit::default(),
            began: Instant::now(),
            reported: None,
            stopped,
        };
        let publish = move || {
            let sockets =
                sockets.ok().or_else(|| Sockets::wait_for(listen, &until, opener.as_ref()));
            if let Some(sockets) = sockets {
                worker(sockets).run();
            }
        };
        let mut running = vec![threads::spawn("mocapd-qtm", publish)?];
        if has_control {
            let control = Arc::clone(control);
            let execute = move || execute_requests(control.as_ref(), &requested, &replies);
            running.push(threads::spawn("mocapd-qtm-ctl", execute)?);
        }
        Ok(Some(Self { address, stopper, threads: running }))
    }

    /// Where clients connect.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Disconnects all clients.
    pub fn close(self) {
        drop(self.stopper);
        for thread in self.threads {
            // A thread that panicked has reported it already.
            drop(thread.join());
        }
    }
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
        let datagrams = UdpSocket::bind((listen.ip(), 0)).context("cannot open a UDP socket")?;
        datagrams.set_nonblocking(true).context("cannot make a UDP socket non-blocking")?;
        Ok(Self { clients, datagrams, responder: Responder::open(DISCOVERY_PORT).ok() })
    }

    /// Tries until the port can be opened, or the service stops.
    fn wait_for(listen: SocketAddr, stopped: &StopReceiver, control: &dyn Control) -> Option<Self> {
        loop {
            // Nothing is sent on it: it ends when it is time to stop.
            if stopped.channel().recv_timeout(REOPEN_INTERVAL)
                == Err(RecvTimeoutError::Disconnected)
            {
                return None;
            }
            if let Ok(sockets) = Self::open(listen) {
                let address = sockets.clients.address();
                let message = format!("published for clients of QTM at {address}");
                control.notify(ServiceEventKind::State, &message);
                return Some(sockets);
            }
        }
    }
}

/// The server, and who may connect to it.
#[derive(Debug)]
struct AllowedServer {
    server: QtmServer,
    allow_from: Vec<Network>,
    refused: u64,
    /// Messages about clients, for the events.
    news: Vec<String>,
}

impl AllowedServer {
    fn is_allowed(&self, peer: SocketAddr) -> bool {
        let ip = peer.ip().to_canonical();
        ip.is_loopback() || self.allow_from.iter().any(|network| network.contains(ip))
    }
}

impl StreamServer for AllowedServer {
    type Id = ClientId;

    fn connect(&mut self, peer: SocketAddr) -> Result<ClientId, Vec<u8>> {
        let connected = match self.is_allowed(peer) {
            false => Err((QtmServer::exclusion(), "it is not in publish.qtm.allow_from")),
            true => self.server.connect(peer).ok_or_else(|| {
                (QtmServer::refusal(), "publish.qtm.clients_max are connected already")
            }),
        };
        connected.map_err(|(message, why)| {
            self.refused += 1;
            self.news.push(format!("QTM client {} refused: {why}", peer.ip().to_canonical()));
            message
        })
    }

    fn disconnect(&mut self, id: ClientId) {
        let report = self.server.disconnect(id).filter(|report| report.frames_missed > 0);
        if let Some(report) = report {
            self.news.push(format!(
                "QTM client {} has left: it read too slowly, and missed {} of {} frames",
                report.peer,
                report.frames_missed,
                report.frames_missed + report.frames_sent
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
        self.server.is_out_of_step(id)
    }

    fn pending(&self, id: ClientId) -> &[u8] {
        self.server.pending(id)
    }

    fn sent(&mut self, id: ClientId, n: usize) {
        self.server.sent(id, n);
    }
}

/// The state of the publisher's thread.
#[derive(Debug)]
struct PublishWorker {
    clients: TcpServer<ClientId>,
    datagrams: UdpSocket,
    /// Answers searches, unless another program uses their port alone.
    responder: Option<Responder>,
    server: AllowedServer,
    config: QtmPublishConfig,
    feed: PublishedFeed,
    source: Option<PublishedSource>,
    map: MarkerMap,
    markers: Vec<mocapd_acquire::pipeline::TappedMarker>,
    events: EventFeed,
    control: Arc<dyn Control>,
    requests: Sender<OwnerRequest>,
    replied: Receiver<OwnerReply>,
    /// Commands that are being executed.
    n_executing: usize,
    /// Whether more frames wait than one turn sends.
    is_behind: bool,
    rate_limit: RateLimit,
    began: Instant,
    reported: Option<Instant>,
    stopped: StopReceiver,
}

impl PublishWorker {
    fn run(mut self) {
        let is_recording = self.control.status().state == State::Recording;
        self.follow_source();
        self.server.server.set_capturing(is_recording);
        while !self.stopped.is_stopped() {
            self.follow_source();
            self.pass_requests();
            self.follow_takes();
            self.publish_frames();
            self.send_datagrams();
            self.answer_searches();
            self.clients.exchange(&mut self.server);
            self.report();
            let is_streaming = self.server.server.wants_frames() && self.source.is_some();
            let timeout = match is_streaming {
                true if self.is_behind => Duration::ZERO,
                true => POLL_STREAMING,
                false => POLL_IDLE,
            };
            if let Err(error) = self.clients.wait(&mut self.server, timeout) {
                // Not at once again: the system may be out of memory.
                std::thread::sleep(POLL_IDLE);
                self.warn(&format!("waiting for QTM clients failed: {error}"));
            }
        }
        self.server.server.set_source(None);
        self.send_datagrams();
        self.clients.finish(&mut self.server, DRAIN);
        self.feed.report(None);
    }

    /// Takes over a device that was armed, or ends the measurement of one that was disarmed.
    fn follow_source(&mut self) {
        while let Ok(source) = self.feed.sources.try_recv() {
            self.map = MarkerMap::default();
            let n_channels = source.header.channels.len();
            self.map.follow(n_channels, &source.progress);
            self.server.server.set_source(Some(self.map.settings(&source.header)));
            self.source = Some(source);
        }
        let Some(source) = &self.source else { return };
        source.frames.set_wanted(self.server.server.wants_frames());
        if source.frames.is_over() {
            self.source = None;
            self.server.server.set_source(None);
        }
    }

    /// Tells clients of takes that began or ended, after the reply to a command that caused it.
    fn follow_takes(&mut self) {
        while self.n_executing == 0
            && let Some(event) = self.events.next(Duration::ZERO)
        {
            self.server.server.set_capturing(is_recording(&event));
        }
    }

    fn publish_frames(&mut self) {
        let Some(source) = &mut self.source else { return };
        let server = &mut self.server.server;
        let tick_hz = source.header.device.as_ref().map_or(1_000_000, |device| device.tick_hz);
        self.is_behind = true;
        for _ in 0..FRAMES_A_TURN {
            let Some(frame) = source.frames.next(&mut self.markers) else {
                self.is_behind = false;
                break;
            };
            server.left_out(frame.left_out);
            if self.map.follow(frame.n_channels, &source.progress) {
                server.set_source(Some(self.map.settings(&source.header)));
            }
            self.map.fill(&self.markers);
            let header = header_of(&frame, tick_hz);
            let MarkerMap { labelled, unlabelled, .. } = &self.map;
            server.frame(&ServedFrame { header, labelled, unlabelled, ..ServedFrame::default() });
        }
    }

    /// Answers those who may connect, with the name of the rig.
    fn answer_searches(&self) {
        let Some(responder) = &self.responder else { return };
        let port = self.clients.address().port();
        responder.serve(|from, question| {
            let reply_port = read_discovery_request(question)?;
            let is_allowed = self.server.is_allowed((from, reply_port).into());
            is_allowed
                .then(|| (reply_port, discovery_reply(&self.control.status().rig, VERSION, port)))
        });
    }

    fn send_datagrams(&mut self) {
        let server = &mut self.server.server;
        for datagram in server.take_datagrams() {
            let is_sent = self.datagrams.send_to(&datagram.bytes, datagram.to).is_ok();
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

    fn report(&mut self) {
        for message in std::mem::take(&mut self.server.news) {
            self.warn(&message);
        }
        if self.reported.is_some_and(|at| at.elapsed() < REPORT_INTERVAL) {
            return;
        }
        self.reported = Some(Instant::now());
        let server = &self.server.server;
        self.feed.report(Some(PublishStatus {
            protocol: "qtm".to_owned(),
            listen: self.clients.address().to_string(),
            clients_max: self.config.clients_max,
            clients_refused: self.server.refused,
            frames_missed: server.frames_missed(),
            clients: server.reports().into_iter().map(PublishedClient::from).collect(),
        }));
    }

    fn warn(&mut self, message: &str) {
        if let Some(message) = self.rate_limit.admit(message, self.began.elapsed()) {
            self.control.notify(ServiceEventKind::Warning, &message);
        }
    }
}

/// Whether a take is recorded after an event.
fn is_recording(event: &ServiceEvent) -> bool {
    match event.kind {
        ServiceEventKind::TakeStarted => true,
        ServiceEventKind::TakeStopped => false,
        _ => event.state == State::Recording,
    }
}

impl From<mocapd_drivers::qtm::ClientReport> for PublishedClient {
    fn from(report: mocapd_drivers::qtm::ClientReport) -> Self {
        Self {
            address: report.peer.to_string(),
            version: report.minor.map_or_else(String::new, |minor| format!("1.{minor}")),
            transport: if report.by_datagrams { "udp" } else { "tcp" }.to_owned(),
            is_streaming: report.is_streaming,
            is_in_control: report.is_master,
            frames_sent: report.frames_sent,
            frames_missed: report.frames_missed,
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

//! A NatNet server for what is received (docs/natnet.md).

mod samples;

use std::{
    io::{self, ErrorKind},
    net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket},
    sync::Arc,
    time::Duration,
};

use anyhow::{Context, anyhow};
use mocapd_acquire::{
    host_clock::monotonic_ns,
    pipeline::{TappedBatch, TappedFrame, lock},
};
use mocapd_drivers::natnet::{
    AssetTable, DatagramContent, FrameEnd, FrameToSend, MODELS_CHANGED, Message, MessageKind,
    Model, NatNetServer, ServedMarker, ServedStream, ServerSettings, SetToSend, StreamReport,
    WireBody, in_m,
};
use mocapd_drivers::transport::network::multicast_sender;
use mocapd_take::poses::{Pose, PoseState};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use self::samples::ServedSamples;
use super::{
    LivePublisher, PublishedDevice, PublishedFeed, PublisherName, RunningPublisher, WantedKinds,
    clients::ClientLimits, host_time::HostTime, runner,
};
use crate::{
    config::NatNetPublishConfig,
    control::Control,
    status::{PublishStatus, PublishedClient},
};

/// OptiTrack's NatNet.
pub const NATNET: PublisherName = PublisherName { id: "natnet", title: "NatNet" };

/// Size of one read: many times the longest command.
const READ_BYTES: usize = 4096;

/// Commands between two looks at frames: a flood of them must not hold these up.
const COMMANDS_A_TURN: usize = 64;

/// Networks that frames to a group cross: only the own one.
const HOPS: u32 = 1;

/// How long frames state that definitions have changed: the one with the flag may be lost on the network.
const CHANGED_NS: u64 = 1_000_000_000;

/// The clock of stamps: the host's monotonic one, in nanoseconds.
const CLOCK_HZ: u64 = 1_000_000_000;

/// Opens the port and publishes.
///
/// # Errors
/// The thread cannot be started.
pub fn open(
    config: &NatNetPublishConfig,
    feed: PublishedFeed,
    control: &Arc<dyn Control>,
) -> anyhow::Result<RunningPublisher> {
    let (listen, config) = (config.listen, config.clone());
    runner::start(feed, control, listen, move || NatNetPublisher::open(&config))
}

/// What is published of a device.
#[derive(Debug)]
struct DescribedDevice {
    table: AssetTable,
    /// Channels that the table has.
    n_channels: usize,
    /// Ids of the bodies, in their order.
    bodies: Vec<u32>,
    samples: ServedSamples,
    time: HostTime,
}

/// The server with its sockets.
#[derive(Debug)]
struct NatNetPublisher {
    commands: UdpSocket,
    /// Sends frames to a group.
    group: Option<UdpSocket>,
    address: SocketAddr,
    server: NatNetServer,
    limits: ClientLimits,
    device: Option<DescribedDevice>,
    news: Vec<String>,
    /// Until when frames state that definitions have changed.
    changed_until_ns: u64,
    /// Whether it was reported that frames do not fit into datagrams.
    is_excess_known: bool,
    /// Whether it was reported that samples are left out.
    is_lag_known: bool,
    /// Frames that clients were sent, also those that have left.
    frames_sent: u64,
    bodies: Vec<WireBody>,
}

impl NatNetPublisher {
    fn open(config: &NatNetPublishConfig) -> anyhow::Result<Self> {
        let listen = config.listen;
        let commands = UdpSocket::bind(listen).map_err(|error| {
            anyhow!(
                "cannot publish at publish.natnet.listen = {listen}: {error}; `ss -ulpn` shows which program uses the port, \
                 `ip address` lists the addresses of this machine"
            )
        })?;
        commands.set_nonblocking(true).context("cannot make a UDP socket non-blocking")?;
        let address = commands.local_addr().context("a UDP socket has no address")?;
        let interface = match address.ip() {
            IpAddr::V4(ip) => ip,
            IpAddr::V6(_) => Ipv4Addr::UNSPECIFIED,
        };
        let group = config.multicast.map(|_| multicast_sender(interface, HOPS)).transpose();
        let group = group.context("cannot open a socket for publish.natnet.multicast")?;
        if let Some(socket) = &group {
            socket.set_nonblocking(true).context("cannot make a UDP socket non-blocking")?;
        }
        let port = u16::try_from(config.data_port).context("publish.natnet.data_port")?;
        let server = NatNetServer::new(ServerSettings {
            name: "mocapd".to_owned(),
            app_version: app_version(),
            bitstream: config.bitstream,
            rate_hz: 0.0,
            samples_per_frame: 0,
            clock_hz: CLOCK_HZ,
            stream: config.multicast.map_or(ServedStream::Unicast(port), ServedStream::Multicast),
            model: Model::default(),
        });
        Ok(Self {
            commands,
            group,
            address,
            server: server.limited_to(config.clients_max),
            limits: ClientLimits::new(NATNET, &config.allow_from, config.clients_max),
            device: None,
            news: Vec::new(),
            changed_until_ns: 0,
            is_excess_known: false,
            is_lag_known: false,
            frames_sent: 0,
            bodies: Vec::new(),
        })
    }

    fn receive(&mut self) {
        let mut buffer = [0; READ_BYTES];
        for _ in 0..COMMANDS_A_TURN {
            let (n, from) = match self.commands.recv_from(&mut buffer) {
                Ok(received) => received,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                // None waits, or one that was answered is gone.
                Err(_) => return,
            };
            let now_ns = monotonic_ns();
            let bytes = buffer.get(..n).unwrap_or_default();
            if !self.limits.is_allowed(from.ip()) {
                let kind = Message::of(bytes).and_then(|message| message.kind);
                if kind == Some(MessageKind::Connect) {
                    // Counted and reported; searches and others are left silently.
                    self.limits.check(from, 0).ok();
                }
                continue;
            }
            let refused = self.server.n_refused();
            self.server.receive(from, bytes, now_ns, now_ns);
            if self.server.n_refused() > refused {
                self.limits.check(from, usize::MAX).ok();
            }
        }
    }

    /// States other definitions from now on.
    fn set_model(&mut self, model: &Model) {
        if self.server.settings().model == *model {
            return;
        }
        self.server.set_model(model.clone());
        self.changed_until_ns = monotonic_ns() + CHANGED_NS;
        if !self.server.has_room_for_model() {
            self.news.push(
                "the names of markers do not fit into a datagram of NatNet: clients get none; publish them as QTM or LSL does"
                    .to_owned(),
            );
        }
    }

    fn send(&mut self) {
        for datagram in self.server.take_datagrams() {
            let is_group = match datagram.to.ip() {
                IpAddr::V4(ip) => ip.is_multicast(),
                IpAddr::V6(_) => false,
            };
            let group = self.group.as_ref().filter(|_| is_group);
            let socket = group.unwrap_or(&self.commands);
            let is_sent = socket.send_to(&datagram.bytes, datagram.to).is_ok();
            let is_frame = datagram.content == DatagramContent::Frame;
            self.frames_sent += u64::from(is_sent && is_frame);
            self.server.datagram_sent(&datagram, is_sent);
        }
    }
}

impl LivePublisher for NatNetPublisher {
    fn address(&self) -> SocketAddr {
        self.address
    }

    fn set_device(&mut self, device: Option<&PublishedDevice>) {
        if let Some(n @ 1..) = self.device.as_ref().map(|served| served.samples.n_left_out()) {
            self.news
                .push(format!("{n} samples of the last device were too late for NatNet's frames"));
        }
        // Without a device, the definitions stay those of the last one: only others are a change.
        self.device = device.map(DescribedDevice::new);
        (self.is_excess_known, self.is_lag_known) = (false, false);
        let Some((served, device)) = self.device.as_ref().zip(device) else { return };
        for rate_hz in served.samples.uneven_hz() {
            self.news.push(format!(
                "sampled channels at {rate_hz} Hz are not published by NatNet, in which each frame has equally many samples:                  {rate_hz} Hz is no multiple of the frame rate, {} Hz; publish them as QTM or LSL does",
                device.header.rate_hz
            ));
        }
        self.server.set_rates(device.header.rate_hz as f32, served.samples.per_frame());
        let model = served.table.model().clone();
        self.set_model(&model);
    }

    fn wanted(&self) -> WantedKinds {
        let frames = self.server.has_listeners();
        let samples = frames && self.device.as_ref().is_some_and(|it| !it.samples.is_empty());
        WantedKinds { frames, samples }
    }

    fn wants_poses(&self) -> bool {
        // Every frame has the bodies.
        true
    }

    fn frame(&mut self, device: &PublishedDevice, frame: &TappedFrame) {
        self.server.left_out(frame.frames_left_out);
        let followed = self.device.as_mut().and_then(|it| it.follow(device, frame.markers.len()));
        if let Some(model) = followed {
            self.set_model(&model);
        }
        let Some(served) = &mut self.device else { return };
        served.fill(frame);
        served.put_bodies(&frame.poses, &mut self.bodies);
        let captured_ns =
            served.time.of_frame(frame.device_ticks, frame.arrival_ns, &device.progress);
        let now_ns = monotonic_ns();
        let end = FrameEnd {
            timestamp_s: served.time.device_s(frame.device_ticks),
            ticks: [captured_ns, frame.arrival_ns, now_ns],
            flags: if now_ns < self.changed_until_ns { MODELS_CHANGED } else { 0 },
            ..FrameEnd::default()
        };
        let sets = served.table.sets();
        let sets: Vec<SetToSend<'_>> =
            sets.map(|(set, positions_m)| SetToSend { name: &set.name, positions_m }).collect();
        let to_send = FrameToSend {
            // The number has 32 bits, and begins again after 49 days at 1000 Hz.
            number: frame.row as u32,
            sets: &sets,
            bodies: &self.bodies,
            skeletons: &served.table.skeletons(),
            labelled: served.table.labelled(),
            unlabelled: served.table.unlabelled(),
            plates: &served.samples.to_send(true),
            devices: &served.samples.to_send(false),
            end,
        };
        let fits = self.server.frame(&to_send, now_ns).is_some();
        if !fits && !std::mem::replace(&mut self.is_excess_known, true) {
            self.news.push(format!(
                "frames of {} markers do not fit into NatNet's datagrams: clients miss them; publish them as QTM or LSL does",
                frame.markers.len()
            ));
        }
        if served.samples.n_left_out() > 0 && !std::mem::replace(&mut self.is_lag_known, true) {
            self.news.push(
                "sampled channels come faster than their stated rate, or frames later: NatNet's frames have not all of their \
                 samples; publish them as QTM or LSL does"
                    .to_owned(),
            );
        }
        self.send();
    }

    fn samples(&mut self, _: &PublishedDevice, batch: &TappedBatch) {
        if let Some(served) = &mut self.device {
            served.samples.push(batch);
        }
    }

    fn exchange(&mut self, timeout: Duration) -> io::Result<()> {
        self.server.forget_silent(monotonic_ns());
        self.receive();
        self.send();
        let timeout = Timespec::try_from(timeout).unwrap_or_default();
        match poll(&mut [PollFd::new(&self.commands, PollFlags::IN)], Some(&timeout)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => {
                self.receive();
                self.send();
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }

    fn take_news(&mut self) -> Vec<String> {
        let mut news = self.limits.take_news();
        news.append(&mut self.news);
        news
    }

    fn status(&self) -> PublishStatus {
        let is_multicast = self.group.is_some();
        let client = |report: StreamReport| PublishedClient {
            address: report.address.to_string(),
            version: report.version.to_string(),
            transport: if is_multicast { "multicast" } else { "udp" }.to_owned(),
            is_streaming: self.device.is_some(),
            frames_sent: report.frames_sent,
            frames_missed: report.frames_missed,
            ..PublishedClient::default()
        };
        PublishStatus {
            protocol: NATNET.id.to_owned(),
            listen: self.address.to_string(),
            clients_max: self.limits.clients_max(),
            clients_refused: self.limits.refused(),
            frames_sent: self.frames_sent,
            frames_missed: self.server.frames_missed(),
            clients: self.server.reports().into_iter().map(client).collect(),
            ..PublishStatus::default()
        }
    }

    fn close(mut self) {
        self.send();
    }
}

impl DescribedDevice {
    fn new(device: &PublishedDevice) -> Self {
        let (samples, described) = ServedSamples::new(device);
        let mut served = Self {
            table: AssetTable::default(),
            n_channels: 0,
            bodies: Vec::new(),
            samples,
            time: HostTime::new(device),
        };
        served.table.model_mut().sampled = described;
        served.rebuild(device);
        served
    }

    /// Takes over the channels if there are others now. Returns the definitions then.
    fn follow(&mut self, device: &PublishedDevice, n_channels: usize) -> Option<Model> {
        // A marker that has just appeared is here once the writer knows it.
        if self.n_channels == n_channels || lock(&device.progress.channels).len() == self.n_channels
        {
            return None;
        }
        self.rebuild(device);
        Some(self.table.model().clone())
    }

    fn rebuild(&mut self, device: &PublishedDevice) {
        let channels = lock(&device.progress.channels).clone();
        let labels =
            channels.iter().map(|channel| channel.labelled.then_some(channel.label.as_str()));
        let names: Vec<&str> = device.bodies.iter().map(|body| body.name.as_str()).collect();
        let (mut table, bodies) = AssetTable::with_bodies(&names, labels);
        self.bodies = bodies;
        table.model_mut().sampled = std::mem::take(&mut self.table.model_mut().sampled);
        (self.table, self.n_channels) = (table, channels.len());
    }

    fn fill(&mut self, frame: &TappedFrame) {
        self.table.fill(|slot| {
            let marker = frame.markers.get(slot)?;
            let residual_m = (f64::from(marker.residual_10um) * 1e-5) as f32;
            Some(ServedMarker { position_mm: marker.position_mm, residual_m })
        });
        self.samples.select(frame.row);
    }

    /// The poses of a frame; a body without one is not tracked.
    fn put_bodies(&self, poses: &[Pose], out: &mut Vec<WireBody>) {
        out.clear();
        for (index, id) in self.bodies.iter().enumerate() {
            let pose = poses.get(index).filter(|pose| pose.state == PoseState::Tracked);
            let lost =
                WireBody { id: *id, quaternion_xyzw: [0.0, 0.0, 0.0, 1.0], ..WireBody::default() };
            out.push(pose.map_or(lost, |pose| {
                let [w, x, y, z] = pose.quaternion;
                let [error_m, ..] = in_m([pose.residual_mm; 3]);
                WireBody {
                    id: *id,
                    position_m: in_m(pose.position_mm),
                    quaternion_xyzw: [x, y, z, w],
                    error_m: if error_m.is_nan() { 0.0 } else { error_m },
                    is_tracked: true,
                }
            }));
        }
    }
}

/// The version of this program.
fn app_version() -> [u8; 4] {
    let mut version = [0; 4];
    let parts = env!("CARGO_PKG_VERSION").split('.').map(|part| part.parse().unwrap_or(0));
    version.iter_mut().zip(parts).for_each(|(to, part)| *to = part);
    version
}

//! A driver and a server, connected in memory.

use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};

use mocapd_drivers::{
    device::{
        BodyInfo, Command, DeviceEvent, Hello, LinkCounters, MarkerInfo, MarkerSample, Pong, Pose,
        Protocol, SampledGroupInfo, Status,
    },
    natnet::{
        Asset, AssetKind, Bitstream, FrameEnd, FrameToSend, HAS_MODEL, MEASURED, MarkerSet, Model,
        NatNetHost, NatNetMarker, NatNetServer, OCCLUDED, SampledDescription, SampledToSend,
        ServedStream, ServerSettings, SetToSend, UNLABELLED,
    },
    transport::{
        DatagramSource,
        polled::{LineCommand, LineCommandReceiver, line_command_channel},
    },
    uri::DeviceUri,
};

pub(crate) const MS: u64 = 1_000_000;

pub(crate) const CLOCK_HZ: u64 = 3_312_787;

pub(crate) const GROUP: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(239, 255, 42, 99), 1511);

/// What the driver reported.
#[derive(Debug, Default)]
pub(crate) struct Reported {
    pub(crate) hello: Option<Hello>,
    pub(crate) markers: Vec<MarkerInfo>,
    pub(crate) groups: Vec<SampledGroupInfo>,
    pub(crate) bodies: Vec<BodyInfo>,
    pub(crate) poses: Vec<(u32, Vec<Pose>)>,
    /// The frame that would come next.
    pub(crate) end_of_poses: Option<u32>,
    pub(crate) frames: Vec<(u32, u64, Vec<MarkerSample>)>,
    /// Group, number, first sample and values of each batch.
    pub(crate) batches: Vec<(u8, u32, u64, Vec<f32>)>,
    pub(crate) notes: Vec<String>,
    pub(crate) started: u32,
    pub(crate) pongs: Vec<Pong>,
    pub(crate) ended: Option<Status>,
}

impl Reported {
    pub(crate) fn event(&mut self, event: DeviceEvent<'_>) {
        match event {
            DeviceEvent::Hello(hello) => {
                self.hello = Some(hello.clone());
                self.groups.clear();
            }
            DeviceEvent::Markers(markers) => self.markers = markers.to_vec(),
            DeviceEvent::SampledGroup(group) => self.groups.push(group.clone()),
            DeviceEvent::Frame(frame) => {
                self.frames.push((frame.seq, frame.device_ticks, frame.markers.to_vec()));
            }
            DeviceEvent::Samples(batch) => {
                let values = batch.samples.to_vec();
                self.batches.push((batch.group, batch.number, batch.first, values));
            }
            DeviceEvent::Bodies(bodies) => self.bodies = bodies.to_vec(),
            DeviceEvent::Poses(frame) => self.poses.push((frame.seq, frame.poses.to_vec())),
            DeviceEvent::EndOfPoses(end) => self.end_of_poses = Some(end.seq),
            DeviceEvent::Note(note) => self.notes.push(note.to_owned()),
            DeviceEvent::Started(_) => self.started += 1,
            DeviceEvent::Pong(pong) => self.pongs.push(pong),
            DeviceEvent::EndOfStream(status) => self.ended = Some(status),
            _ => {}
        }
    }

    pub(crate) fn has_note(&self, part: &str) -> bool {
        self.notes.iter().any(|note| note.contains(part))
    }

    /// The label of a sample's marker.
    pub(crate) fn label(&self, id: u16) -> Option<&str> {
        let found = self.markers.iter().find(|marker| marker.id == id);
        found.map(|marker| marker.label.as_str())
    }
}

/// A driver without a server.
pub(crate) struct Driver {
    pub(crate) host: NatNetHost,
    pub(crate) commands: LineCommandReceiver,
    pub(crate) now_ns: u64,
    pub(crate) failed: Option<String>,
    pub(crate) lost: Option<String>,
    pub(crate) listens: Option<DatagramSource>,
    pub(crate) reported: Reported,
    written: Vec<Vec<u8>>,
}

impl Driver {
    pub(crate) fn new(uri: &str) -> Self {
        let (sender, commands) = line_command_channel();
        let uri: DeviceUri = uri.parse().unwrap();
        Self {
            host: NatNetHost::new(&uri.location, sender),
            commands,
            now_ns: 0,
            failed: None,
            lost: None,
            listens: None,
            reported: Reported::default(),
            written: Vec::new(),
        }
    }

    pub(crate) fn command(&mut self, command: Command) {
        let mut out = Vec::new();
        self.host.command(command, &mut out);
        if !out.is_empty() {
            self.written.push(out);
        }
    }

    pub(crate) fn push(&mut self, bytes: &[u8]) {
        self.commands.set_datagram(!bytes.is_empty());
        self.commands.set_now_ns(self.now_ns);
        let reported = &mut self.reported;
        self.host.push(bytes, &mut |event| reported.event(event));
    }

    /// The datagrams that the driver sends now.
    pub(crate) fn written(&mut self) -> Vec<Vec<u8>> {
        let mut written = std::mem::take(&mut self.written);
        while let Some(command) = self.commands.try_recv() {
            match command {
                LineCommand::Write { request, .. } => written.push(request.as_bytes().to_vec()),
                LineCommand::Listen(source) => self.listens = Some(source),
                LineCommand::Goodbye(_) => {}
                LineCommand::StopListening => self.listens = None,
                LineCommand::Fail(message) => self.failed = Some(message),
                LineCommand::Lost(cause) => self.lost = Some(cause),
                other => panic!("{other:?}"),
            }
        }
        written
    }

    pub(crate) fn counters(&self) -> LinkCounters {
        self.host.counters()
    }

    pub(crate) fn is_over(&self) -> bool {
        self.failed.is_some() || self.lost.is_some()
    }
}

/// Two assets with two markers each.
pub(crate) fn model() -> Model {
    let set = |name: &str, markers: [&str; 2]| MarkerSet {
        name: name.to_owned(),
        markers: markers.map(str::to_owned).to_vec(),
    };
    let asset = |id, name: &str| Asset {
        kind: AssetKind::Skeleton,
        id,
        name: name.to_owned(),
        markers: Vec::new(),
    };
    let sampled = |is_plate, id, name: &str, channels: &[&str]| SampledDescription {
        is_plate,
        id,
        name: name.to_owned(),
        data_type: u32::from(!is_plate),
        channels: channels.iter().map(|channel| (*channel).to_owned()).collect(),
    };
    Model {
        sets: vec![set("Anna", ["head", "hand"]), set("", ["left", "right"])],
        assets: vec![asset(7, "Anna"), asset(9, "")],
        sampled: vec![
            sampled(true, 1, "AMTI", &["Fx", "Fy", "Fz"]),
            sampled(false, 1, "NI", &["ai0"]),
        ],
        n_cameras: 0,
        n_unknown: 0,
    }
}

pub(crate) const LABELS: [&str; 4] = ["Anna:head", "Anna:hand", "left", "right"];

pub(crate) fn settings(bitstream: Bitstream, stream: ServedStream) -> ServerSettings {
    ServerSettings {
        name: "Motive".to_owned(),
        app_version: [3, 1, 0, 0],
        bitstream,
        rate_hz: 100.0,
        samples_per_frame: 2,
        clock_hz: CLOCK_HZ,
        stream,
        model: model(),
    }
}

pub(crate) fn client() -> SocketAddr {
    SocketAddr::from(([127, 0, 0, 1], 40_000))
}

/// The server's clock at a frame of 10 ms.
pub(crate) fn ticks(number: u32) -> u64 {
    1_000_000 + u64::from(number) * CLOCK_HZ / 100
}

/// The time that the driver reports for it.
pub(crate) fn time_ns(number: u32) -> u64 {
    (u128::from(ticks(number)) * 1_000_000_000 / u128::from(CLOCK_HZ)) as u64
}

/// Where a marker is.
pub(crate) fn position_m(number: u32, column: u32) -> [f32; 3] {
    [0.001 * number as f32, 0.1 + column as f32, -1.25]
}

/// The message of a frame.
pub(crate) fn frame_bytes(number: u32, unlabelled: &[u32], flags: u16, server: &mut NatNetServer) {
    let version_has_ticks = server.settings().bitstream.has_ticks();
    let marker = |id: u32, column: u32, flags: u16| NatNetMarker {
        id,
        position_m: position_m(number, column),
        size_m: 0.014,
        flags,
        residual_m: if version_has_ticks { 0.0025 } else { 0.0 },
    };
    let hidden =
        NatNetMarker { position_m: [0.0; 3], ..marker(7 << 16 | 2, 1, HAS_MODEL | OCCLUDED) };
    let labelled = [
        marker(7 << 16 | 1, 0, HAS_MODEL | MEASURED),
        if number % 5 == 3 { hidden } else { marker(7 << 16 | 2, 1, HAS_MODEL | MEASURED) },
        marker(9 << 16 | 1, 2, HAS_MODEL | MEASURED),
        marker(9 << 16 | 2, 3, HAS_MODEL | MEASURED),
    ];
    let places = labelled.map(|marker| marker.position_m);
    let sets = [
        SetToSend { name: "Anna", positions_m: &places[..2] },
        SetToSend { name: "", positions_m: &places[2..] },
    ];
    let unlabelled: Vec<_> =
        unlabelled.iter().map(|id| marker(*id, *id, UNLABELLED | MEASURED)).collect();
    let sample = number as f32;
    let plate = [sample, sample + 0.5, -sample, -sample - 0.5, 9.0, 9.5];
    let device = [0.25 * sample, 0.125];
    let end = FrameEnd {
        timecode: 0,
        timecode_sub: 0,
        timestamp_s: f64::from(number) * 0.01,
        ticks: [ticks(number), ticks(number) + 100, ticks(number) + 200],
        flags,
    };
    let frame = FrameToSend {
        number,
        sets: &sets,
        bodies: &[],
        skeletons: &[7, 9],
        labelled: &labelled,
        unlabelled: &unlabelled,
        plates: &[SampledToSend { id: 1, n_channels: 3, samples: &plate }],
        devices: &[SampledToSend { id: 1, n_channels: 1, samples: &device }],
        end,
    };
    server.frame(&frame, 0).unwrap();
}

/// A driver and a server.
pub(crate) struct Pair {
    pub(crate) driver: Driver,
    pub(crate) server: NatNetServer,
    /// Datagrams to the driver that are lost next.
    pub(crate) loses: usize,
}

impl Pair {
    pub(crate) fn new(bitstream: Bitstream, stream: ServedStream) -> Self {
        let server = NatNetServer::new(settings(bitstream, stream));
        Self { driver: Driver::new("natnet:lab"), server, loses: 0 }
    }

    /// Passes datagrams in both directions, for 10 ms.
    pub(crate) fn step(&mut self) {
        for request in self.driver.written() {
            self.server.receive(client(), &request, 1_000, self.driver.now_ns);
        }
        self.deliver();
        self.driver.push(&[]);
        self.driver.now_ns += 10 * MS;
    }

    fn deliver(&mut self) {
        for datagram in self.server.take_datagrams() {
            let source = self.driver.listens;
            let arrives = match datagram.to {
                to if to == client() => true,
                SocketAddr::V4(to) if to.ip().is_multicast() => {
                    source == Some(DatagramSource { group: Some(*to.ip()), port: to.port() })
                }
                to => source == Some(DatagramSource { group: None, port: to.port() }),
            };
            if arrives && self.loses == 0 {
                self.driver.push(&datagram.bytes);
            } else if arrives {
                self.loses -= 1;
            }
        }
    }

    pub(crate) fn steps(&mut self, n: usize) {
        (0..n).for_each(|_| self.step());
    }

    /// From the first message to the stream.
    pub(crate) fn start(&mut self) {
        self.identify();
        self.driver.command(Command::Start { line_bytes_per_s: 0 });
        self.steps(3);
        assert_eq!(self.driver.reported.started, 1, "{:?}", self.driver.failed);
    }

    pub(crate) fn identify(&mut self) {
        self.driver.command(Command::Identify);
        self.driver.command(Command::Ping { host_ns: 1 });
        self.steps(80);
        assert!(self.driver.reported.hello.is_some(), "{:?}", self.driver.failed);
        assert_eq!(self.driver.reported.pongs.len(), 1);
    }

    /// The server sends a frame.
    pub(crate) fn frame(&mut self, number: u32, unlabelled: &[u32]) {
        self.frame_with(number, unlabelled, 0);
    }

    pub(crate) fn frame_with(&mut self, number: u32, unlabelled: &[u32], flags: u16) {
        frame_bytes(number, unlabelled, flags, &mut self.server);
        self.step();
    }
}

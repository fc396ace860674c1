//! A driver and a server, connected in memory.

use std::net::SocketAddr;

use mocapd_drivers::{
    device::{
        BodyInfo, Command, DeviceEvent, EndOfPoses, Hello, MarkerInfo, MarkerSample, Pose,
        Protocol, SampledGroupInfo, Status,
    },
    qtm::{
        ClientId, FrameHeader, QtmHost, QtmServer, ServedBody, ServedFrame, ServedSettings,
        WireMarker,
    },
    transport::polled::{LineCommand, LineCommandReceiver, line_command_channel},
    uri::DeviceUri,
};

pub(crate) const MS: u64 = 1_000_000;

pub(crate) const LABELS: [&str; 3] = ["head", "left <hand>", "right & hand"];

/// What the driver reported.
#[derive(Debug, Default)]
pub(crate) struct Reported {
    pub(crate) hello: Option<Hello>,
    pub(crate) markers: Vec<MarkerInfo>,
    pub(crate) frames: Vec<(u32, u64, Vec<MarkerSample>)>,
    pub(crate) notes: Vec<String>,
    pub(crate) started: u32,
    pub(crate) pongs: u32,
    pub(crate) ended: Option<Status>,
    pub(crate) groups: Vec<SampledGroupInfo>,
    pub(crate) batches: Vec<SentBatch>,
    /// The bodies, each time they were announced.
    pub(crate) bodies: Vec<Vec<BodyInfo>>,
    pub(crate) poses: Vec<(u32, u64, Vec<Pose>)>,
    pub(crate) end_of_poses: Option<EndOfPoses>,
}

/// A batch of samples.
#[derive(Debug)]
pub(crate) struct SentBatch {
    pub(crate) group: u8,
    pub(crate) number: u32,
    pub(crate) first: u64,
    pub(crate) device_ticks: u64,
    pub(crate) samples: Vec<f32>,
}

impl Reported {
    pub(crate) fn event(&mut self, event: DeviceEvent<'_>) {
        match event {
            DeviceEvent::Hello(hello) => self.hello = Some(hello.clone()),
            DeviceEvent::Markers(markers) => self.markers = markers.to_vec(),
            DeviceEvent::Frame(frame) => {
                self.frames.push((frame.seq, frame.device_ticks, frame.markers.to_vec()));
            }
            DeviceEvent::Note(note) => self.notes.push(note.to_owned()),
            DeviceEvent::Started(_) => self.started += 1,
            DeviceEvent::Pong(_) => self.pongs += 1,
            DeviceEvent::EndOfStream(status) => self.ended = Some(status),
            DeviceEvent::Bodies(bodies) => self.bodies.push(bodies.to_vec()),
            DeviceEvent::Poses(frame) => {
                self.poses.push((frame.seq, frame.device_ticks, frame.poses.to_vec()));
            }
            DeviceEvent::EndOfPoses(end) => self.end_of_poses = Some(end),
            DeviceEvent::SampledGroup(group) => self.groups.push(group.clone()),
            DeviceEvent::Samples(batch) => self.batches.push(SentBatch {
                group: batch.group,
                number: batch.number,
                first: batch.first,
                device_ticks: batch.device_ticks,
                samples: batch.samples.to_vec(),
            }),
            _ => {}
        }
    }
}

/// A driver without a server.
pub(crate) struct Driver {
    pub(crate) host: QtmHost,
    pub(crate) commands: LineCommandReceiver,
    pub(crate) now_ns: u64,
    pub(crate) failed: Option<String>,
    pub(crate) lost: Option<String>,
    pub(crate) sent: Vec<String>,
    pub(crate) reported: Reported,
}

impl Driver {
    pub(crate) fn new(datagram_port: Option<u16>) -> Self {
        let (sender, commands) = line_command_channel();
        let uri: DeviceUri = "qtm:lab".parse().unwrap();
        let host = QtmHost::new(&uri.location, sender, datagram_port);
        Self {
            host,
            commands,
            now_ns: 0,
            failed: None,
            lost: None,
            sent: Vec::new(),
            reported: Reported::default(),
        }
    }

    pub(crate) fn command(&mut self, command: Command) {
        let mut out = Vec::new();
        self.host.command(command, &mut out);
        assert!(out.is_empty());
    }

    pub(crate) fn push(&mut self, bytes: &[u8], is_datagram: bool) {
        self.commands.set_datagram(is_datagram && !bytes.is_empty());
        self.commands.set_now_ns(self.now_ns);
        let reported = &mut self.reported;
        self.host.push(bytes, &mut |event| reported.event(event));
    }

    /// The bytes that the driver sends now.
    pub(crate) fn written(&mut self) -> Vec<u8> {
        let mut bytes = Vec::new();
        while let Some(command) = self.commands.try_recv() {
            match command {
                LineCommand::Write { request, .. } => {
                    let text = request.as_bytes().get(8..).unwrap();
                    self.sent.push(
                        String::from_utf8(text.to_vec()).unwrap().trim_end_matches('\0').to_owned(),
                    );
                    bytes.extend_from_slice(request.as_bytes());
                }
                LineCommand::Fail(message) => self.failed = Some(message),
                LineCommand::Lost(cause) => self.lost = Some(cause),
                other => panic!("{other:?}"),
            }
        }
        bytes
    }
}

/// A driver and a server.
pub(crate) struct Pair {
    pub(crate) driver: Driver,
    pub(crate) server: QtmServer,
    pub(crate) client: ClientId,
}

impl Pair {
    pub(crate) fn new(datagram_port: Option<u16>) -> Self {
        let settings = ServedSettings {
            frequency_hz: 100.0,
            up_axis: "+Y",
            labels: LABELS.map(str::to_owned).to_vec(),
            ..ServedSettings::default()
        };
        Self::with(datagram_port, settings)
    }

    /// A server with these settings.
    pub(crate) fn with(datagram_port: Option<u16>, settings: ServedSettings) -> Self {
        let mut server = QtmServer::new(settings, "2.3 (build 464)".to_owned());
        let client = server.connect(SocketAddr::from(([127, 0, 0, 1], 40_000))).unwrap();
        Self { driver: Driver::new(datagram_port), server, client }
    }

    /// Moves bytes in both directions, for 20 ms.
    pub(crate) fn step(&mut self) {
        let to_server = self.driver.written();
        self.server.receive(self.client, &to_server);
        let bytes = self.server.take_pending(self.client);
        for datagram in self.server.take_datagrams() {
            self.driver.push(&datagram.bytes, true);
        }
        self.driver.push(&bytes, false);
        self.driver.now_ns += 20 * MS;
    }

    pub(crate) fn steps(&mut self, n: usize) {
        (0..n).for_each(|_| self.step());
    }

    /// From the connection to the stream.
    pub(crate) fn start(&mut self) {
        self.driver.command(Command::Identify);
        self.driver.command(Command::Ping { host_ns: 1 });
        self.steps(30);
        assert!(self.driver.reported.hello.is_some(), "{:?}", self.driver.failed);
        self.driver.command(Command::Start { line_bytes_per_s: 0 });
        self.steps(3);
        assert_eq!(self.driver.reported.started, 1);
    }

    pub(crate) fn frame(&mut self, number: u32, time_us: u64, unlabelled: &[u32]) {
        self.frame_with(FrameHeader { time_us, number }, unlabelled, &[]);
    }

    pub(crate) fn frame_with(
        &mut self,
        header: FrameHeader,
        unlabelled: &[u32],
        bodies: &[ServedBody],
    ) {
        let number = header.number;
        let labelled = LABELS.map(|_| marker(number, 0));
        let unlabelled: Vec<_> = unlabelled.iter().map(|id| marker(number, *id)).collect();
        self.server.frame(&ServedFrame {
            header,
            rates: [0; 2],
            labelled: &labelled,
            unlabelled: &unlabelled,
            bodies,
            lacks_bodies: false,
        });
    }
}

/// A marker at a place that follows from its frame.
pub(crate) fn marker(number: u32, id: u32) -> WireMarker {
    WireMarker { position_mm: [number as f32, id as f32, -0.5], id, residual_mm: 0.25 }
}

impl Driver {
    pub(crate) fn host_counters(&self) -> mocapd_drivers::device::LinkCounters {
        self.host.counters()
    }
}

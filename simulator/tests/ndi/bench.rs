//! A host, a line and a device in virtual time.

use mocapd_drivers::device::{
    BodyInfo, Command, DeviceEvent, Hello, LinkBudget, MarkerInfo, MarkerSample, Pose, Protocol,
    Status,
};
use mocapd_drivers::ndi::NdiHost;
use mocapd_drivers::transport::polled::{
    LineCommand, LineCommandReceiver, Request, line_command_channel,
};
use mocapd_simulator::device::LineDevice;
use mocapd_simulator::generator::{JumpSpec, Occlusion};
use mocapd_simulator::ndi::{NdiDevice, NdiSettings};
use mocapd_take::motion::{Motion, Position, is_gap};

pub(super) const MS: u64 = 1_000_000;

/// Timeout of the daemon's reads.
const READ_NS: u64 = 20 * MS;

/// One frame, as the host received it.
#[derive(Debug, Clone)]
pub(super) struct ReceivedFrame {
    pub(super) seq: u32,
    pub(super) ticks: u64,
    pub(super) markers: Vec<MarkerSample>,
}

/// What a line does to an answer.
type Damage = Box<dyn FnMut(&mut Vec<u8>)>;

pub(super) struct Bench {
    pub(super) device: NdiDevice,
    pub(super) host: NdiHost,
    commands: LineCommandReceiver,
    postponed: Option<LineCommand>,
    pub(super) now_ns: u64,
    pub(super) host_baud: u32,
    /// Whether the line transmits a break.
    pub(super) has_break: bool,
    pub(super) breaks: u32,
    /// Above this speed the line garbles every byte.
    pub(super) line_baud_max: u32,
    /// Whether another device on the line sends without end.
    pub(super) babbles: bool,
    /// Damages answers on the line.
    pub(super) damage: Damage,
    in_flight: Vec<u8>,
    /// Every request written.
    pub(super) requests: Vec<Vec<u8>>,
    pub(super) farewell: Vec<Request>,
    pub(super) failed: Option<String>,
    pub(super) hellos: Vec<Hello>,
    pub(super) markers: Vec<MarkerInfo>,
    pub(super) frames: Vec<ReceivedFrame>,
    pub(super) started: u32,
    pub(super) refused: Option<LinkBudget>,
    pub(super) notes: Vec<String>,
    pub(super) status: Option<Status>,
    pub(super) end: Option<Status>,
    pub(super) pongs: Vec<u64>,
    pub(super) bodies: Vec<BodyInfo>,
    /// Number, ticks and poses of each frame.
    pub(super) poses: Vec<(u32, u64, Vec<Pose>)>,
}

impl Bench {
    pub(super) fn new(motion: Motion, settings: NdiSettings, baud_max: u32) -> Self {
        let mut device = NdiDevice::new(motion, settings).unwrap();
        device.keep_frame_log();
        let (sender, commands) = line_command_channel();
        Self {
            device,
            host: NdiHost::new(sender, baud_max),
            commands,
            postponed: None,
            now_ns: 7 * MS,
            host_baud: 3_000_000,
            has_break: true,
            breaks: 0,
            line_baud_max: u32::MAX,
            babbles: false,
            damage: Box::new(|_| {}),
            in_flight: Vec::new(),
            requests: Vec::new(),
            farewell: Vec::new(),
            failed: None,
            hellos: Vec::new(),
            markers: Vec::new(),
            frames: Vec::new(),
            started: 0,
            refused: None,
            notes: Vec::new(),
            status: None,
            end: None,
            pongs: Vec::new(),
            bodies: Vec::new(),
            poses: Vec::new(),
        }
    }

    pub(super) fn send(&mut self, command: Command) {
        let mut out = Vec::new();
        self.host.command(command, &mut out);
        assert!(out.is_empty(), "an NDI host sends line commands");
    }

    pub(super) fn identify(&mut self) {
        self.send(Command::Identify);
        self.run_until(|bench| !bench.hellos.is_empty());
    }

    pub(super) fn start(&mut self) {
        self.send(Command::Start { line_bytes_per_s: 0 });
        let before = self.started;
        self.run_until(|bench| bench.started > before);
    }

    /// Reads until a condition holds; fails after an hour of virtual time.
    pub(super) fn run_until(&mut self, holds: impl Fn(&Self) -> bool) {
        let give_up_ns = self.now_ns + 3_600_000 * MS;
        while !holds(self) {
            assert!(self.now_ns < give_up_ns && self.failed.is_none(), "{:?}", self.failed);
            self.read();
        }
    }

    pub(super) fn run_for(&mut self, ns: u64) {
        let end_ns = self.now_ns + ns;
        while self.now_ns < end_ns {
            self.read();
        }
    }

    /// One read of the daemon, with the processing of its bytes.
    pub(super) fn read(&mut self) {
        self.commands.set_now_ns(self.now_ns);
        let may_read = self.execute();
        let bytes = if may_read { self.receive() } else { Vec::new() };
        self.commands.set_now_ns(self.now_ns);
        let Self {
            host,
            hellos,
            markers,
            frames,
            started,
            refused,
            notes,
            status,
            end,
            pongs,
            bodies,
            poses,
            ..
        } = self;
        host.push(&bytes, &mut |event| match event {
            DeviceEvent::Hello(hello) => hellos.push(hello.clone()),
            DeviceEvent::Markers(table) => *markers = table.to_vec(),
            DeviceEvent::Frame(frame) => frames.push(ReceivedFrame {
                seq: frame.seq,
                ticks: frame.device_ticks,
                markers: frame.markers.to_vec(),
            }),
            DeviceEvent::Started(_) => *started += 1,
            DeviceEvent::Refused(budget) => *refused = Some(budget),
            DeviceEvent::EndOfStream(status) => *end = Some(status),
            DeviceEvent::Pong(pong) => pongs.push(pong.host_ns),
            DeviceEvent::Note(message) => notes.push(message.to_owned()),
            DeviceEvent::Status(now) => *status = Some(now),
            DeviceEvent::Bodies(table) => *bodies = table.to_vec(),
            DeviceEvent::Poses(frame) => {
                poses.push((frame.seq, frame.device_ticks, frame.poses.to_vec()));
            }
            // An NDI system has no sampled channels, and does not say how many poses there were.
            DeviceEvent::SampledGroup(_)
            | DeviceEvent::ForcePlate(_)
            | DeviceEvent::Samples(_)
            | DeviceEvent::EndOfPoses(_)
            | DeviceEvent::Trigger(_)
            | DeviceEvent::Mark(_)
            | DeviceEvent::RateSet(_) => {}
        });
    }

    fn execute(&mut self) -> bool {
        while let Some(order) = self.postponed.take().or_else(|| self.commands.try_recv()) {
            match order {
                LineCommand::Write { request, not_before_ns } => {
                    let early_ns = not_before_ns.saturating_sub(self.now_ns);
                    self.now_ns += early_ns.min(READ_NS);
                    if early_ns > READ_NS {
                        self.postponed = Some(order);
                        return false;
                    }
                    self.requests.push(request.as_bytes().to_vec());
                    let mut bytes = request.as_bytes().to_vec();
                    self.garble(&mut bytes);
                    self.device.poll(self.now_ns);
                    self.device.on_bytes(&bytes, self.now_ns);
                }
                LineCommand::Break => {
                    self.breaks += 1;
                    self.now_ns += 50 * MS;
                    if self.has_break {
                        self.device.on_break(self.now_ns);
                    }
                }
                LineCommand::Baud(baud) => self.host_baud = baud,
                LineCommand::Goodbye(farewell) => self.farewell = farewell,
                LineCommand::Fail(message) | LineCommand::Lost(message) => {
                    self.failed = Some(message);
                }
                LineCommand::Listen(_) | LineCommand::StopListening => {
                    self.failed = Some("a serial line has no datagrams".to_owned());
                }
            }
        }
        true
    }

    /// Garbles bytes that are too fast for the line, or sent at another speed than the receiver's.
    fn garble(&self, bytes: &mut [u8]) {
        let baud = self.device.baud().unwrap();
        if baud != self.host_baud || baud > self.line_baud_max {
            bytes.iter_mut().for_each(|byte| *byte = (*byte ^ 0xA6).wrapping_mul(3));
        }
    }

    /// A piece of an answer, or nothing after the timeout.
    fn receive(&mut self) -> Vec<u8> {
        self.device.poll(self.now_ns);
        let mut answer = self.device.pending().to_vec();
        if !answer.is_empty() {
            self.garble(&mut answer);
            let baud = u64::from(self.device.baud().unwrap());
            self.device.sent(answer.len());
            (self.damage)(&mut answer);
            self.now_ns += answer.len() as u64 * 10_000 * MS / baud / 2;
            self.in_flight.append(&mut answer);
        }
        if self.babbles {
            self.now_ns += MS;
            self.in_flight.clear();
            return (0..90_u8).map(|byte| byte.wrapping_mul(29)).collect();
        }
        if self.in_flight.is_empty() {
            self.now_ns += READ_NS;
            return Vec::new();
        }
        self.now_ns += MS / 10;
        let piece = self.in_flight.len().min(1 + (self.now_ns / 7 % 300) as usize);
        self.in_flight.drain(..piece).collect()
    }

    pub(super) fn requests_as_text(&self) -> Vec<String> {
        let text = |bytes: &Vec<u8>| String::from_utf8_lossy(bytes).trim_end().to_owned();
        self.requests.iter().map(text).collect()
    }
}

pub(super) fn jump(n_markers: usize, rate_hz: f64, seconds: f64) -> Motion {
    let occlusion = Some(Occlusion { fraction: 0.1, mean_gap_s: 0.1 });
    let spec =
        JumpSpec { seconds: Some(seconds), occlusion, n_markers, ..JumpSpec::new(11, rate_hz) };
    spec.generate().unwrap().motion
}

pub(super) fn settings(tools: &[&str], bx2: bool) -> NdiSettings {
    let tools = tools.iter().map(|label| (*label).to_owned()).collect();
    NdiSettings { tools, bx2, ..NdiSettings::default() }
}

/// Asserts that a received frame is a row of the motion, with tools by column and strays in any order.
pub(super) fn assert_is_row(received: &ReceivedFrame, row: &[Position], tools: &[(u16, usize)]) {
    let sorted = |mut positions: Vec<[u32; 3]>| {
        positions.sort_unstable();
        positions
    };
    let bits = |position: &Position| position.map(f32::to_bits);
    for (handle, column) in tools {
        let sample = received.markers.iter().find(|sample| sample.id == *handle).unwrap();
        assert_eq!(sample.occluded, is_gap(row[*column]), "frame {}", received.seq);
        if !sample.occluded {
            assert_eq!(bits(&sample.position_mm), bits(&row[*column]), "frame {}", received.seq);
            assert_eq!(sample.residual_10um, 25);
        }
    }
    let strays = received.markers.iter().filter(|sample| sample.id >= 0x100);
    let got = sorted(strays.map(|sample| bits(&sample.position_mm)).collect());
    let is_stray = |column: &usize| tools.iter().all(|(_, tool)| tool != column);
    let there = (0..row.len()).filter(is_stray).filter(|column| !is_gap(row[*column]));
    let expected = sorted(there.map(|column| bits(&row[column])).collect());
    assert_eq!(got, expected, "frame {}", received.seq);
}

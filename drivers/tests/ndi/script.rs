//! A scripted device: a function from request to reply.

use mocapd_drivers::device::{
    BodyInfo, Command, DeviceEvent, Hello, LinkCounters, MarkerInfo, MarkerSample, Pose, Protocol,
};
use mocapd_drivers::ndi::NdiHost;
use mocapd_drivers::transport::polled::{LineCommand, LineCommandReceiver, line_command_channel};

const MS: u64 = 1_000_000;

type ReplyFn = Box<dyn FnMut(&[u8]) -> Vec<u8>>;

pub(super) struct Script {
    host: NdiHost,
    commands: LineCommandReceiver,
    now_ns: u64,
    reply: ReplyFn,
    pub(super) sent: Vec<String>,
    pub(super) bauds: Vec<u32>,
    pub(super) failed: Option<String>,
    pub(super) hello: Option<Hello>,
    pub(super) markers: Vec<MarkerInfo>,
    /// Number, ticks and markers of each frame.
    pub(super) frames: Vec<(u32, u64, Vec<MarkerSample>)>,
    pub(super) bodies: Vec<BodyInfo>,
    /// Number of the frame, number of the message, ticks and poses of each pose frame.
    pub(super) poses: Vec<(u32, u32, u64, Vec<Pose>)>,
    pub(super) ended: bool,
}

impl Script {
    /// Makes a script from `reply`, with the default replies where it returns none.
    pub(super) fn new(mut reply: impl FnMut(&[u8]) -> Option<Vec<u8>> + 'static) -> Self {
        let (sender, commands) = line_command_channel();
        Self {
            host: NdiHost::new(sender, 921_600),
            commands,
            now_ns: 0,
            reply: Box::new(move |request| reply(request).unwrap_or_else(|| vega_reply(request))),
            sent: Vec::new(),
            bauds: Vec::new(),
            failed: None,
            hello: None,
            markers: Vec::new(),
            frames: Vec::new(),
            bodies: Vec::new(),
            poses: Vec::new(),
            ended: false,
        }
    }

    pub(super) fn command(&mut self, command: Command) {
        self.host.command(command, &mut Vec::new());
    }

    pub(super) fn counters(&self) -> LinkCounters {
        self.host.counters()
    }

    pub(super) fn now_ns(&self) -> u64 {
        self.now_ns
    }

    /// Reads this many times; an empty read takes 20 ms.
    pub(super) fn read(&mut self, times: usize) {
        for _ in 0..times {
            self.commands.set_now_ns(self.now_ns);
            let mut bytes = Vec::new();
            while let Some(command) = self.commands.try_recv() {
                match command {
                    LineCommand::Write { request, not_before_ns } => {
                        self.now_ns = self.now_ns.max(not_before_ns);
                        self.sent.push(String::from_utf8(request.as_bytes().to_vec()).unwrap());
                        bytes = (self.reply)(request.as_bytes());
                    }
                    LineCommand::Break => self.sent.push("(break)".to_owned()),
                    LineCommand::Baud(baud) => self.bauds.push(baud),
                    LineCommand::Goodbye(_)
                    | LineCommand::Listen(_)
                    | LineCommand::StopListening => {}
                    LineCommand::Fail(message) | LineCommand::Lost(message) => {
                        self.failed = Some(message);
                    }
                }
            }
            self.now_ns += if bytes.is_empty() { 20 * MS } else { MS / 10 };
            self.commands.set_now_ns(self.now_ns);
            let Self { hello, markers, frames, bodies, poses, ended, .. } = self;
            self.host.push(&bytes, &mut |event| match event {
                DeviceEvent::Hello(event) => *hello = Some(event.clone()),
                DeviceEvent::Markers(table) => *markers = table.to_vec(),
                DeviceEvent::Frame(f) => frames.push((f.seq, f.device_ticks, f.markers.to_vec())),
                DeviceEvent::Bodies(table) => *bodies = table.to_vec(),
                DeviceEvent::Poses(f) => {
                    poses.push((f.seq, f.number, f.device_ticks, f.poses.to_vec()));
                }
                DeviceEvent::EndOfStream(_) => *ended = true,
                _ => {}
            });
        }
    }

    /// Sets the device up and starts tracking.
    pub(super) fn started(mut self) -> Self {
        self.command(Command::Identify);
        self.read(100);
        assert!(self.hello.is_some() && self.failed.is_none(), "{:?} {:?}", self.failed, self.sent);
        self.command(Command::Start { line_bytes_per_s: 0 });
        // The command and its reply; the next request is a poll.
        self.read(2);
        self
    }
}

/// Default replies: a system like the Vega with one tool.
fn vega_reply(request: &[u8]) -> Vec<u8> {
    match request {
        b"VER:065EE\r" => text(
            "Polaris Vega Control Firmware\nNDI S/N: P9-00123\nCharacterization Date: 03/05/25\n\
             Freeze Tag: Polaris Vega 008\nFreeze Date : 03/05/25\n(C) Northern Digital Inc.\n",
        ),
        b"APIREV:443E\r" => text("G.003.004"),
        b"GET:Param.Tracking.Frame FrequencyEF07\r" => text("Param.Tracking.Frame Frequency=60"),
        b"GET:Param.Tracking.Track FrequencyDD48\r" => text("Param.Tracking.Track Frequency=2"),
        b"PHSR:01E03E\r" | b"PHSR:02E17E\r" | b"PHSR:0321BF\r" => text("00"),
        b"PHSR:04E3FE\r" => text("0101031"),
        _ if request.starts_with(b"PHINF:010005") => {
            text("02000000NDI         00136A1B22C318700449             ")
        }
        // The fixed reply with its checksum.
        _ => b"OKAYA896\r".to_vec(),
    }
}

/// A text reply; its checksum is computed here bit by bit, from the guide's polynomial.
pub(super) fn text(text: &str) -> Vec<u8> {
    format!("{text}{:04X}\r", crc(text.as_bytes())).into_bytes()
}

/// A binary reply around a block.
pub(super) fn binary(block: &[u8]) -> Vec<u8> {
    let mut out = vec![0xC4, 0xA5];
    out.extend((block.len() as u16).to_le_bytes());
    out.extend(crc(&out).to_le_bytes());
    out.extend(block);
    out.extend(crc(block).to_le_bytes());
    out
}

/// x^16 + x^15 + x^2 + 1, least significant bit first.
pub(super) fn crc(bytes: &[u8]) -> u16 {
    let mut crc = 0_u16;
    for byte in bytes {
        for bit in 0..8 {
            let differs = (crc ^ u16::from(*byte) >> bit) & 1 == 1;
            crc >>= 1;
            if differs {
                crc ^= 0xA001;
            }
        }
    }
    crc
}

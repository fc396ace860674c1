//! A device that is a function of the request.

use mocapd_drivers::device::{
    Command, DeviceEvent, Hello, LinkCounters, MarkerInfo, MarkerSample, Protocol,
};
use mocapd_drivers::ndi::NdiHost;
use mocapd_drivers::transport::turns::{Order, Orders, desk};

const MS: u64 = 1_000_000;

type Answer = Box<dyn FnMut(&[u8]) -> Vec<u8>>;

pub(super) struct Script {
    host: NdiHost,
    orders: Orders,
    now_ns: u64,
    answer: Answer,
    pub(super) said: Vec<String>,
    pub(super) bauds: Vec<u32>,
    pub(super) failed: Option<String>,
    pub(super) hello: Option<Hello>,
    pub(super) markers: Vec<MarkerInfo>,
    /// Number, ticks, markers.
    pub(super) frames: Vec<(u32, u64, Vec<MarkerSample>)>,
    pub(super) ended: bool,
}

impl Script {
    /// `answer` is asked first, and the usual answers where it gives none.
    pub(super) fn new(mut answer: impl FnMut(&[u8]) -> Option<Vec<u8>> + 'static) -> Self {
        let (desk, orders) = desk();
        Self {
            host: NdiHost::new(desk, 921_600),
            orders,
            now_ns: 0,
            answer: Box::new(move |request| answer(request).unwrap_or_else(|| usual(request))),
            said: Vec::new(),
            bauds: Vec::new(),
            failed: None,
            hello: None,
            markers: Vec::new(),
            frames: Vec::new(),
            ended: false,
        }
    }

    pub(super) fn say(&mut self, command: Command) {
        self.host.command(command, &mut Vec::new());
    }

    pub(super) fn counters(&self) -> LinkCounters {
        self.host.counters()
    }

    pub(super) fn now_ns(&self) -> u64 {
        self.now_ns
    }

    /// Reads so often; a read that brings nothing takes 20 ms.
    pub(super) fn read(&mut self, times: usize) {
        for _ in 0..times {
            self.orders.set_now_ns(self.now_ns);
            let mut bytes = Vec::new();
            while let Some(order) = self.orders.next_order() {
                match order {
                    Order::Write { request, not_before_ns } => {
                        self.now_ns = self.now_ns.max(not_before_ns);
                        self.said.push(String::from_utf8(request.as_bytes().to_vec()).unwrap());
                        bytes = (self.answer)(request.as_bytes());
                    }
                    Order::Break => self.said.push("(break)".to_owned()),
                    Order::Baud(baud) => self.bauds.push(baud),
                    Order::Farewell(_) => {}
                    Order::Fail(words) => self.failed = Some(words),
                }
            }
            self.now_ns += if bytes.is_empty() { 20 * MS } else { MS / 10 };
            self.orders.set_now_ns(self.now_ns);
            let Self { hello, markers, frames, ended, .. } = self;
            self.host.push(&bytes, &mut |event| match event {
                DeviceEvent::Hello(said) => *hello = Some(said.clone()),
                DeviceEvent::Markers(table) => *markers = table.to_vec(),
                DeviceEvent::Frame(f) => frames.push((f.seq, f.device_ticks, f.markers.to_vec())),
                DeviceEvent::EndOfStream(_) => *ended = true,
                _ => {}
            });
        }
    }

    /// Set up, and tracking.
    pub(super) fn started(mut self) -> Self {
        self.say(Command::Identify);
        self.read(100);
        assert!(self.hello.is_some() && self.failed.is_none(), "{:?} {:?}", self.failed, self.said);
        self.say(Command::Start { line_bytes_per_s: 0 });
        // The command, and the answer: what is said next is a poll.
        self.read(2);
        self
    }
}

/// A system of the Vega's kind with one tool, as its answers go over the wire.
fn usual(request: &[u8]) -> Vec<u8> {
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
        // The fixed answer, checksum and all.
        _ => b"OKAYA896\r".to_vec(),
    }
}

/// A text answer; its checksum is worked out here bit by bit, after the guide's polynomial.
pub(super) fn text(text: &str) -> Vec<u8> {
    format!("{text}{:04X}\r", crc(text.as_bytes())).into_bytes()
}

/// A binary answer around a block.
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

//! NDI Polaris and Vega optical trackers over their Combined API on a serial line: `docs/ndi.md`.
//!
//! The device only replies to requests. [`NdiHost`] therefore sends
//! [line commands](crate::transport::polled), which the transport executes before the next read.

mod bring_up;
mod frame;
mod message;
mod strays;
mod tracking;

use self::{
    frame::{FrameData, STRAYS_MAX, TOOLS_MAX},
    message::{REPLY_BYTES_MAX, speed_at_most},
    strays::StrayTracker,
    tracking::{PollPacer, TrackingRun},
};
use crate::{
    device::{
        BodyInfo, Claim, Command, DeviceEvent, Family, Hello, LinkCounters, MarkerInfo,
        MarkerSample, Pong, Protocol, rate_reply,
    },
    transport::{
        Transport,
        polled::{LineCommandSender, PolledTransport, Request, line_command_channel},
    },
    uri::Location,
};
pub use message::{
    BAUD_AT_RESET, BAUDS, ReceivedRequest, RequestReader, code, crc16, put_binary, put_text,
};

pub(crate) const FAMILY: Family = Family {
    name: "ndi",
    claims: |candidate| {
        let is_ndi = |name: &str| name.contains("northern digital") || name.starts_with("ndi ");
        match (candidate.is_serial(), candidate.name_matches(is_ndi)) {
            (true, true) => Claim::Certain,
            (true, false) => Claim::Possible,
            (false, _) => Claim::No,
        }
    },
    protocol: |location| {
        let baud = if let Location::Serial { baud, .. } = location { *baud } else { None };
        // A sender without a receiver, until `attach` connects the protocol to a line.
        let (sender, _) = line_command_channel();
        Box::new(NdiHost::new(sender, baud.unwrap_or(BAUD_MAX_DEFAULT)))
    },
};

const MS: u64 = 1_000_000;

/// Highest baud rate to try when the URI gives none: the one that common adapters and systems since the
/// Polaris Spectra support.
pub const BAUD_MAX_DEFAULT: u32 = 921_600;

/// Longest delay of a pong during bring-up. The host then repeats its request, which gives slow tools the
/// time to initialize.
const PING_WAIT_NS: u64 = 4_000 * MS;

/// Receiver of the decoded events.
type OnEvent<'a> = &'a mut dyn FnMut(DeviceEvent<'_>);

/// Steps of preparing port handles, in order. The number is the `PHSR` option that lists the handles due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum PortStep {
    Free = 1,
    Initialize = 2,
    Enable = 3,
    Describe = 4,
}

/// Purpose of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Task {
    /// Probe for a device, at a step of the search.
    Probe(usize),
    /// Wait for `RESET` after a break, at a step of the search.
    Break(usize),
    /// Change of the baud rate, as an index in `BAUDS`.
    Comm(usize),
    /// Stop tracking, which must precede initialization.
    LeaveTracking,
    /// Verify the new baud rate with a version request.
    Verify,
    Version,
    ApiRevision,
    FrameFrequency,
    TrackFrequency,
    /// List the handles due for a step.
    List(PortStep),
    /// Perform a step for one handle.
    Port(PortStep, u8),
    Start,
    Poll,
    Stop,
}

/// Outcome of a request.
#[derive(Debug, Clone, Copy)]
enum Outcome<'a> {
    Text(&'a str),
    Refused(u8),
    Timeout,
}

/// A request without a reply so far.
#[derive(Debug, Clone, Copy)]
struct Pending {
    task: Task,
    request: Request,
    /// Time without a received byte after which the request has timed out.
    timeout_ns: u64,
    attempts: u32,
    /// Time of the last activity: when the request was sent, or a byte arrived.
    active_ns: u64,
}

/// Discards bytes after damage until the line is silent.
#[derive(Debug, Clone, Copy)]
struct Drain {
    since_ns: u64,
    last_byte_ns: u64,
}

/// State of the driver and its device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum HostState {
    /// Not started, or failed.
    Off,
    /// Searching for the device and setting it up.
    BringUp,
    /// Set up, not tracking.
    Ready,
    /// Tracking, or about to.
    Tracking,
}

/// A ping whose reply waits for the end of the bring-up.
#[derive(Debug, Clone, Copy)]
struct Ping {
    /// Host time of the ping, returned in the pong.
    host_ns: u64,
    /// Time of the first such ping, and the number of valid replies until then.
    received_ns: u64,
    messages: u64,
}

/// Commands of the host that are not completed yet.
#[derive(Debug, Clone, Copy, Default)]
struct PendingCommands {
    hello: bool,
    start: bool,
    stop: bool,
    set_rate: Option<u32>,
    ping: Option<Ping>,
}

/// The [`Protocol`] of NDI systems, sans-io.
#[derive(Debug)]
pub struct NdiHost {
    line: LineCommandSender,
    state: HostState,
    todo: PendingCommands,
    pending: Option<Pending>,
    drain: Option<Drain>,
    /// Bytes received since the request, at most `REPLY_BYTES_MAX`.
    reply: Vec<u8>,
    counters: LinkCounters,
    hello: Hello,
    table: Vec<MarkerInfo>,
    /// The tools as bodies.
    bodies: Vec<BodyInfo>,
    /// Current baud rate, and the index in `BAUDS` of the highest to try.
    baud: u32,
    speed_max: usize,
    /// Index in `BAUDS` of the requested highest baud rate. A failed rate lowers `speed_max`, until a reattach,
    /// or until the line has carried [`RELIABLE_FRAMES`](tracking::RELIABLE_FRAMES) frames.
    speed_requested: usize,
    /// Handles left to process in this step, and the number of rounds of initialization.
    handles_left: Vec<u8>,
    rounds: u32,
    bx2: bool,
    /// Increment of the frame number from one tracked frame to the next.
    divisor: u32,
    poll: Request,
    polls_lost: u32,
    pacer: PollPacer,
    frame: FrameData,
    strays: StrayTracker,
    samples: Vec<MarkerSample>,
    run: TrackingRun,
}

impl NdiHost {
    /// Makes a driver for a device in unknown state on a line of at most `baud_max` baud.
    #[must_use]
    pub fn new(line: LineCommandSender, baud_max: u32) -> Self {
        Self {
            line,
            state: HostState::Off,
            todo: PendingCommands::default(),
            pending: None,
            drain: None,
            reply: Vec::with_capacity(REPLY_BYTES_MAX),
            counters: LinkCounters::default(),
            hello: Hello::default(),
            table: Vec::new(),
            bodies: Vec::new(),
            baud: BAUD_AT_RESET,
            speed_max: speed_at_most(baud_max),
            speed_requested: speed_at_most(baud_max),
            handles_left: Vec::new(),
            rounds: 0,
            bx2: false,
            divisor: 1,
            poll: Request::default(),
            polls_lost: 0,
            pacer: PollPacer::default(),
            frame: FrameData::new(),
            strays: StrayTracker::new(),
            samples: Vec::with_capacity(TOOLS_MAX + STRAYS_MAX),
            run: TrackingRun::default(),
        }
    }

    /// Completes pending commands of the host as soon as the state permits.
    fn complete_commands(&mut self, on_event: OnEvent<'_>) {
        if self.state == HostState::Ready && std::mem::take(&mut self.todo.hello) {
            on_event(DeviceEvent::Hello(&self.hello));
            on_event(DeviceEvent::Markers(&self.table));
            on_event(DeviceEvent::Bodies(&self.bodies));
        }
        if self.state == HostState::Ready && self.pending.is_none() {
            if std::mem::take(&mut self.todo.stop) {
                on_event(DeviceEvent::EndOfStream(self.run.status()));
            }
            if let Some(rate_millihertz) = self.todo.set_rate.take() {
                on_event(rate_reply(rate_millihertz, self.hello.rate_millihertz));
            }
            if std::mem::take(&mut self.todo.start) {
                self.start();
            }
        }
        let Some(Ping { host_ns, received_ns, messages }) = self.todo.ping else { return };
        let waited_ns = self.line.now_ns().saturating_sub(received_ns);
        let waited = waited_ns > PING_WAIT_NS && self.counters.messages > messages;
        if self.state == HostState::Ready || (self.state == HostState::BringUp && waited) {
            self.todo.ping = None;
            on_event(DeviceEvent::Pong(Pong { host_ns, device_ticks: self.run.ticks }));
        }
    }
}

impl Protocol for NdiHost {
    fn attach(&mut self, line: Box<dyn Transport>) -> Box<dyn Transport> {
        let (sender, receiver) = line_command_channel();
        self.line = sender;
        self.state = HostState::Off;
        self.todo = PendingCommands::default();
        (self.pending, self.drain) = (None, None);
        self.run = TrackingRun::default();
        self.speed_max = self.speed_requested;
        Box::new(PolledTransport::new(line, receiver))
    }

    fn push(&mut self, bytes: &[u8], on_event: &mut dyn FnMut(DeviceEvent<'_>)) {
        self.counters.bytes += bytes.len() as u64;
        self.receive(bytes, on_event);
        self.complete_commands(on_event);
    }

    /// Appends nothing: requests are line commands, sent one by one.
    fn command(&mut self, command: Command, _: &mut Vec<u8>) {
        match command {
            Command::Identify => {
                self.todo.hello = true;
                // By contract a device is stopped after its Hello.
                self.todo.stop |= self.state == HostState::Tracking;
                if self.state == HostState::Off {
                    self.start_search();
                }
            }
            Command::Start { .. } => self.todo.start = true,
            Command::Stop => {
                self.todo.start = false;
                self.todo.stop = matches!(self.state, HostState::Ready | HostState::Tracking);
            }
            Command::SetRate(rate_millihertz) => self.todo.set_rate = Some(rate_millihertz),
            // The API has no request for the time. A pong only means that the device is present, which frames show
            // while it tracks.
            Command::Ping { .. } if self.state == HostState::Tracking => {}
            // A repeated ping keeps its place.
            Command::Ping { host_ns } if self.todo.ping.is_some_and(|p| p.host_ns == host_ns) => {}
            Command::Ping { host_ns } => {
                let (received_ns, messages) = (self.line.now_ns(), self.counters.messages);
                self.todo.ping = Some(Ping { host_ns, received_ns, messages });
            }
        }
    }

    fn counters(&self) -> LinkCounters {
        self.counters
    }
}

//! The host's end: what it knows of the device, and what it was asked for.

use super::{
    frame::{STRAYS_MAX, Seen, TOOLS_MAX},
    message::{BAUD_AT_RESET, REPLY_BYTES_MAX, at_most},
    run::{Pace, Run},
    strays::Strays,
};
use crate::{
    device::{
        Command, DeviceEvent, Hello, LinkBudget, LinkCounters, MarkerInfo, MarkerSample, Pong,
        Protocol,
    },
    transport::{
        Transport,
        turns::{Desk, Request, TurnTransport, desk},
    },
};

pub(super) const MS: u64 = 1_000_000;

/// The highest speed that is asked for when the URI gives none: what common adapters and the
/// systems since the Polaris Spectra carry.
pub const BAUD_MAX_DEFAULT: u32 = 921_600;

/// How long a host's ping waits for the bring-up to end. A host asks again after that, which gives
/// tools that are slow to initialize the time they need.
const PING_WAITS_NS: u64 = 4_000 * MS;

/// Who gets the events.
pub(super) type OnEvent<'a> = &'a mut dyn FnMut(DeviceEvent<'_>);

/// What is done with port handles, in this order; the number is that of `PHSR` for the handles that wait for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    Free = 1,
    Initialize = 2,
    Enable = 3,
    Describe = 4,
}

/// What a request is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Task {
    /// Is anybody there? The step of the search.
    Seek(usize),
    /// A break was sent, and `RESET` should come.
    Break(usize),
    /// Another speed, by its place in `BAUDS`.
    Comm(usize),
    /// It must leave tracking before it can be initialized.
    Release,
    /// Does it answer at the new speed, and with what?
    Check,
    Version,
    ApiRevision,
    FrameFrequency,
    TrackFrequency,
    /// Which handles is this to be done with?
    List(Step),
    /// Do it with one of them.
    Port(Step, u8),
    Start,
    Poll,
    Stop,
}

/// What became of a request.
#[derive(Debug, Clone, Copy)]
pub(super) enum Outcome<'a> {
    Text(&'a str),
    Refused(u8),
    Silence,
}

/// A request that was sent and not answered.
#[derive(Debug, Clone, Copy)]
pub(super) struct Asked {
    pub(super) task: Task,
    pub(super) request: Request,
    /// After so long without a byte it counts as silence.
    pub(super) patience_ns: u64,
    pub(super) tries: u32,
    /// When it was sent, or its last byte came.
    pub(super) active_ns: u64,
}

/// After damage.
#[derive(Debug, Clone, Copy)]
pub(super) struct Drain {
    pub(super) since_ns: u64,
    pub(super) last_byte_ns: u64,
}

/// What the device is doing, as far as is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum State {
    /// Nothing was asked yet, or it failed.
    Off,
    /// Being found and set up.
    BringUp,
    /// Set up, not tracking.
    Ready,
    /// Tracking, or about to.
    Tracking,
}

/// A ping that waits for the bring-up.
#[derive(Debug, Clone, Copy)]
struct Ping {
    /// The host's time, which it gets back.
    host_ns: u64,
    /// When it was first said, and the answers that had come by then.
    said_ns: u64,
    messages: u64,
}

/// What the host asked for and has not got.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Owed {
    pub(super) hello: bool,
    pub(super) start: bool,
    pub(super) stop: bool,
    set_rate: Option<u32>,
    ping: Option<Ping>,
}

/// An NDI system as a [`Protocol`], sans-io.
#[derive(Debug)]
pub struct NdiHost {
    pub(super) desk: Desk,
    pub(super) state: State,
    pub(super) owed: Owed,
    pub(super) asked: Option<Asked>,
    pub(super) drain: Option<Drain>,
    /// The bytes since the request, up to `REPLY_BYTES_MAX`.
    pub(super) reply: Vec<u8>,
    pub(super) counters: LinkCounters,
    pub(super) hello: Hello,
    pub(super) table: Vec<MarkerInfo>,
    /// The line's speed now, and the place in `BAUDS` of the highest one to try.
    pub(super) baud: u32,
    pub(super) ceiling: usize,
    /// The same as it was asked for: one that failed lowers the ceiling, until the line is another one or has carried
    /// [`FRAMES_SOUND`](super::run::FRAMES_SOUND) frames.
    pub(super) asked_for: usize,
    /// Handles that wait for their turn, and how often tools were asked for.
    pub(super) todo: Vec<u8>,
    pub(super) rounds: u32,
    pub(super) bx2: bool,
    /// Frame numbers from one tracked frame to the next.
    pub(super) divisor: u32,
    pub(super) poll: Request,
    pub(super) polls_lost: u32,
    pub(super) pace: Pace,
    pub(super) seen: Seen,
    pub(super) strays: Strays,
    pub(super) samples: Vec<MarkerSample>,
    pub(super) run: Run,
}

impl NdiHost {
    /// A device of which nothing is known, on a line that carries at most `baud_max`.
    #[must_use]
    pub fn new(desk: Desk, baud_max: u32) -> Self {
        Self {
            desk,
            state: State::Off,
            owed: Owed::default(),
            asked: None,
            drain: None,
            reply: Vec::with_capacity(REPLY_BYTES_MAX),
            counters: LinkCounters::default(),
            hello: Hello::default(),
            table: Vec::new(),
            baud: BAUD_AT_RESET,
            ceiling: at_most(baud_max),
            asked_for: at_most(baud_max),
            todo: Vec::new(),
            rounds: 0,
            bx2: false,
            divisor: 1,
            poll: Request::default(),
            polls_lost: 0,
            pace: Pace::default(),
            seen: Seen::new(),
            strays: Strays::new(),
            samples: Vec::with_capacity(TOOLS_MAX + STRAYS_MAX),
            run: Run::default(),
        }
    }

    /// What the host asked for, as soon as it can be had.
    fn settle(&mut self, on_event: OnEvent<'_>) {
        if self.state == State::Ready && std::mem::take(&mut self.owed.hello) {
            on_event(DeviceEvent::Hello(&self.hello));
            on_event(DeviceEvent::Markers(&self.table));
        }
        if self.state == State::Ready && self.asked.is_none() {
            if std::mem::take(&mut self.owed.stop) {
                on_event(DeviceEvent::EndOfStream(self.run.status()));
            }
            if let Some(rate_mhz) = self.owed.set_rate.take() {
                on_event(self.rate_answer(rate_mhz));
            }
            if std::mem::take(&mut self.owed.start) {
                self.start();
            }
        }
        let now_ns = self.desk.now_ns();
        let Some(Ping { host_ns, said_ns, messages }) = self.owed.ping else { return };
        let waited =
            now_ns.saturating_sub(said_ns) > PING_WAITS_NS && self.counters.messages > messages;
        if self.state == State::Ready || (self.state == State::BringUp && waited) {
            self.owed.ping = None;
            let device_ticks = self.run.ticks;
            on_event(DeviceEvent::Pong(Pong { host_ns, device_ticks }));
        }
    }

    /// The rate is the device's own setting, which this driver reads and does not change.
    fn rate_answer(&self, rate_mhz: u32) -> DeviceEvent<'static> {
        if rate_mhz == self.hello.rate_mhz {
            return DeviceEvent::RateSet(rate_mhz);
        }
        DeviceEvent::Refused(LinkBudget {
            needed_bytes_per_s: 0,
            available_bytes_per_s: u64::MAX,
            rate_fits_mhz: self.hello.rate_mhz,
        })
    }
}

impl Protocol for NdiHost {
    fn attach(&mut self, line: Box<dyn Transport>) -> Box<dyn Transport> {
        let (desk, orders) = desk();
        self.desk = desk;
        self.state = State::Off;
        self.owed = Owed::default();
        (self.asked, self.drain) = (None, None);
        self.run = Run::default();
        self.ceiling = self.asked_for;
        Box::new(TurnTransport::new(line, orders))
    }

    fn push(&mut self, bytes: &[u8], on_event: &mut dyn FnMut(DeviceEvent<'_>)) {
        self.counters.bytes += bytes.len() as u64;
        self.receive(bytes, on_event);
        self.settle(on_event);
    }

    /// Nothing is appended: requests go over the desk, each in its turn.
    fn command(&mut self, command: Command, _: &mut Vec<u8>) {
        match command {
            Command::Identify => {
                self.owed.hello = true;
                // A device that has said Hello is stopped.
                self.owed.stop |= self.state == State::Tracking;
                if self.state == State::Off {
                    self.seek_first();
                }
            }
            Command::Start { .. } => self.owed.start = true,
            Command::Stop => {
                self.owed.start = false;
                self.owed.stop = matches!(self.state, State::Ready | State::Tracking);
            }
            Command::SetRate(rate_mhz) => self.owed.set_rate = Some(rate_mhz),
            // No command asks for the time: what a pong says is that the device is there, and while
            // it tracks its frames say that.
            Command::Ping { .. } if self.state == State::Tracking => {}
            // Said again, it waits on.
            Command::Ping { host_ns } if self.owed.ping.is_some_and(|p| p.host_ns == host_ns) => {}
            Command::Ping { host_ns } => {
                let (said_ns, messages) = (self.desk.now_ns(), self.counters.messages);
                self.owed.ping = Some(Ping { host_ns, said_ns, messages });
            }
        }
    }

    fn counters(&self) -> LinkCounters {
        self.counters
    }
}

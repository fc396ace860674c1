//! Replays a raw log as the device that it was recorded from. Sans-io: it sends the logged bytes at the logged times,
//! to a host that repeats the logged exchange of commands.
//!
//! The bytes are passed on unchanged, except for Pongs: a Pong echoes the time of its Ping, and the pings of the replay
//! carry other times than the logged ones.

use std::collections::{HashMap, VecDeque};

use mocapd_drivers::device::{Command, DeviceEvent, Pong, Protocol};
use mocapd_drivers::link::{DeviceLink, HostLink};
use mocapd_drivers::raw_log::{Entry, RawLogError, Record, records};

use crate::device::{LineDevice, SentFrame, SentLog};

/// Maximum number of commands that a host may send ahead of the log. A host repeats a command five times at most.
const RECEIVED_MAX: usize = 16;

/// Why a log cannot be replayed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LogDeviceError {
    /// The file is not a readable log.
    #[error(transparent)]
    Log(#[from] RawLogError),
    /// The log is from a device of another protocol.
    #[error(
        "this log was recorded with the driver '{driver}', but only logs of the link protocol (dvmc) can be replayed: an NDI \
         system needs breaks and changes of line speed, which a pty does not carry, and a QTM is on the network"
    )]
    Driver {
        /// The driver in the log.
        driver: String,
    },
    /// The log holds no bytes from the device.
    #[error("nothing to replay: the log has no bytes from the device")]
    Silent,
    /// The log is damaged before the first bytes from the device.
    #[error("nothing to replay: the log breaks off before the first bytes from the device: {0}")]
    Unreadable(RawLogError),
    /// The requested speed is out of range.
    #[error("speed {found} is out of range: expected 0.001 to 1000")]
    Speed {
        /// The requested speed.
        found: f64,
    },
}

/// Why a replay is incomplete.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LogProblem {
    /// The log is not readable to its end.
    #[error(transparent)]
    Unreadable(#[from] RawLogError),
    /// The recorder could not write all bytes to the log.
    #[error("{bytes} bytes are missing from the log: the disk was too slow for the recorder")]
    Missing {
        /// Total of all gaps, bytes.
        bytes: u64,
    },
}

/// A device that replays a raw log.
#[derive(Debug)]
pub struct LogDevice {
    steps: Steps,
    speed: f64,
    next: usize,
    /// A time of the log and the caller's time that corresponds to it, nanoseconds.
    anchor: Option<(u64, u64)>,
    /// Bytes of the current step that are sent.
    offset: usize,
    received: VecDeque<Barrier>,
    host: DeviceLink,
    pongs: PongRewriter,
    out: Vec<u8>,
    /// Before Start, when a host waits for the Pong to its Ping.
    handshaking: bool,
    /// Whether the host has sent Stop and no Start since. An Identify then comes from a host that opens the line.
    stopped: bool,
    /// Whether a Start was received since the line was opened.
    started: bool,
    plugged: bool,
    /// Whether the log is over without an end of stream: the device has disappeared.
    gone: bool,
    /// Whether the line is open and no host has sent anything yet.
    awaits_host: bool,
    log: SentLog,
    problems: Vec<LogProblem>,
}

impl LogDevice {
    /// Creates a device that waits for its host and replays the log at `speed` times the logged speed.
    ///
    /// # Errors
    /// When the log is unreadable or holds no bytes of the device, is of another protocol, or the speed is out of
    /// range.
    pub fn new(log: &[u8], speed: f64) -> Result<Self, LogDeviceError> {
        if !(0.001..=1000.0).contains(&speed) {
            return Err(LogDeviceError::Speed { found: speed });
        }
        let steps = Steps::read(log).map_err(|error| match error {
            RawLogError::CutOff { .. } => LogDeviceError::Unreadable(error),
            _ => LogDeviceError::Log(error),
        })?;
        if steps.bytes.is_empty() {
            return Err(steps.problem.map_or(LogDeviceError::Silent, LogDeviceError::Unreadable));
        }
        if steps.driver != "dvmc" {
            return Err(LogDeviceError::Driver { driver: steps.driver });
        }
        let mut problems: Vec<_> = steps.problem.iter().cloned().map(LogProblem::from).collect();
        if steps.missing_bytes > 0 {
            problems.push(LogProblem::Missing { bytes: steps.missing_bytes });
        }
        Ok(Self {
            steps,
            speed,
            next: 0,
            anchor: None,
            offset: 0,
            received: VecDeque::with_capacity(RECEIVED_MAX),
            host: DeviceLink::new(),
            pongs: PongRewriter::new(),
            out: Vec::new(),
            handshaking: true,
            stopped: false,
            started: false,
            plugged: true,
            gone: false,
            awaits_host: true,
            log: SentLog::default(),
            problems,
        })
    }

    /// Why the replay is incomplete; empty for a whole log.
    #[must_use]
    pub fn problems(&self) -> &[LogProblem] {
        &self.problems
    }

    /// Whether the cable is pulled in the log, which needs a line that can come back under the same name.
    #[must_use]
    pub fn unplugs(&self) -> bool {
        self.steps.unplugs()
    }

    fn execute(&mut self, command: Command, now_ns: u64) {
        if let Command::Ping { host_ns } = command {
            self.pongs.ping(host_ns, now_ns);
        }
        self.stopped |= command == Command::Stop;
        let Some(barrier) = Barrier::of(command) else { return };
        if barrier == Barrier::Identify && self.is_another_host() {
            self.rewind();
        }
        self.stopped &= barrier != Barrier::Start;
        if self.received.len() < RECEIVED_MAX {
            self.received.push_back(barrier);
        }
    }

    /// Whether an Identify comes from a host that has just opened the line, rather than from one that lost its answers.
    fn is_another_host(&self) -> bool {
        let is_over = self.next == self.steps.steps.len();
        let is_awaited = self.next_barrier() == Some(Barrier::Identify) && !self.started;
        is_over || (self.stopped && !is_awaited)
    }

    fn next_barrier(&self) -> Option<Barrier> {
        self.steps.steps.get(self.next..)?.iter().find_map(|step| match step.action {
            Action::Await(barrier) => Some(barrier),
            _ => None,
        })
    }

    /// Skips to the step that waits for the command received, unless the cable is pulled before it. A host that needs
    /// fewer tries than the logged one does not send every command that the log waits for.
    fn skip_to_received(&mut self) -> bool {
        let Some(barrier) = self.received.pop_front() else { return false };
        let rest = self.steps.steps.get(self.next..).unwrap_or_default();
        let mut until_pulled = rest.iter().take_while(|step| step.action != Action::Unplug);
        let Some(ahead) = until_pulled.position(|s| s.action == Action::Await(barrier)) else {
            return false;
        };
        self.received.push_front(barrier);
        (self.next, self.offset) = (self.next + ahead, 0);
        true
    }

    /// Restarts the log from its first Identify, for a new host.
    fn rewind(&mut self) {
        let is_first = |step: &Step| step.action == Action::Await(Barrier::Identify);
        self.next = self.steps.steps.iter().position(is_first).unwrap_or(0);
        (self.offset, self.anchor) = (0, None);
        self.received.clear();
        self.pongs.clear();
        self.out.clear();
        (self.handshaking, self.started) = (true, false);
    }

    /// Converts times of the log to the caller's; 0 before the first anchor.
    fn clock(&self) -> impl Fn(u64) -> u64 + use<> {
        let (anchor, speed) = (self.anchor, self.speed);
        move |at_ns| {
            let Some((log_ns, caller_ns)) = anchor else { return 0 };
            let apart_ns = (at_ns.abs_diff(log_ns) as f64 / speed) as u64;
            if at_ns < log_ns {
                caller_ns.saturating_sub(apart_ns)
            } else {
                caller_ns.saturating_add(apart_ns)
            }
        }
    }

    /// Does the steps that are due, and returns the time of the next.
    fn play(&mut self, now_ns: u64) -> u64 {
        while let Some(step) = self.steps.steps.get(self.next).copied() {
            if let Action::Await(barrier) = step.action {
                if !self.received.contains(&barrier) {
                    if self.skip_to_received() {
                        continue;
                    }
                    return u64::MAX;
                }
                while self.received.pop_front().is_some_and(|other| other != barrier) {}
                self.log.starts += u64::from(barrier == Barrier::Start);
                self.handshaking = barrier != Barrier::Start;
                self.started |= barrier == Barrier::Start;
                self.anchor = Some((step.at_ns, now_ns));
                self.next += 1;
                continue;
            }
            let due_ns = self.clock()(step.at_ns);
            if due_ns > now_ns {
                return due_ns;
            }
            match step.action {
                Action::Send { start, end } => {
                    let bytes = self.steps.bytes.get(start + self.offset..end).unwrap_or_default();
                    let (pings, due_ns) = (&self.steps.pings, self.clock());
                    let ping_ns = |host_ns: u64| pings.get(&host_ns).map(|at_ns| due_ns(*at_ns));
                    let out = &mut self.out;
                    let n = self.pongs.pass(bytes, now_ns, self.handshaking, ping_ns, out);
                    self.offset += n;
                    if n < bytes.len() {
                        return u64::MAX;
                    }
                }
                Action::Unplug | Action::Disappear => {
                    self.pongs.flush(&mut self.out);
                    if !self.out.is_empty() {
                        // Bytes sent before the cable was pulled still reach the host.
                        return now_ns;
                    }
                    if step.action == Action::Disappear {
                        self.gone = true;
                        return u64::MAX;
                    }
                    self.plugged = false;
                }
                Action::PlugIn => {
                    (self.plugged, self.awaits_host, self.handshaking) = (true, true, true);
                    (self.started, self.stopped) = (false, false);
                    self.pongs.clear();
                    self.received.clear();
                }
                Action::Await(_) => {}
            }
            self.offset = 0;
            self.next += 1;
            self.anchor.get_or_insert((step.at_ns, now_ns));
            if self.awaits_host {
                return u64::MAX;
            }
        }
        self.pongs.flush(&mut self.out);
        u64::MAX
    }
}

impl LineDevice for LogDevice {
    fn on_bytes(&mut self, bytes: &[u8], now_ns: u64) {
        if !self.plugged || self.gone {
            return;
        }
        self.awaits_host = false;
        let mut commands = Vec::new();
        self.host.push(bytes, &mut |command| commands.push(command));
        for command in commands {
            self.execute(command, now_ns);
        }
    }

    fn poll(&mut self, now_ns: u64) -> u64 {
        if self.awaits_host && self.plugged { u64::MAX } else { self.play(now_ns) }
    }

    fn pending(&self) -> &[u8] {
        &self.out
    }

    fn sent(&mut self, n: usize) {
        let n = n.min(self.out.len());
        self.log.bytes_sent += n as u64;
        self.out.drain(..n);
    }

    fn has_ended(&self) -> bool {
        self.next == self.steps.steps.len() && self.out.is_empty()
    }

    fn is_plugged(&self) -> bool {
        self.plugged
    }

    fn is_gone(&self) -> bool {
        self.gone
    }

    fn log(&self) -> SentLog {
        self.log.clone()
    }

    /// A raw log holds bytes, not frames: there is nothing to keep.
    fn keep_frame_log(&mut self) {}

    fn take_frames(&mut self) -> Vec<SentFrame> {
        Vec::new()
    }
}

/// A command that the host must send before the replay continues. Ping and Stop may come at any time: no step waits for
/// them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Barrier {
    Identify,
    SetRate,
    Start,
}

impl Barrier {
    fn of(command: Command) -> Option<Self> {
        match command {
            Command::Identify => Some(Self::Identify),
            Command::SetRate(_) => Some(Self::SetRate),
            Command::Start { .. } => Some(Self::Start),
            Command::Stop | Command::Ping { .. } => None,
        }
    }
}

/// What a step does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Action {
    /// Sends this range of [`Steps::bytes`].
    Send { start: usize, end: usize },
    /// Waits for a command of the host.
    Await(Barrier),
    /// Pulls the cable.
    Unplug,
    /// Plugs the cable in again.
    PlugIn,
    /// Ends a log whose stream had not ended: what the device sent afterwards is unknown.
    Disappear,
}

/// A step and its time in the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Step {
    at_ns: u64,
    action: Action,
}

/// The steps of a log.
#[derive(Debug, Default)]
struct Steps {
    steps: Vec<Step>,
    /// All bytes from the device.
    bytes: Vec<u8>,
    /// Time of each Ping in the log, by the host time that it carries.
    pings: HashMap<u64, u64>,
    driver: String,
    missing_bytes: u64,
    /// Why reading stopped before the log's end.
    problem: Option<RawLogError>,
}

impl Steps {
    /// Reads a log. Needs at most as much memory again as the log itself.
    fn read(log: &[u8]) -> Result<Self, RawLogError> {
        let mut found = Self::default();
        let mut host = DeviceLink::new();
        let mut stream = StreamState::default();
        let mut is_open = false;
        let mut was_opened = false;
        let mut end_ns = 0;
        for record in records(log)? {
            let Record { time_ns: at_ns, entry } = match record {
                Ok(record) => record,
                Err(problem) => {
                    found.problem = Some(problem);
                    break;
                }
            };
            end_ns = at_ns;
            let steps = &mut found.steps;
            let mut step = |action| steps.push(Step { at_ns, action });
            match entry {
                Entry::FromDevice(bytes) => {
                    let start = found.bytes.len();
                    found.bytes.extend_from_slice(bytes);
                    stream.push(bytes);
                    step(Action::Send { start, end: start + bytes.len() });
                }
                Entry::ToDevice(bytes) => host.push(bytes, &mut |command| {
                    if let Command::Ping { host_ns } = command {
                        found.pings.insert(host_ns, at_ns);
                    }
                    if let Some(barrier) = Barrier::of(command) {
                        step(Action::Await(barrier));
                    }
                }),
                Entry::Opened(text) => {
                    let driver = text.split(' ').next().unwrap_or_default();
                    if !was_opened {
                        driver.clone_into(&mut found.driver);
                    } else if !is_open {
                        step(Action::PlugIn);
                    }
                    (is_open, was_opened) = (true, true);
                }
                Entry::Closed => {
                    if is_open {
                        step(Action::Unplug);
                    }
                    is_open = false;
                }
                Entry::Missing(bytes) => found.missing_bytes += bytes,
                Entry::Break | Entry::Baud(_) | Entry::End => {}
            }
        }
        // Every log ends with the line closed, which is not a pulled cable.
        if let Some(closed) = found.steps.pop_if(|step| step.action == Action::Unplug) {
            end_ns = closed.at_ns;
        }
        if !stream.has_ended {
            found.steps.push(Step { at_ns: end_ns, action: Action::Disappear });
        }
        Ok(found)
    }

    /// Whether the cable is pulled in the log.
    fn unplugs(&self) -> bool {
        self.steps.iter().any(|step| step.action == Action::Unplug)
    }
}

/// Follows the device's messages to tell whether its stream has ended.
#[derive(Debug, Default)]
struct StreamState {
    reader: HostLink,
    runs: bool,
    has_ended: bool,
}

impl StreamState {
    fn push(&mut self, bytes: &[u8]) {
        let Self { reader, runs, has_ended } = self;
        reader.push(bytes, &mut |event| match event {
            DeviceEvent::Started(_) => (*runs, *has_ended) = (true, false),
            // An end before the first Start answers a host that sends Stop to be safe.
            DeviceEvent::EndOfStream(_) if *runs => (*runs, *has_ended) = (false, true),
            _ => {}
        });
    }
}

/// Length of a Pong on the wire. A longer message without its 0x00 is something else and need not be held back.
const PONG_BYTES_MAX: usize = 24;

/// Maximum number of pings that wait for a Pong. A host sends eight in a row.
const PINGS_MAX: usize = 16;

/// A ping older than this is not answered: such a round trip says nothing about the clocks.
const PING_NS_MAX: u64 = 200_000_000;

/// A ping and its time of arrival.
#[derive(Debug, Clone, Copy)]
struct Ping {
    host_ns: u64,
    came_ns: u64,
}

/// Finds Pongs in a byte stream, and makes them answer the host's pings.
#[derive(Debug)]
struct PongRewriter {
    pings: VecDeque<Ping>,
    /// Bytes since the last 0x00 that are held back.
    open: Vec<u8>,
    /// Whether the message since the last 0x00 is longer than a Pong.
    is_long: bool,
    reader: HostLink,
    link: DeviceLink,
    message: Vec<u8>,
}

impl PongRewriter {
    fn new() -> Self {
        Self {
            pings: VecDeque::with_capacity(PINGS_MAX),
            open: Vec::new(),
            is_long: false,
            reader: HostLink::new(),
            link: DeviceLink::new(),
            message: Vec::new(),
        }
    }

    fn ping(&mut self, host_ns: u64, came_ns: u64) {
        if self.pings.len() == PINGS_MAX {
            self.pings.pop_front();
        }
        self.pings.push_back(Ping { host_ns, came_ns });
    }

    /// Passes logged bytes on and returns how many. With `waits` it stops at a Pong that has no Ping to answer;
    /// otherwise it passes all.
    ///
    /// `ping_ns` gives the time of the Ping of a logged Pong, by the caller's clock. Without `waits`, only a Ping that
    /// came before it is answered: a Pong whose ticks are older than its Ping would spoil the clock fit.
    fn pass(
        &mut self,
        bytes: &[u8],
        now_ns: u64,
        waits: bool,
        ping_ns: impl Fn(u64) -> Option<u64>,
        out: &mut Vec<u8>,
    ) -> usize {
        for (taken, &byte) in bytes.iter().enumerate() {
            self.open.push(byte);
            if byte != 0 || self.is_long {
                self.is_long |= self.open.len() > PONG_BYTES_MAX;
                if self.is_long {
                    self.flush(out);
                    self.is_long = byte != 0;
                }
                continue;
            }
            let Some(pong) = self.pong() else {
                self.flush(out);
                continue;
            };
            let is_old = |ping: &mut Ping| now_ns.saturating_sub(ping.came_ns) > PING_NS_MAX;
            while !waits && self.pings.pop_front_if(is_old).is_some() {}
            let by_ns = if waits { Some(u64::MAX) } else { ping_ns(pong.host_ns) };
            let ping = self.pings.front().copied();
            match ping.filter(|ping| by_ns.is_some_and(|by_ns| ping.came_ns <= by_ns)) {
                Some(Ping { host_ns, .. }) => {
                    self.pings.pop_front();
                    self.message.clear();
                    self.link.pong(Pong { host_ns, ..pong }, &mut self.message);
                    out.extend_from_slice(&self.message);
                    self.open.clear();
                }
                None if waits => {
                    self.open.pop();
                    return taken;
                }
                None => self.flush(out),
            }
        }
        bytes.len()
    }

    /// Passes the held-back bytes on unchanged.
    fn flush(&mut self, out: &mut Vec<u8>) {
        out.append(&mut self.open);
    }

    fn clear(&mut self) {
        self.open.clear();
        self.is_long = false;
        self.pings.clear();
    }

    /// Decodes the held-back message, if it is a Pong.
    fn pong(&mut self) -> Option<Pong> {
        let mut found = None;
        self.reader.push(&self.open, &mut |event| {
            if let DeviceEvent::Pong(pong) = event {
                found = Some(pong);
            }
        });
        found
    }
}

#[cfg(test)]
mod tests;

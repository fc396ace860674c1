//! Replays a raw log as the device that it was recorded from. Sans-io: it sends the logged bytes at the logged times,
//! to a host that repeats the logged exchange of commands.

mod pongs;
mod steps;

#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use mocapd_drivers::device::Command;
use mocapd_drivers::link::DeviceLink;
use mocapd_drivers::raw_log::RawLogError;

use crate::device::{LineDevice, SentFrame, SentLog};
use pongs::PongRewriter;
use steps::{Action, Barrier, Steps};

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
        let is_first = |step: &steps::Step| step.action == Action::Await(Barrier::Identify);
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

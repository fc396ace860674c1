//! A raw log as a device, sans-io: what the device said when it was logged, in the logged time, to a host that goes
//! through the same talk again.

mod pongs;
mod steps;

#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use mocapd_drivers::device::Command;
use mocapd_drivers::link::DeviceLink;
use mocapd_drivers::raw_log::RawLogError;

use crate::device::{LineDevice, SentFrame, SentLog};
use pongs::Pongs;
use steps::{Barrier, Doing, Steps};

/// What a host said and the log does not wait for yet. A host repeats a command five times at most.
const HEARD_MAX: usize = 16;

/// Why a log cannot be a device.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LogDeviceError {
    /// It cannot be read.
    #[error(transparent)]
    Log(#[from] RawLogError),
    /// It is of a device that is spoken to otherwise.
    #[error(
        "the log is of a device of the family '{driver}', and only those of the link protocol (dvmc) can be replayed: an NDI \
         system is found by breaks and at other speeds of its line, which a replay has not"
    )]
    Driver {
        /// The family.
        driver: String,
    },
    /// The device said nothing.
    #[error("the device said nothing in this log: there is nothing to replay")]
    Silent,
    /// Nor could it be read.
    #[error("nothing of what the device said can be read: {0}")]
    Unreadable(RawLogError),
    /// Hello and ticks are as logged, and time is not.
    #[error("speed {found} is out of range: give 0.001 to 1000")]
    Speed {
        /// As it was given.
        found: f64,
    },
}

/// Why a replay is not all that went over the line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LogProblem {
    /// The log cannot be read to its end.
    #[error(transparent)]
    Unreadable(#[from] RawLogError),
    /// The log itself has holes.
    #[error("{bytes} bytes are missing in the log: its disk was too slow")]
    Missing {
        /// In all of them.
        bytes: u64,
    },
}

/// A device that says what is in a log.
#[derive(Debug)]
pub struct LogDevice {
    steps: Steps,
    speed: f64,
    next: usize,
    /// A time of the log, and the caller's that it is.
    anchor: Option<(u64, u64)>,
    /// Of the step at hand, bytes that were said.
    said: usize,
    heard: VecDeque<Barrier>,
    host: DeviceLink,
    pongs: Pongs,
    out: Vec<u8>,
    /// Between Hello and Start a host waits for its Pong.
    greeting: bool,
    /// Its host said Stop, and not Start since: with Identify behind it that is how a host begins that opened the line.
    stopped: bool,
    /// It was started since its line was opened.
    started: bool,
    plugged: bool,
    /// The log is over, and says of no end: the device is not there any more.
    gone: bool,
    /// The line is open, and no host has said anything.
    unheard: bool,
    log: SentLog,
    problems: Vec<LogProblem>,
}

impl LogDevice {
    /// A device that waits for its host. It is played `speed` times as fast as it was logged.
    ///
    /// # Errors
    /// When the log is none, holds nothing, or is of another family.
    pub fn new(log: &[u8], speed: f64) -> Result<Self, LogDeviceError> {
        if !(0.001..=1000.0).contains(&speed) {
            return Err(LogDeviceError::Speed { found: speed });
        }
        let steps = Steps::read(log).map_err(|error| match error {
            RawLogError::CutOff { .. } => LogDeviceError::Unreadable(error),
            _ => LogDeviceError::Log(error),
        })?;
        if steps.said.is_empty() {
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
            said: 0,
            heard: VecDeque::with_capacity(HEARD_MAX),
            host: DeviceLink::new(),
            pongs: Pongs::new(),
            out: Vec::new(),
            greeting: true,
            stopped: false,
            started: false,
            plugged: true,
            gone: false,
            unheard: true,
            log: SentLog::default(),
            problems,
        })
    }

    /// Why the replay is not all that went over the line.
    #[must_use]
    pub fn problems(&self) -> &[LogProblem] {
        &self.problems
    }

    /// Whether the cable is pulled in the log: then the line needs a name that lasts.
    #[must_use]
    pub fn unplugs(&self) -> bool {
        self.steps.unplugs()
    }

    fn obey(&mut self, command: Command, now_ns: u64) {
        if let Command::Ping { host_ns } = command {
            self.pongs.ping(host_ns, now_ns);
        }
        self.stopped |= command == Command::Stop;
        let Some(barrier) = Barrier::of(command) else { return };
        if barrier == Barrier::Identify && self.is_another_host() {
            self.rewind();
        }
        self.stopped &= barrier != Barrier::Start;
        if self.heard.len() < HEARD_MAX {
            self.heard.push_back(barrier);
        }
    }

    /// Whether an Identify is of a host that opened the line anew, and not of one that asks because it hears nothing.
    fn is_another_host(&self) -> bool {
        let is_over = self.next == self.steps.steps.len();
        let is_awaited = self.next_barrier() == Some(Barrier::Identify) && !self.started;
        is_over || (self.stopped && !is_awaited)
    }

    fn next_barrier(&self) -> Option<Barrier> {
        self.steps.steps.get(self.next..)?.iter().find_map(|step| match step.doing {
            Doing::Hear(barrier) => Some(barrier),
            _ => None,
        })
    }

    /// A host that needs fewer tries than the logged one does not say what the log waits for: the log goes on where it
    /// waits for what the host did say, unless the cable is pulled before.
    fn skip_to_what_was_heard(&mut self) -> bool {
        let Some(heard) = self.heard.pop_front() else { return false };
        let rest = self.steps.steps.get(self.next..).unwrap_or_default();
        let until_pulled = rest.iter().take_while(|step| step.doing != Doing::Unplug);
        let Some(ahead) = until_pulled.into_iter().position(|s| s.doing == Doing::Hear(heard))
        else {
            return false;
        };
        self.heard.push_front(heard);
        (self.next, self.said) = (self.next + ahead, 0);
        true
    }

    /// Another host: the log from its first Hello.
    fn rewind(&mut self) {
        let is_first = |step: &steps::Step| step.doing == Doing::Hear(Barrier::Identify);
        self.next = self.steps.steps.iter().position(is_first).unwrap_or(0);
        (self.said, self.anchor) = (0, None);
        self.heard.clear();
        self.pongs.clear();
        self.out.clear();
        (self.greeting, self.started) = (true, false);
    }

    /// When a time of the log comes, or came; all has come before the first.
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

    /// Does what is due, and gives the time of what is next.
    fn play(&mut self, now_ns: u64) -> u64 {
        while let Some(step) = self.steps.steps.get(self.next).copied() {
            if let Doing::Hear(barrier) = step.doing {
                if !self.heard.contains(&barrier) {
                    if self.skip_to_what_was_heard() {
                        continue;
                    }
                    return u64::MAX;
                }
                while self.heard.pop_front().is_some_and(|heard| heard != barrier) {}
                self.log.starts += u64::from(barrier == Barrier::Start);
                self.greeting = barrier != Barrier::Start;
                self.started |= barrier == Barrier::Start;
                self.anchor = Some((step.at_ns, now_ns));
                self.next += 1;
                continue;
            }
            let due_ns = self.clock()(step.at_ns);
            if due_ns > now_ns {
                return due_ns;
            }
            match step.doing {
                Doing::Say { start, end } => {
                    let said = self.steps.said.get(start + self.said..end).unwrap_or_default();
                    let (pings, due_ns) = (&self.steps.pings, self.clock());
                    let asked_ns = |host_ns: u64| pings.get(&host_ns).map(|at_ns| due_ns(*at_ns));
                    let out = &mut self.out;
                    let n = self.pongs.pass(said, now_ns, self.greeting, asked_ns, out);
                    self.said += n;
                    if n < said.len() {
                        return u64::MAX;
                    }
                }
                Doing::Unplug | Doing::Leave => {
                    self.pongs.flush(&mut self.out);
                    if !self.out.is_empty() {
                        // What was said before the cable was pulled reaches the host.
                        return now_ns;
                    }
                    if step.doing == Doing::Leave {
                        self.gone = true;
                        return u64::MAX;
                    }
                    self.plugged = false;
                }
                Doing::PlugIn => {
                    (self.plugged, self.unheard, self.greeting) = (true, true, true);
                    (self.started, self.stopped) = (false, false);
                    self.pongs.clear();
                    self.heard.clear();
                }
                Doing::Hear(_) => {}
            }
            self.said = 0;
            self.next += 1;
            self.anchor.get_or_insert((step.at_ns, now_ns));
            if self.unheard {
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
        self.unheard = false;
        let mut commands = Vec::new();
        self.host.push(bytes, &mut |command| commands.push(command));
        for command in commands {
            self.obey(command, now_ns);
        }
    }

    fn poll(&mut self, now_ns: u64) -> u64 {
        if self.unheard && self.plugged { u64::MAX } else { self.play(now_ns) }
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

    /// A log of bytes knows no frames.
    fn keep_frame_log(&mut self) {}

    fn take_frames(&mut self) -> Vec<SentFrame> {
        Vec::new()
    }
}

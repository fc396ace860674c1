//! Turns a raw log into steps: the bytes that the device sent and when, and the commands that it waited for.

use std::collections::HashMap;

use mocapd_drivers::device::{Command, DeviceEvent, Protocol};
use mocapd_drivers::link::{DeviceLink, HostLink};
use mocapd_drivers::raw_log::{Entry, RawLogError, Record, records};

/// A command that the host must send before the replay continues. Ping and Stop may come at any time: no step waits for
/// them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Barrier {
    Identify,
    SetRate,
    Start,
}

impl Barrier {
    pub(super) fn of(command: Command) -> Option<Self> {
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
pub(super) enum Action {
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
pub(super) struct Step {
    pub(super) at_ns: u64,
    pub(super) action: Action,
}

/// The steps of a log.
#[derive(Debug, Default)]
pub(super) struct Steps {
    pub(super) steps: Vec<Step>,
    /// All bytes from the device.
    pub(super) bytes: Vec<u8>,
    /// Time of each Ping in the log, by the host time that it carries.
    pub(super) pings: HashMap<u64, u64>,
    pub(super) driver: String,
    pub(super) missing_bytes: u64,
    /// Why reading stopped before the log's end.
    pub(super) problem: Option<RawLogError>,
}

impl Steps {
    /// Reads a log. Needs at most as much memory again as the log itself.
    pub(super) fn read(log: &[u8]) -> Result<Self, RawLogError> {
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
    pub(super) fn unplugs(&self) -> bool {
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

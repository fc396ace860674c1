//! A raw log as steps: what the device said and when, and what it waited for.

use std::collections::HashMap;

use mocapd_drivers::device::{Command, DeviceEvent, Protocol};
use mocapd_drivers::link::{DeviceLink, HostLink};
use mocapd_drivers::raw_log::{Entry, RawLogError, Record, records};

/// What a host must say before a device goes on. Pings and Stop come when the host likes: nothing waits for them.
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

/// What happens next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Doing {
    /// These bytes of all that the device said.
    Say { start: usize, end: usize },
    /// The host has to say this.
    Hear(Barrier),
    /// The cable is pulled.
    Unplug,
    /// And put in again.
    PlugIn,
    /// The log is over, and the device had not ended its stream: nobody knows what it said then.
    Leave,
}

/// A step and its time in the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Step {
    pub(super) at_ns: u64,
    pub(super) doing: Doing,
}

/// A log, taken apart.
#[derive(Debug, Default)]
pub(super) struct Steps {
    pub(super) steps: Vec<Step>,
    /// Everything the device said.
    pub(super) said: Vec<u8>,
    /// When each Ping was said, by the time that it carried.
    pub(super) pings: HashMap<u64, u64>,
    pub(super) driver: String,
    pub(super) missing_bytes: u64,
    /// Why the log was not read to its end.
    pub(super) problem: Option<RawLogError>,
}

impl Steps {
    /// Needs as much memory again as the log has bytes, at most.
    pub(super) fn read(log: &[u8]) -> Result<Self, RawLogError> {
        let mut found = Self::default();
        let mut host = DeviceLink::new();
        let mut stream = Stream::default();
        let mut is_open = false;
        let mut ever_open = false;
        let mut over_ns = 0;
        for record in records(log)? {
            let Record { time_ns: at_ns, entry } = match record {
                Ok(record) => record,
                Err(problem) => {
                    found.problem = Some(problem);
                    break;
                }
            };
            over_ns = at_ns;
            let steps = &mut found.steps;
            let mut step = |doing| steps.push(Step { at_ns, doing });
            match entry {
                Entry::FromDevice(bytes) => {
                    let start = found.said.len();
                    found.said.extend_from_slice(bytes);
                    stream.push(bytes);
                    step(Doing::Say { start, end: start + bytes.len() });
                }
                Entry::ToDevice(bytes) => host.push(bytes, &mut |command| {
                    if let Command::Ping { host_ns } = command {
                        found.pings.insert(host_ns, at_ns);
                    }
                    if let Some(barrier) = Barrier::of(command) {
                        step(Doing::Hear(barrier));
                    }
                }),
                Entry::Opened(words) => {
                    let driver = words.split(' ').next().unwrap_or_default();
                    if !ever_open {
                        driver.clone_into(&mut found.driver);
                    } else if !is_open {
                        step(Doing::PlugIn);
                    }
                    (is_open, ever_open) = (true, true);
                }
                Entry::Closed => {
                    if is_open {
                        step(Doing::Unplug);
                    }
                    is_open = false;
                }
                Entry::Missing(bytes) => found.missing_bytes += bytes,
                Entry::Break | Entry::Baud(_) | Entry::End => {}
            }
        }
        // The line is closed at the end of every log; that is no pulled cable.
        if let Some(closed) = found.steps.pop_if(|step| step.doing == Doing::Unplug) {
            over_ns = closed.at_ns;
        }
        if !stream.has_ended {
            found.steps.push(Step { at_ns: over_ns, doing: Doing::Leave });
        }
        Ok(found)
    }

    /// Whether the cable is pulled in it.
    pub(super) fn unplugs(&self) -> bool {
        self.steps.iter().any(|step| step.doing == Doing::Unplug)
    }
}

/// Whether the device ended what it had started.
#[derive(Debug, Default)]
struct Stream {
    reader: HostLink,
    runs: bool,
    has_ended: bool,
}

impl Stream {
    fn push(&mut self, bytes: &[u8]) {
        let Self { reader, runs, has_ended } = self;
        reader.push(bytes, &mut |event| match event {
            DeviceEvent::Started(_) => (*runs, *has_ended) = (true, false),
            // One before the first Start answers a host that stops whatever there was.
            DeviceEvent::EndOfStream(_) if *runs => (*runs, *has_ended) = (false, true),
            _ => {}
        });
    }
}

//! Frames: asked for one by one, numbered as the device numbers them, over a line that may be too slow for all.

use super::{
    frame::{bx_block_bytes, bx2_block_bytes},
    host::{NdiHost, OnEvent, Outcome, State, Task},
    message::{BAUDS, checked, code},
    run::Counted,
};
use crate::{
    device::{DeviceEvent, Frame, LinkBudget},
    link::link_budget,
};

/// What a reset says.
const RESET: &str = "RESET";

/// How long an answer to a poll may pause or be late: many times what a device needs.
const POLL_MS: u64 = 100;

/// How long starting and stopping may take: the vendor's client waits five seconds, and the daemon
/// asks again after one.
const START_MS: u64 = 2_000;

/// Between polls that a device refuses, in nanoseconds.
const REFUSED_PAUSE_NS: u64 = 10_000_000;

/// What a system without `BX2` has to say of its clock.
const NO_CLOCK: &str = "this NDI system gives no times (no BX2): the take's clock is its frame number, and drift, \
                        offset and jitter are those of its frame rate";

impl NdiHost {
    pub(super) fn start(&mut self) {
        if self.budget().fits() {
            self.ask(Task::Start, checked("TSTART:"), START_MS, 0);
        } else {
            let words = self.refusal();
            self.fail(words);
        }
    }

    pub(super) fn tracked(&mut self, task: Task, outcome: Outcome<'_>, on_event: OnEvent<'_>) {
        match (task, outcome) {
            // It may have heard an earlier one, whose answer was lost.
            (Task::Start, Outcome::Text(_) | Outcome::Refused(code::WRONG_MODE)) => {
                self.state = State::Tracking;
                self.farewell(true);
                let rate_hz = f64::from(self.hello.rate_mhz) / 1000.0;
                self.run.begin();
                self.strays.restart(rate_hz);
                self.pace.restart((1e9 / rate_hz) as u64, self.desk.now_ns());
                on_event(DeviceEvent::Started(self.budget()));
                if !self.bx2 && self.run.says_clock() {
                    on_event(DeviceEvent::Note(NO_CLOCK));
                }
                self.next_poll();
            }
            (Task::Poll, Outcome::Refused(code::WRONG_MODE)) | (Task::Stop, Outcome::Text(_)) => {
                self.stopped(on_event);
            }
            // It says that it was not tracking, or cannot stop: no frame comes either way.
            (Task::Stop, Outcome::Refused(_)) => self.stopped(on_event),
            (Task::Poll, Outcome::Refused(error)) if error != code::NOT_INITIALIZED => {
                self.polls_lost += 1;
                if self.polls_lost >= 3 {
                    self.fail_refused("give its frames", error);
                } else {
                    self.ask(Task::Poll, self.poll, POLL_MS, self.desk.now_ns() + REFUSED_PAUSE_NS);
                }
            }
            (Task::Start, Outcome::Refused(code)) => self.fail_refused("start tracking", code),
            // A text where a block belongs: the answer to something else.
            (Task::Poll, Outcome::Text(text)) if text != RESET => {
                self.pace.nothing_new(self.desk.now_ns());
                self.next_poll();
            }
            // Silence, or it was reset: it is set up again, and said to have begun anew.
            _ => self.seek_anew(),
        }
    }

    fn stopped(&mut self, on_event: OnEvent<'_>) {
        self.state = State::Ready;
        self.owed.stop = false;
        self.farewell(false);
        if self.run.end() {
            on_event(DeviceEvent::EndOfStream(self.run.status()));
        }
    }

    /// The next request while it tracks: a frame, or the stop that was asked for.
    pub(super) fn next_poll(&mut self) {
        if self.owed.stop {
            self.ask(Task::Stop, checked("TSTOP:"), START_MS, 0);
        } else {
            self.ask(Task::Poll, self.poll, POLL_MS, self.pace.due_ns);
        }
    }

    /// What the last poll showed is in `seen`.
    pub(super) fn polled(&mut self, on_event: OnEvent<'_>) {
        let now_ns = self.desk.now_ns();
        if std::mem::take(&mut self.owed.start) {
            // Said again: the answer was late, not the command.
            on_event(DeviceEvent::Started(self.budget()));
        }
        match self.seen.number.map(|number| number / self.divisor) {
            Some(number) if !self.run.is_last(number) => {
                // The clock of BX is its frame number, in ticks of a thousandth of a frame.
                let by_number = u64::from(self.seen.number.unwrap_or(0)) * 1000;
                let counted = self.run.frame(number, self.seen.time_ns.unwrap_or(by_number));
                self.pace.new_frame(counted.ahead, now_ns);
                self.emit(number, counted, on_event);
            }
            // The same frame again, or none yet.
            _ => self.pace.nothing_new(now_ns),
        }
        self.next_poll();
    }

    fn emit(&mut self, number: u32, counted: Counted, on_event: OnEvent<'_>) {
        self.counters.samples_not_finite += self.seen.not_finite;
        self.samples.clear();
        self.samples.extend_from_slice(&self.seen.tools);
        self.strays.number(&self.seen, counted.ahead, &mut self.samples);
        on_event(DeviceEvent::Frame(Frame {
            seq: number,
            device_ticks: self.run.ticks,
            timecode: None,
            markers: &self.samples,
        }));
        if counted.dropped > 0 {
            // Told at once: a recording that is killed has it on its account.
            on_event(DeviceEvent::Status(self.run.status()));
        }
        if let Some(words) = self.too_slow() {
            on_event(DeviceEvent::Note(&words));
        }
    }
}

/// Bytes of a binary answer around its block.
const AROUND_BYTES: usize = 6 + 2;

impl NdiHost {
    /// What the tools need, before any stray was seen.
    fn budget(&self) -> LinkBudget {
        let bytes = self.answer_bytes(0);
        link_budget(
            bytes,
            self.hello.rate_mhz,
            self.hello.rate_max_mhz,
            line_bytes_per_s(self.baud),
        )
    }

    fn answer_bytes(&self, strays: usize) -> usize {
        let tools = self.table.len();
        AROUND_BYTES
            + if self.bx2 { bx2_block_bytes(tools, strays) } else { bx_block_bytes(tools, strays) }
    }

    /// A poll and its answer take turns on the line, so both count.
    fn bytes_a_frame(&self, strays: usize) -> u64 {
        (self.poll.as_bytes().len() + self.answer_bytes(strays)) as u64
    }

    /// Why a start is refused, and what to do.
    fn refusal(&self) -> String {
        let needed = self.budget().needed_bytes_per_s;
        format!("the line is too slow for the NDI system: {}", self.limits(0, needed))
    }

    /// Words for a line that does not carry every frame with what was just seen; said once a run.
    fn too_slow(&mut self) -> Option<String> {
        let strays = self.seen.strays.len() + self.seen.strays_beyond;
        let needed = self.needed_bytes_per_s(strays);
        if needed <= line_bytes_per_s(self.baud) || !self.run.says_slow() {
            return None;
        }
        Some(format!(
            "the line is too slow for every frame of the NDI system: {}. The frames that are not fetched in \
             time count as dropped by the device, and strays may change their numbers",
            self.limits(strays, needed)
        ))
    }

    fn needed_bytes_per_s(&self, strays: usize) -> u64 {
        (self.bytes_a_frame(strays) * u64::from(self.hello.rate_mhz)).div_ceil(1000)
    }

    fn limits(&self, strays: usize, needed: u64) -> String {
        let tools = self.table.len();
        let most_hz = line_bytes_per_s(self.baud) as f64 / self.bytes_a_frame(strays) as f64;
        let rate_hz = f64::from(self.hello.rate_mhz) / 1000.0;
        let needed = needed.max(self.needed_bytes_per_s(strays));
        let enough = BAUDS.iter().find(|(baud, _)| line_bytes_per_s(*baud) >= needed);
        let advice = match enough {
            Some((baud, _)) if self.baud >= BAUDS[self.asked_for].0 => {
                format!("write @{baud} behind the port in the device's URI")
            }
            Some(_) => {
                "system or line take no higher speed: use another adapter, show it fewer markers, or lower its \
                 frame rate"
                    .to_owned()
            }
            None => "no speed is enough: show it fewer markers, or lower its frame rate".to_owned(),
        };
        let seen = [(tools, "tool"), (strays, "stray marker")];
        let seen: Vec<_> =
            seen.iter().filter(|(n, _)| *n > 0).map(|(n, what)| counted(*n, what)).collect();
        let seen = if seen.is_empty() { "frames".to_owned() } else { seen.join(" and ") };
        format!(
            "{seen} over {} baud come at most {most_hz:.1} times a second, and it runs at {rate_hz} Hz; {advice}",
            self.baud
        )
    }
}

/// Ten bits a byte: start, eight of data, stop.
fn line_bytes_per_s(baud: u32) -> u64 {
    u64::from(baud) / 10
}

fn counted(n: usize, what: &str) -> String {
    let plural = if n == 1 { "" } else { "s" };
    format!("{n} {what}{plural}")
}

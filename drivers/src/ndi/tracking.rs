//! Frames: asked for one by one, numbered as the device numbers them.

use super::{
    exchange::Outcome,
    host::{NdiHost, State, Task},
    request::checked,
    run::Counted,
};
use crate::device::{DeviceEvent, Frame};

/// The error of a poll after which the device is not tracking any more, and of a start when it is.
pub(super) const NOT_TRACKING: u8 = 0x0C;

/// The error of everything after a reset, and what a reset says.
const NOT_INITIALIZED: u8 = 0x10;
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

    pub(super) fn tracked(
        &mut self,
        task: Task,
        outcome: Outcome<'_>,
        on_event: &mut dyn FnMut(DeviceEvent<'_>),
    ) {
        match (task, outcome) {
            // It may have heard an earlier one, whose answer was lost.
            (Task::Start, Outcome::Text(_) | Outcome::Refused(NOT_TRACKING)) => {
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
            (Task::Poll, Outcome::Refused(NOT_TRACKING)) | (Task::Stop, Outcome::Text(_)) => {
                self.stopped(on_event);
            }
            // It says that it was not tracking, or cannot stop: no frame comes either way.
            (Task::Stop, Outcome::Refused(_)) => self.stopped(on_event),
            (Task::Poll, Outcome::Refused(code)) if code != NOT_INITIALIZED => {
                self.polls_lost += 1;
                if self.polls_lost >= 3 {
                    self.fail_refused("give its frames", code);
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

    fn stopped(&mut self, on_event: &mut dyn FnMut(DeviceEvent<'_>)) {
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
            self.ask(Task::Poll, self.poll, POLL_MS, self.pace.due_ns());
        }
    }

    /// What the last poll showed is in `seen`.
    pub(super) fn polled(&mut self, on_event: &mut dyn FnMut(DeviceEvent<'_>)) {
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

    fn emit(&mut self, number: u32, counted: Counted, on_event: &mut dyn FnMut(DeviceEvent<'_>)) {
        self.counters.samples_not_finite += self.seen.not_finite;
        self.samples.clear();
        self.samples.extend_from_slice(&self.seen.tools);
        self.strays.number(&self.seen, counted.ahead, &mut self.samples);
        on_event(DeviceEvent::Frame(Frame {
            seq: number,
            device_ticks: self.run.last_ticks(),
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

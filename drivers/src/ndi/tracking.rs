//! Frames: asked for one by one, numbered as the device numbers them.

use super::{
    bx,
    exchange::Outcome,
    gbf,
    host::{NdiHost, State, Task},
    request::checked,
};
use crate::{
    device::{DeviceEvent, Frame, LinkBudget, Status},
    link::link_budget,
};

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

/// Bytes of a binary answer around its block.
const AROUND_BYTES: usize = 6 + 2;

/// A number this far ahead is loss, and one this far behind came late; anything else is a counter that
/// began anew. The same holds where frames are put on record.
const AHEAD_MAX: i32 = 1 << 20;
const LATE_MIN: i32 = -64;

/// From a Start to its end; a system that is lost and found again in between goes on with it.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Run {
    /// The last frame's number, in tracked frames.
    last: Option<u32>,
    /// Frames as far as their numbers tell, those that did not come too.
    produced: u64,
    ticks: u64,
    started: bool,
}

impl Run {
    /// Before a Start.
    fn begin(&mut self) {
        if !self.started {
            *self = Self { ticks: self.ticks, started: true, ..Self::default() };
        }
    }

    /// A frame came; by how many it is ahead of the last one.
    fn frame(&mut self, number: u32, ticks: u64) -> u32 {
        let ahead = self.last.map_or(1, |last| number.wrapping_sub(last).cast_signed());
        let counted = match ahead {
            1..=AHEAD_MAX => ahead as u32,
            LATE_MIN..=0 if ticks <= self.ticks => 0,
            _ => 1,
        };
        self.produced += u64::from(counted);
        (self.last, self.ticks) = (Some(number), ticks);
        counted
    }

    pub(super) fn status(&self) -> Status {
        Status { frames_produced: self.produced, frames_dropped: 0, temperature_c_100: i16::MIN }
    }

    /// The device's clock at the last frame; 0 before the first.
    pub(super) fn last_ticks(&self) -> u64 {
        self.ticks
    }
}

impl NdiHost {
    pub(super) fn start(&mut self, on_event: &mut dyn FnMut(DeviceEvent<'_>)) {
        let budget = self.budget();
        if budget.fits() {
            self.ask(Task::Start, checked("TSTART:"), START_MS, 0);
        } else {
            on_event(DeviceEvent::Refused(budget));
        }
    }

    /// What the tools need; strays take 12 or 16 bytes each of what is left.
    fn budget(&self) -> LinkBudget {
        let tools = self.table.len();
        let block = if self.bx2 { gbf::block_bytes(tools) } else { bx::block_bytes(tools) };
        let baud = u64::from(self.baud);
        link_budget(block + AROUND_BYTES, self.hello.rate_mhz, self.hello.rate_max_mhz, baud / 10)
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
        if std::mem::take(&mut self.run.started) {
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
            Some(number) if Some(number) != self.run.last => {
                // The clock of BX is its frame number, in ticks of a thousandth of a frame.
                let by_number = u64::from(self.seen.number.unwrap_or(0)) * 1000;
                let ahead = self.run.frame(number, self.seen.time_ns.unwrap_or(by_number));
                self.pace.new_frame(ahead, now_ns);
                self.emit(number, ahead, on_event);
            }
            // The same frame again, or none yet.
            _ => self.pace.nothing_new(now_ns),
        }
        self.next_poll();
    }

    fn emit(&mut self, number: u32, ahead: u32, on_event: &mut dyn FnMut(DeviceEvent<'_>)) {
        self.counters.samples_not_finite += self.seen.not_finite;
        self.samples.clear();
        self.samples.extend_from_slice(&self.seen.tools);
        self.strays.number(&self.seen, ahead, &mut self.samples);
        on_event(DeviceEvent::Frame(Frame {
            seq: number,
            device_ticks: self.run.ticks,
            timecode: None,
            markers: &self.samples,
        }));
    }
}

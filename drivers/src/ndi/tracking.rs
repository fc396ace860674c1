//! Tracking: polls the frames one by one, and accounts for those that a slow line misses.

use super::{
    HostState, NdiHost, OnEvent, Outcome, Task,
    frame::{bx_block_bytes, bx2_block_bytes},
    message::{BAUDS, code, with_crc},
    run::FrameStep,
};
use crate::{
    device::{DeviceEvent, Frame, Hello, LinkBudget, PoseFrame},
    link::link_budget,
};

/// Text that a device sends after a reset.
const RESET: &str = "RESET";

/// Time-out of a poll, and of a pause within its reply: many times what a device needs.
const POLL_TIMEOUT_MS: u64 = 100;

/// Time-out of starting and stopping. The vendor's client waits five seconds, and the recorder repeats its
/// command after one.
const START_TIMEOUT_MS: u64 = 2_000;

/// Pause after a refused poll, in nanoseconds.
const REFUSED_PAUSE_NS: u64 = 10_000_000;

/// Note about the clock of a system without `BX2`.
const CLOCK_NOTE: &str = "this NDI system sends no timestamps (no BX2): the take's clock is its frame number, so \
                          drift, offset and jitter are those of its frame rate";

impl NdiHost {
    pub(super) fn start(&mut self) {
        if self.budget().fits() {
            self.request(Task::Start, with_crc("TSTART:"), START_TIMEOUT_MS, 0);
        } else {
            let message = self.too_slow_error();
            self.fail(message);
        }
    }

    pub(super) fn track_reply(&mut self, task: Task, outcome: Outcome<'_>, on_event: OnEvent<'_>) {
        match (task, outcome) {
            // The wrong mode means that it is tracking: the reply to an earlier attempt was lost.
            (Task::Start, Outcome::Text(_) | Outcome::Refused(code::WRONG_MODE)) => {
                self.state = HostState::Tracking;
                self.set_goodbye(true);
                let rate_hz = f64::from(self.hello.rate_millihertz) / 1000.0;
                self.run.begin();
                self.strays.restart(rate_hz);
                self.pacer.restart((1e9 / rate_hz) as u64, self.line.now_ns());
                on_event(DeviceEvent::Started(self.budget()));
                if !self.bx2 && self.run.first_clock_note() {
                    on_event(DeviceEvent::Note(CLOCK_NOTE));
                }
                self.next_poll();
            }
            (Task::Poll, Outcome::Refused(code::WRONG_MODE)) | (Task::Stop, Outcome::Text(_)) => {
                self.stopped(on_event);
            }
            // It was not tracking, or cannot stop: no frame follows either way.
            (Task::Stop, Outcome::Refused(_)) => self.stopped(on_event),
            (Task::Poll, Outcome::Refused(error)) if error != code::NOT_INITIALIZED => {
                self.polls_lost += 1;
                if self.polls_lost >= 3 {
                    self.fail_code("send its frames", error);
                } else {
                    let later_ns = self.line.now_ns() + REFUSED_PAUSE_NS;
                    self.request(Task::Poll, self.poll, POLL_TIMEOUT_MS, later_ns);
                }
            }
            (Task::Start, Outcome::Refused(code)) => self.fail_code("start tracking", code),
            // Text instead of a block is the reply to something else.
            (Task::Poll, Outcome::Text(text)) if text != RESET => {
                self.pacer.no_new_frame(self.line.now_ns());
                self.next_poll();
            }
            // Time-out or reset: set it up again, which tells the host that it restarted.
            _ => self.restart_search(),
        }
    }

    fn stopped(&mut self, on_event: OnEvent<'_>) {
        self.state = HostState::Ready;
        self.todo.stop = false;
        self.set_goodbye(false);
        if self.run.end() {
            on_event(DeviceEvent::EndOfStream(self.run.status()));
        }
    }

    /// Sends the next request while tracking: a poll, or the stop that the host requested.
    pub(super) fn next_poll(&mut self) {
        if self.todo.stop {
            self.request(Task::Stop, with_crc("TSTOP:"), START_TIMEOUT_MS, 0);
        } else {
            self.request(Task::Poll, self.poll, POLL_TIMEOUT_MS, self.pacer.due_ns);
        }
    }

    /// Handles a valid reply to a poll, which is in `self.frame`.
    pub(super) fn frame_reply(&mut self, on_event: OnEvent<'_>) {
        let now_ns = self.line.now_ns();
        if std::mem::take(&mut self.todo.start) {
            // The host repeated its command because the reply was late.
            on_event(DeviceEvent::Started(self.budget()));
        }
        match self.frame.number.map(|number| number / self.divisor) {
            Some(number) if !self.run.is_last(number) => {
                // The clock of BX is the frame number, in ticks of a thousandth of a frame.
                let number_ticks = u64::from(self.frame.number.unwrap_or(0)) * 1000;
                let step = self.run.frame(number, self.frame.time_ns.unwrap_or(number_ticks));
                self.pacer.new_frame(step.advance, now_ns);
                self.emit(number, step, on_event);
            }
            // The previous frame again, or none yet.
            _ => self.pacer.no_new_frame(now_ns),
        }
        self.next_poll();
    }

    fn emit(&mut self, number: u32, step: FrameStep, on_event: OnEvent<'_>) {
        self.counters.samples_not_finite += self.frame.not_finite;
        self.samples.clear();
        self.samples.extend_from_slice(&self.frame.tools);
        self.strays.assign(&self.frame, step.advance, &mut self.samples);
        on_event(DeviceEvent::Frame(Frame {
            seq: number,
            device_ticks: self.run.ticks,
            timecode: None,
            markers: &self.samples,
        }));
        // A late frame's time is not known any more; its poses, like its markers, are not recorded.
        if !self.bodies.is_empty() && step.advance > 0 {
            on_event(DeviceEvent::Poses(PoseFrame {
                seq: number,
                number: self.run.pose_number(),
                device_ticks: self.run.ticks,
                poses: &self.frame.poses,
            }));
        }
        if step.dropped > 0 {
            // Report losses immediately, so that a recording that is killed still has them in its ledger.
            on_event(DeviceEvent::Status(self.run.status()));
        }
        if let Some(message) = self.too_slow_note() {
            on_event(DeviceEvent::Note(&message));
        }
    }
}

/// Bytes of a binary reply around its block.
const REPLY_OVERHEAD_BYTES: usize = 6 + 2;

impl NdiHost {
    /// The link budget for the tools, before any stray is seen.
    fn budget(&self) -> LinkBudget {
        let Hello { rate_millihertz, rate_max_millihertz, .. } = self.hello;
        let line_bytes_per_s = line_bytes_per_s(self.baud);
        link_budget(self.reply_bytes(0), rate_millihertz, rate_max_millihertz, 0, line_bytes_per_s)
    }

    fn reply_bytes(&self, strays: usize) -> usize {
        let block_bytes = if self.bx2 { bx2_block_bytes } else { bx_block_bytes };
        REPLY_OVERHEAD_BYTES + block_bytes(self.table.len(), strays)
    }

    /// Bytes per frame in both directions: poll and reply alternate on the line, so both count.
    fn bytes_per_frame(&self, strays: usize) -> u64 {
        (self.poll.as_bytes().len() + self.reply_bytes(strays)) as u64
    }

    /// The error when the line is too slow to start.
    fn too_slow_error(&self) -> String {
        let needed = self.budget().needed_bytes_per_s;
        format!("the line is too slow for the NDI system: {}", self.limit_text(0, needed))
    }

    /// A note, once per run, when the line is too slow for every frame with the markers just seen.
    fn too_slow_note(&mut self) -> Option<String> {
        let strays = self.frame.strays.len() + self.frame.strays_excess;
        let needed = self.needed_bytes_per_s(strays);
        if needed <= line_bytes_per_s(self.baud) || !self.run.first_slow_note() {
            return None;
        }
        Some(format!(
            "the line is too slow for every frame of the NDI system: {}. Frames that are not fetched in time count \
             as dropped by the device, and strays may change their numbers",
            self.limit_text(strays, needed)
        ))
    }

    fn needed_bytes_per_s(&self, strays: usize) -> u64 {
        (self.bytes_per_frame(strays) * u64::from(self.hello.rate_millihertz)).div_ceil(1000)
    }

    fn limit_text(&self, strays: usize, needed: u64) -> String {
        let tools = self.table.len();
        let most_hz = line_bytes_per_s(self.baud) as f64 / self.bytes_per_frame(strays) as f64;
        let rate_hz = f64::from(self.hello.rate_millihertz) / 1000.0;
        let needed = needed.max(self.needed_bytes_per_s(strays));
        let enough = BAUDS.iter().find(|(baud, _)| line_bytes_per_s(*baud) >= needed);
        let advice = match enough {
            Some((baud, _)) if self.baud >= BAUDS[self.speed_requested].0 => {
                format!("append @{baud} to the port in the device URI")
            }
            Some(_) => {
                "neither the system nor the line supports a higher baud rate: use another adapter, show fewer \
                 markers, or lower its frame rate"
                    .to_owned()
            }
            None => "no baud rate suffices: show fewer markers, or lower its frame rate".to_owned(),
        };
        let load = [(tools, "tool"), (strays, "stray marker")].into_iter().filter(|(n, _)| *n > 0);
        let load: Vec<_> = load.map(|(n, what)| plural(n, what)).collect();
        let load = if load.is_empty() { "a frame".to_owned() } else { load.join(" and ") };
        format!(
            "{} baud carries {load} at most {most_hz:.1} times per second, but the system runs at {rate_hz} Hz; {advice}",
            self.baud
        )
    }
}

/// Bytes per second at ten bits a byte: start, eight data bits, stop.
fn line_bytes_per_s(baud: u32) -> u64 {
    u64::from(baud) / 10
}

fn plural(n: usize, what: &str) -> String {
    let ending = if n == 1 { "" } else { "s" };
    format!("{n} {what}{ending}")
}

//! Tracking: polls the frames one by one at the right time, and accounts by their numbers for those that a slow line
//! misses.

use super::{
    HostState, NdiHost, OnEvent, Outcome, Task,
    frame::{bx_block_bytes, bx2_block_bytes},
    message::{BAUDS, code, with_crc},
};
use crate::{
    device::{DeviceEvent, Frame, Hello, LinkBudget, PoseFrame, Status},
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

/// How much earlier each poll is sent, as a fraction of the period: 0.26 ms at 60 Hz. The moment at which
/// frames become ready is thus measured again every few frames, which follows clocks that drift apart.
const EARLIER_DIVISOR: u64 = 64;

/// Wait after a poll that was too early, as a fraction of the period: 1 ms at 60 Hz.
const RETRY_DIVISOR: u64 = 16;

/// Schedules polls by tracking when the device's frames become ready.
#[derive(Debug, Default)]
pub(super) struct PollPacer {
    period_ns: u64,
    /// When to send the next poll.
    due_ns: u64,
}

impl PollPacer {
    /// Restarts with this frame period; the first frame is ready now or later.
    pub(super) fn restart(&mut self, period_ns: u64, now_ns: u64) {
        *self = Self { period_ns: period_ns.max(1), due_ns: now_ns };
    }

    /// A poll returned the frame `after_last` numbers after the previous one.
    fn new_frame(&mut self, after_last: u32, now_ns: u64) {
        let after_ns = u64::from(after_last.max(1)).saturating_mul(self.period_ns);
        let earlier_ns = self.period_ns / EARLIER_DIVISOR;
        self.due_ns = self.due_ns.saturating_add(after_ns).saturating_sub(earlier_ns);
        // Limits the effect of a counter jump, or of a wrong rate from the device.
        let (first, last) = (now_ns.saturating_sub(self.period_ns), now_ns + self.period_ns);
        self.due_ns = self.due_ns.clamp(first, last);
    }

    /// A poll returned no new frame.
    fn no_new_frame(&mut self, now_ns: u64) {
        self.due_ns = now_ns.max(self.due_ns) + self.period_ns / RETRY_DIVISOR;
    }
}

/// A number up to this far ahead means loss, and one up to this far behind a late frame. Anything else is a
/// counter that restarted. The recorder applies the same rule.
const ADVANCE_MAX: i32 = 1 << 20;
const LATE_MIN: i32 = -64;

/// Received frames after which a line counts as reliable: ten seconds at 60 Hz.
pub(super) const RELIABLE_FRAMES: u64 = 600;

/// Position of a frame relative to the previous one, by its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FrameStep {
    /// Frames since the previous one; 0 for a late frame.
    pub(super) advance: u32,
    /// Frames in between that were never fetched.
    pub(super) dropped: u32,
}

/// Accounting from a Start to its end. A system that is lost and found is started again, which begins a new
/// run: the host counts the status reports from there.
///
/// A system buffers one frame. Frames that its number skips were replaced before a poll: they never left it.
/// But a damaged or missing reply may have held one, so one skipped frame per such reply counts as lost on
/// the link.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct TrackingRun {
    /// Number of the last frame, in tracked frames.
    last: Option<u32>,
    /// Frames by their numbers, including those that were not received.
    produced: u64,
    /// Frames of these that were never fetched.
    dropped: u64,
    /// Polls since the last frame without a readable reply.
    n_unread: u32,
    /// Frames that left the system: received, or lost on the link.
    left_device: u32,
    /// Device clock at the last frame; 0 before the first.
    pub(super) ticks: u64,
    started: bool,
    /// Notes that were sent already.
    slow_noted: bool,
    clock_noted: bool,
}

impl TrackingRun {
    /// Begins a run, unless one has begun.
    pub(super) fn begin(&mut self) {
        if !self.started {
            *self = Self { ticks: self.ticks, started: true, ..Self::default() };
        }
    }

    /// Resets the counters after losing the system; they have been reported. Sent notes stay sent.
    pub(super) fn reset_counts(&mut self) {
        let Self { ticks, started, slow_noted, clock_noted, .. } = *self;
        *self = Self { ticks, started, slow_noted, clock_noted, ..Self::default() };
    }

    /// Ends the run, and returns whether there was one.
    pub(super) fn end(&mut self) -> bool {
        std::mem::take(&mut self.started)
    }

    /// Whether enough frames were received for the line to count as reliable.
    pub(super) fn is_line_reliable(&self) -> bool {
        self.produced - self.dropped >= RELIABLE_FRAMES
    }

    fn is_last(&self, number: u32) -> bool {
        self.last == Some(number)
    }

    /// Counts a poll without a readable reply.
    pub(super) fn count_unread(&mut self) {
        self.n_unread = self.n_unread.saturating_add(1);
    }

    /// Counts a received frame.
    pub(super) fn frame(&mut self, number: u32, ticks: u64) -> FrameStep {
        let advance = self.last.map_or(1, |last| number.wrapping_sub(last).cast_signed());
        let advance = match advance {
            1..=ADVANCE_MAX => advance as u32,
            LATE_MIN..=0 if ticks <= self.ticks => return FrameStep { advance: 0, dropped: 0 },
            _ => 1,
        };
        let skipped = advance - 1;
        let dropped = skipped - skipped.min(std::mem::take(&mut self.n_unread));
        self.produced += u64::from(advance);
        self.dropped += u64::from(dropped);
        self.left_device = self.left_device.wrapping_add(advance - dropped);
        (self.last, self.ticks) = (Some(number), ticks);
        FrameStep { advance, dropped }
    }

    /// The number of the last frame's poses.
    fn pose_number(&self) -> u32 {
        self.left_device
    }

    pub(super) fn status(&self) -> Status {
        Status {
            frames_produced: self.produced,
            frames_dropped: self.dropped,
            temperature_c_100: i16::MIN,
        }
    }

    /// Returns `true` once: whether to send the note about the slow line.
    fn first_slow_note(&mut self) -> bool {
        !std::mem::replace(&mut self.slow_noted, true)
    }

    /// Returns `true` once: whether to send the note about the clock.
    fn first_clock_note(&mut self) -> bool {
        !std::mem::replace(&mut self.clock_noted, true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polls_lose_no_frame_under_late_wake_ups() {
        const PERIOD: u64 = 16_666_667;
        // Frames come 0.02 % faster than announced, the first 9 ms after the start; polls take 3 ms.
        let ready_at = |number: u64| 9_000_000 + number * (PERIOD - PERIOD / 5000);
        let mut pacer = PollPacer::default();
        pacer.restart(PERIOD, 0);
        let (mut now, mut last, mut polls, mut waited) = (0, None, 0, 0);
        for turn in 0_u64.. {
            // Every hundredth wake-up is 8 ms late.
            now = pacer.due_ns.max(now) + if turn % 100 == 99 { 8_000_000 } else { 100_000 };
            polls += 1;
            let newest = (0_u64..).take_while(|n| ready_at(*n) <= now).last();
            if newest == last {
                now += 500_000;
                pacer.no_new_frame(now);
                continue;
            }
            assert_eq!(newest, last.map_or(Some(0), |last| Some(last + 1)), "turn {turn}");
            last = newest;
            waited += now - ready_at(newest.unwrap());
            now += 3_000_000;
            pacer.new_frame(1, now);
            if newest == Some(600) {
                break;
            }
        }
        assert!(polls < 1200, "{polls} polls for 600 frames");
        assert!(waited / 600 < 2_500_000, "{} ns late in the mean", waited / 600);
    }

    #[test]
    fn skipped_frames_were_never_fetched_unless_an_answer_was_damaged() {
        let mut run = TrackingRun::default();
        run.begin();
        let step = |advance, dropped| FrameStep { advance, dropped };
        assert_eq!(run.frame(1000, 10), step(1, 0), "nothing is known before the first frame");
        assert_eq!(run.frame(1001, 20), step(1, 0));
        assert_eq!(run.frame(1005, 60), step(4, 3));
        run.count_unread();
        assert_eq!(run.frame(1007, 80), step(2, 0), "the damaged reply held it");
        run.count_unread();
        run.count_unread();
        assert_eq!(run.frame(1012, 130), step(5, 2));
        assert_eq!(run.frame(1014, 150), step(2, 1), "unreadable replies are used up");
        let Status { frames_produced, frames_dropped, .. } = run.status();
        assert_eq!((frames_produced, frames_dropped), (15, 6));
        assert_eq!(run.pose_number(), 9, "those that left the system");
        // A late frame, and a counter that restarted.
        assert_eq!(run.frame(1013, 140), step(0, 0));
        assert_eq!(run.frame(1015, 160), step(1, 0), "a late frame moves nothing");
        assert_eq!(run.frame(3, 5), step(1, 0));
        assert_eq!(run.status().frames_produced, 17);
        assert!(run.end() && !run.end());
    }
}

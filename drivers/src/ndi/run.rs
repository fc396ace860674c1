//! A run of tracking: the timing of polls, and the accounting of frames by their numbers.

use crate::device::Status;

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
    pub(super) due_ns: u64,
}

impl PollPacer {
    /// Restarts with this frame period; the first frame is ready now or later.
    pub(super) fn restart(&mut self, period_ns: u64, now_ns: u64) {
        *self = Self { period_ns: period_ns.max(1), due_ns: now_ns };
    }

    /// A poll returned the frame `after_last` numbers after the previous one.
    pub(super) fn new_frame(&mut self, after_last: u32, now_ns: u64) {
        let after_ns = u64::from(after_last.max(1)).saturating_mul(self.period_ns);
        let earlier_ns = self.period_ns / EARLIER_DIVISOR;
        self.due_ns = self.due_ns.saturating_add(after_ns).saturating_sub(earlier_ns);
        // Limits the effect of a counter jump, or of a wrong rate from the device.
        let (first, last) = (now_ns.saturating_sub(self.period_ns), now_ns + self.period_ns);
        self.due_ns = self.due_ns.clamp(first, last);
    }

    /// A poll returned no new frame.
    pub(super) fn no_new_frame(&mut self, now_ns: u64) {
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

    pub(super) fn is_last(&self, number: u32) -> bool {
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
    pub(super) fn pose_number(&self) -> u32 {
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
    pub(super) fn first_slow_note(&mut self) -> bool {
        !std::mem::replace(&mut self.slow_noted, true)
    }

    /// Returns `true` once: whether to send the note about the clock.
    pub(super) fn first_clock_note(&mut self) -> bool {
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

//! The frames of a run: when to poll for the next, and what their numbers say of those that nobody saw.

use crate::device::Status;

/// How much earlier each poll is tried, as a part of the period: 0.26 ms at 60 Hz. The moment at
/// which frames become ready is found anew every few frames, and so are clocks that drift apart.
const EARLIER_DIVISOR: u64 = 64;

/// How long to wait after a poll that came too early, as a part of the period: 1 ms at 60 Hz.
const RETRY_DIVISOR: u64 = 16;

/// Follows the moment at which the device's frames become ready.
#[derive(Debug, Default)]
pub(super) struct PollPacer {
    period_ns: u64,
    /// When to send the next poll.
    pub(super) due_ns: u64,
}

impl PollPacer {
    /// Frames come with this period, the first one now or later.
    pub(super) fn restart(&mut self, period_ns: u64, now_ns: u64) {
        *self = Self { period_ns: period_ns.max(1), due_ns: now_ns };
    }

    /// The poll brought the frame that is so many after the last one.
    pub(super) fn new_frame(&mut self, after_last: u32, now_ns: u64) {
        let after_ns = u64::from(after_last.max(1)).saturating_mul(self.period_ns);
        let earlier_ns = self.period_ns / EARLIER_DIVISOR;
        self.due_ns = self.due_ns.saturating_add(after_ns).saturating_sub(earlier_ns);
        // A counter that jumped, or a rate that is not what the device said.
        let (first, last) = (now_ns.saturating_sub(self.period_ns), now_ns + self.period_ns);
        self.due_ns = self.due_ns.clamp(first, last);
    }

    /// The poll, answered now, brought nothing new.
    pub(super) fn no_new_frame(&mut self, now_ns: u64) {
        self.due_ns = now_ns.max(self.due_ns) + self.period_ns / RETRY_DIVISOR;
    }
}

/// A number this far ahead is loss, and one this far behind came late; anything else is a counter that
/// began anew. The same holds where frames are put on record.
const ADVANCE_MAX: i32 = 1 << 20;
const LATE_MIN: i32 = -64;

/// Frames that came over a line that is good: ten seconds at 60 Hz.
pub(super) const RELIABLE_FRAMES: u64 = 600;

/// What a frame's number says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FrameStep {
    /// By how many it is ahead of the last one; 0 when it came late.
    pub(super) advance: u32,
    /// Of those in between, the ones that were never fetched.
    pub(super) dropped: u32,
}

/// From a Start to its end. A system that is lost and found again is started again, and with that a new run begins: a
/// host counts its reports from there.
///
/// A system keeps one frame. Those that its number skips were replaced before a poll came: they never
/// left it. But an answer that was damaged or did not come may have held one: of the frames that are
/// skipped then, one for each such answer counts as lost on the link.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct TrackingRun {
    /// The last frame's number, in tracked frames.
    last: Option<u32>,
    /// Frames as far as their numbers tell, those that did not come too.
    produced: u64,
    /// Of these, never fetched.
    dropped: u64,
    /// Polls since the last frame whose answers could not be read.
    n_unread: u32,
    /// The device's clock at the last frame; 0 before the first.
    pub(super) ticks: u64,
    started: bool,
    /// What was said already.
    slow_noted: bool,
    clock_noted: bool,
}

impl TrackingRun {
    /// Before a Start.
    pub(super) fn begin(&mut self) {
        if !self.started {
            *self = Self { ticks: self.ticks, started: true, ..Self::default() };
        }
    }

    /// The system is lost: what was counted of it was told. What was said of the line holds.
    pub(super) fn reset_counts(&mut self) {
        let Self { ticks, started, slow_noted, clock_noted, .. } = *self;
        *self = Self { ticks, started, slow_noted, clock_noted, ..Self::default() };
    }

    /// At its end; whether there was one to end.
    pub(super) fn end(&mut self) -> bool {
        std::mem::take(&mut self.started)
    }

    /// Whether it had frames for so long that the line is good.
    pub(super) fn is_line_reliable(&self) -> bool {
        self.produced - self.dropped >= RELIABLE_FRAMES
    }

    pub(super) fn is_last(&self, number: u32) -> bool {
        self.last == Some(number)
    }

    /// A poll had no answer that could be read.
    pub(super) fn count_unread(&mut self) {
        self.n_unread = self.n_unread.saturating_add(1);
    }

    /// A frame came.
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
        (self.last, self.ticks) = (Some(number), ticks);
        FrameStep { advance, dropped }
    }

    pub(super) fn status(&self) -> Status {
        Status {
            frames_produced: self.produced,
            frames_dropped: self.dropped,
            temperature_c_100: i16::MIN,
        }
    }

    /// Whether to say that the line is slow: once.
    pub(super) fn first_slow_note(&mut self) -> bool {
        !std::mem::replace(&mut self.slow_noted, true)
    }

    /// Whether to say what the clock is: once.
    pub(super) fn first_clock_note(&mut self) -> bool {
        !std::mem::replace(&mut self.clock_noted, true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_frames_and_loses_none_under_late_wake_ups() {
        const PERIOD: u64 = 16_666_667;
        // Frames 0.02 % faster than said, first one 9 ms after the start; polls take 3 ms.
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
        assert_eq!(run.frame(1000, 10), step(1, 0), "where a run begins nobody knows");
        assert_eq!(run.frame(1001, 20), step(1, 0));
        assert_eq!(run.frame(1005, 60), step(4, 3));
        run.count_unread();
        assert_eq!(run.frame(1007, 80), step(2, 0), "the damaged answer had it");
        run.count_unread();
        run.count_unread();
        assert_eq!(run.frame(1012, 130), step(5, 2));
        assert_eq!(run.frame(1014, 150), step(2, 1), "those are accounted for");
        let Status { frames_produced, frames_dropped, .. } = run.status();
        assert_eq!((frames_produced, frames_dropped), (15, 6));
        // Late, and a counter that began anew.
        assert_eq!(run.frame(1013, 140), step(0, 0));
        assert_eq!(run.frame(1015, 160), step(1, 0), "what came late moves nothing");
        assert_eq!(run.frame(3, 5), step(1, 0));
        assert_eq!(run.status().frames_produced, 17);
        assert!(run.end() && !run.end());
    }
}

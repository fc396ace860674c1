//! When to poll: as soon as a frame is there, and not much more often.

/// How much earlier each poll is tried, as a part of the period: 0.26 ms at 60 Hz. The moment at
/// which frames become ready is found anew every few frames, and so are clocks that drift apart.
const EARLIER: u64 = 64;

/// How long to wait after a poll that came too early, as a part of the period: 1 ms at 60 Hz.
const AGAIN: u64 = 16;

/// Follows the moment at which the device's frames become ready.
#[derive(Debug, Default)]
pub(super) struct Pace {
    period_ns: u64,
    due_ns: u64,
}

impl Pace {
    /// Frames come with this period, the first one now or later.
    pub(super) fn restart(&mut self, period_ns: u64, now_ns: u64) {
        *self = Self { period_ns: period_ns.max(1), due_ns: now_ns };
    }

    /// When to send the next poll.
    pub(super) fn due_ns(&self) -> u64 {
        self.due_ns
    }

    /// The poll brought the frame that is so many after the last one.
    pub(super) fn new_frame(&mut self, after_last: u32, now_ns: u64) {
        let after_ns = u64::from(after_last.max(1)).saturating_mul(self.period_ns);
        let earlier_ns = self.period_ns / EARLIER;
        self.due_ns = self.due_ns.saturating_add(after_ns).saturating_sub(earlier_ns);
        // A counter that jumped, or a rate that is not what the device said.
        let (first, last) = (now_ns.saturating_sub(self.period_ns), now_ns + self.period_ns);
        self.due_ns = self.due_ns.clamp(first, last);
    }

    /// The poll, answered now, brought nothing new.
    pub(super) fn nothing_new(&mut self, now_ns: u64) {
        self.due_ns = now_ns.max(self.due_ns) + self.period_ns / AGAIN;
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
        let mut pace = Pace::default();
        pace.restart(PERIOD, 0);
        let (mut now, mut last, mut polls, mut waited) = (0, None, 0, 0);
        for turn in 0_u64.. {
            // Every hundredth wake-up is 8 ms late.
            now = pace.due_ns().max(now) + if turn % 100 == 99 { 8_000_000 } else { 100_000 };
            polls += 1;
            let newest = (0_u64..).take_while(|n| ready_at(*n) <= now).last();
            if newest == last {
                now += 500_000;
                pace.nothing_new(now);
                continue;
            }
            assert_eq!(newest, last.map_or(Some(0), |last| Some(last + 1)), "turn {turn}");
            last = newest;
            waited += now - ready_at(newest.unwrap());
            now += 3_000_000;
            pace.new_frame(1, now);
            if newest == Some(600) {
                break;
            }
        }
        assert!(polls < 1200, "{polls} polls for 600 frames");
        assert!(waited / 600 < 2_500_000, "{} ns late in the mean", waited / 600);
    }
}

//! Derives lost and repeated frames from the device's frame counter.

/// Largest gap that counts as loss; beyond it the counter jumped: 17 minutes at 1000 Hz.
const MISSING_MAX: i32 = 1 << 20;

/// Largest gap after an outage for a counter that has gone on: a day and more at 10 kHz.
const OUTAGE_MAX: i32 = 1 << 30;

/// A frame at most this far behind came late or twice: links do not reorder further. Beyond it the
/// device started again.
const LATE_MIN: i32 = -64;

/// Gaps up to this size are never doubted: a clock read late by a few frame times does not refute the counter.
const DOUBTED_MIN: i32 = 8;

/// A counter that advanced this many times further than the device's own clock allows did not lose frames. Far from
/// 1: the true rate may differ from the stated one, and the clock may be set while frames are lost.
const CLOCK_FACTOR: f64 = 4.0;

/// What a frame's counter says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SeqStep {
    /// The next frame, after `missing` frames that did not arrive.
    Next { missing: u32 },
    /// Received before, or late: its row is closed.
    Stale,
    /// The counter jumped as no loss explains; the frame counts as the next one.
    Jump,
}

/// Follows the counter, which wraps.
#[derive(Debug, Default)]
pub(super) struct FrameCounter {
    last: Option<(u32, u64)>,
    /// Ticks of the device's clock from a frame to the next; 0 when unknown.
    frame_ticks: f64,
}

impl FrameCounter {
    pub(super) fn new(rate_hz: f64, tick_hz: u64) -> Self {
        Self { last: None, frame_ticks: tick_hz as f64 / rate_hz }
    }

    /// Whether, by its own clock, the device cannot have produced `ahead` frames since the last one.
    fn is_ahead_of_clock(&self, ahead: i32, ticks: u64, last_ticks: u64) -> bool {
        // A clock that went back proves nothing.
        let elapsed = ticks.checked_sub(last_ticks).filter(|elapsed| *elapsed > 0);
        elapsed.is_some_and(|elapsed| {
            ahead > DOUBTED_MIN
                && f64::from(ahead) * self.frame_ticks > CLOCK_FACTOR * elapsed as f64
        })
    }

    /// How many frames before the last one the device's clock showed `ticks`; `None` without a frame, or a clock that jumped.
    pub(super) fn frames_back(&self, ticks: u64) -> Option<u64> {
        let (_, last_ticks) = self.last?;
        let frames = last_ticks.checked_sub(ticks)? as f64 / self.frame_ticks;
        (frames < f64::from(MISSING_MAX)).then_some(frames.round() as u64)
    }

    /// The first frame after an outage: the number of frames missing in between, or `None` when counter and clock do
    /// not continue from where they were, because the device lost its power.
    pub(super) fn rejoin(&mut self, seq: u32, device_ticks: u64) -> Option<u32> {
        let last = self.last.replace((seq, device_ticks));
        let Some((last, ticks)) = last else { return Some(0) };
        match seq.wrapping_sub(last).cast_signed() {
            ahead @ 1..=OUTAGE_MAX if device_ticks > ticks => {
                // The counter stood still while the device was stopped, but its clock continued.
                let elapsed = (device_ticks - ticks) as f64 / self.frame_ticks;
                let by_clock = if elapsed.is_finite() { elapsed.round() as i64 } else { 0 };
                let slack = i64::from(DOUBTED_MIN).max(i64::from(ahead) / 100);
                let stood_still = by_clock - i64::from(ahead) > slack;
                let ahead =
                    if stood_still { by_clock.min(OUTAGE_MAX.into()) } else { ahead.into() };
                Some(ahead as u32 - 1)
            }
            _ => None,
        }
    }

    /// A frame during the stream. The device's clock distinguishes a late frame from a counter that started again.
    pub(super) fn step(&mut self, seq: u32, device_ticks: u64) -> SeqStep {
        let step = match self.last {
            None => SeqStep::Next { missing: 0 },
            Some((last, ticks)) => match seq.wrapping_sub(last).cast_signed() {
                ahead @ 1.. if self.is_ahead_of_clock(ahead, device_ticks, ticks) => SeqStep::Jump,
                ahead @ 1..=MISSING_MAX => SeqStep::Next { missing: ahead as u32 - 1 },
                LATE_MIN..=0 if device_ticks <= ticks => return SeqStep::Stale,
                _ => SeqStep::Jump,
            },
        };
        self.last = Some((seq, device_ticks));
        step
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counter_wraps_around() {
        let mut counter = FrameCounter::default();
        assert_eq!(counter.step(u32::MAX - 1, 10), SeqStep::Next { missing: 0 });
        assert_eq!(counter.step(u32::MAX, 20), SeqStep::Next { missing: 0 });
        assert_eq!(counter.step(2, 50), SeqStep::Next { missing: 2 });
        assert_eq!(counter.step(2, 50), SeqStep::Stale);
        assert_eq!(counter.step(1, 40), SeqStep::Stale);
        assert_eq!(counter.step(3, 60), SeqStep::Next { missing: 0 });
    }

    #[test]
    fn a_time_is_that_of_an_earlier_frame() {
        let mut counter = FrameCounter::new(100.0, 1000);
        assert_eq!(counter.frames_back(5), None, "no frame yet");
        counter.step(7, 500);
        assert_eq!(counter.frames_back(500), Some(0));
        assert_eq!(counter.frames_back(476), Some(2));
        assert_eq!(counter.frames_back(511), None, "after the last frame");
    }

    #[test]
    fn after_an_outage_a_device_continues_or_restarts() {
        let mut counter = FrameCounter::default();
        assert_eq!(counter.rejoin(7, 10), Some(0), "nothing came before");
        assert_eq!(counter.rejoin(20, 300), Some(12));
        assert_eq!(counter.rejoin(0, 5), None, "counter and clock began anew");
        assert_eq!(counter.step(1, 15), SeqStep::Next { missing: 0 });
        assert_eq!(counter.rejoin(1, 15), None, "as early as before, by another clock");
        assert_eq!(counter.rejoin(9, 3), None, "a clock that went back");
        counter.step(u32::MAX, 400);
        assert_eq!(counter.rejoin(2, 500), Some(2), "through the wrap");
    }

    #[test]
    fn after_an_outage_the_clock_counts_if_the_counter_stood_still() {
        let mut counter = FrameCounter::new(100.0, 1000);
        counter.step(10, 100);
        assert_eq!(counter.rejoin(11, 5_100), Some(499), "stopped for five seconds");
        assert_eq!(counter.rejoin(111, 6_100), Some(99), "they agree");
        assert_eq!(counter.rejoin(112, 6_180), Some(0), "a clock that is read late says little");
    }

    #[test]
    fn a_counter_that_is_ahead_of_its_own_clock_is_a_jump() {
        let mut counter = FrameCounter::new(100.0, 1000);
        counter.step(0, 0);
        assert_eq!(counter.step(501, 5010), SeqStep::Next { missing: 500 }, "five seconds elapsed");
        assert_eq!(counter.step(1002, 5020), SeqStep::Jump, "a hundredth elapsed");
        assert_eq!(counter.step(1003, 5030), SeqStep::Next { missing: 0 });
        assert_eq!(counter.step(1010, 5040), SeqStep::Next { missing: 6 }, "too few to doubt");
        assert_eq!(counter.step(1111, 5300), SeqStep::Next { missing: 100 }, "a misstated rate");
        assert_eq!(counter.step(1212, 4000), SeqStep::Next { missing: 100 }, "a clock set back");
        let mut counter = FrameCounter::default();
        counter.step(0, 0);
        assert_eq!(counter.step(501, 1), SeqStep::Next { missing: 500 }, "an unknown clock");
    }

    #[test]
    fn a_counter_that_starts_again_is_a_jump() {
        let mut counter = FrameCounter::default();
        counter.step(500, 10);
        assert_eq!(counter.step(480, 20), SeqStep::Jump, "its clock went on");
        assert_eq!(counter.step(0, 5), SeqStep::Jump, "counter and clock began anew");
        assert_eq!(counter.step(1, 30), SeqStep::Next { missing: 0 });
        assert_eq!(counter.step(1 << 30, 40), SeqStep::Jump);
    }
}

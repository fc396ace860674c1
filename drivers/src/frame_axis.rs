//! The frame axis: one counter out of a vendor's frame number and its time stamp.
//!
//! Live, the number may stand still while the time goes on, as QTM's does
//! (<https://github.com/qualisys/qualisys_python_sdk/issues/37>). The time, in whole microseconds, then tells how many frames
//! have passed. Where the number advances, it is what counts: a time stamp may be late.

/// The last frame that was not late.
#[derive(Debug, Clone, Copy)]
struct LastFrame {
    number: u32,
    time_us: u64,
    counter: u32,
    /// When it should have been exposed, where time counts: time stamps that jitter must not add up.
    grid_us: f64,
    /// Whether its number was that of the frame before it.
    stood_still: bool,
}

/// Frames by their numbers or times, as a counter that wraps.
#[derive(Debug, Default)]
pub(crate) struct FrameAxis {
    /// Duration of a frame.
    period_us: f64,
    last: Option<LastFrame>,
}

/// A number that goes back by more is no late frame: the count began again. The recorder applies the same rule.
const LATE_MAX: i64 = 64;

/// Part of a time stamp's deviation that the grid takes over: it follows a true rate that differs from the stated one, and
/// hardly a single stamp.
const GRID_GAIN: f64 = 0.125;

impl FrameAxis {
    /// An axis for frames at this rate.
    pub(crate) fn new(rate_millihertz: u32) -> Self {
        Self { period_us: 1e9 / f64::from(rate_millihertz.max(1)), last: None }
    }

    /// The counter of a frame. Of two equal ones, the second is a duplicate, and one below the last is late.
    pub(crate) fn counter(&mut self, number: u32, time_us: u64) -> u32 {
        let Some(last) = self.last else {
            let grid_us = time_us as f64;
            let first = LastFrame { number, time_us, counter: number, grid_us, stood_still: false };
            self.last = Some(first);
            return number;
        };
        let by_number = i64::from(number.wrapping_sub(last.number).cast_signed());
        let elapsed_us = time_us.wrapping_sub(last.time_us).cast_signed();
        // A number that stood still may jump to where it should be: what passed meanwhile was counted by time.
        let stands_still = by_number == 0;
        let counts_time = stands_still || (last.stood_still && by_number > 0 && elapsed_us > 0);
        let steps = if counts_time { self.frames_until(&last, elapsed_us) } else { by_number };
        let counter = last.counter.wrapping_add(steps as u32);
        let is_late = (-LATE_MAX..=0).contains(&steps) && elapsed_us <= 0;
        if !is_late {
            let expected_us = last.grid_us + steps as f64 * self.period_us;
            let deviation_us = time_us as f64 - expected_us;
            let grid_us = if counts_time && deviation_us.abs() < self.period_us {
                expected_us + GRID_GAIN * deviation_us
            } else {
                time_us as f64
            };
            let stood_still = stands_still;
            self.last = Some(LastFrame { number, time_us, counter, grid_us, stood_still });
        }
        counter
    }

    /// Frames from the last one to one that is so much later: at least one in either direction, unless the time is the same.
    fn frames_until(&self, last: &LastFrame, elapsed_us: i64) -> i64 {
        let since_grid_us = last.time_us as f64 + elapsed_us as f64 - last.grid_us;
        let frames = (since_grid_us / self.period_us).round() as i64;
        // Beyond this the recorder takes it for a jump in any case.
        let frames = frames.clamp(i64::from(i32::MIN), i64::from(i32::MAX));
        match elapsed_us {
            0 => 0,
            1.. => frames.max(1),
            _ => frames.min(-1),
        }
    }
}

/// Time over which the rate is measured, in microseconds: a stamp that is late by a frame changes it by little.
const RATE_WINDOW_US: u64 = 1_000_000;

/// Part by which the measured rate may differ from the stated one: clocks differ by a ten-thousandth.
const RATE_DEVIATION_MAX: f64 = 0.02;

/// Windows in a row that must show it: a clock or a number that jumps spoils one.
const RATE_WINDOWS: u32 = 2;

/// Compares the rate of frames by their numbers and times with the stated one.
#[derive(Debug, Default)]
pub(super) struct RateCheck {
    /// The first frame of the window, and the last one: number and time.
    window: Option<[(u32, u64); 2]>,
    n_deviating: u32,
    is_reported: bool,
}

impl RateCheck {
    /// Follows a frame. Returns the rate in Hz, once, when it is another than the stated one.
    pub(super) fn follow(&mut self, number: u32, time_us: u64, rate_hz: f64) -> Option<f64> {
        let here = (number, time_us);
        let [first, last] = self.window.get_or_insert([here; 2]);
        let ahead = number.wrapping_sub(last.0).cast_signed();
        if (-LATE_MAX..=0).contains(&i64::from(ahead)) && time_us <= last.1 {
            // A datagram that came late or twice.
            return None;
        }
        if ahead <= 0 || time_us <= last.1 {
            // A number that stands still counts nothing, and one that began again nothing with those before.
            self.window = Some([here; 2]);
            self.n_deviating = 0;
            return None;
        }
        *last = here;
        let elapsed_us = time_us - first.1;
        if elapsed_us < RATE_WINDOW_US {
            return None;
        }
        let measured_hz = f64::from(number.wrapping_sub(first.0)) * 1e6 / elapsed_us as f64;
        self.window = Some([here; 2]);
        let deviates = (measured_hz / rate_hz - 1.0).abs() > RATE_DEVIATION_MAX;
        self.n_deviating = if deviates { self.n_deviating + 1 } else { 0 };
        let is_new = self.n_deviating >= RATE_WINDOWS && !self.is_reported;
        self.is_reported |= is_new;
        is_new.then_some(measured_hz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counters(frames: &[(u32, u64)]) -> Vec<u32> {
        let mut axis = FrameAxis::new(100_000);
        frames.iter().map(|(number, time_us)| axis.counter(*number, *time_us)).collect()
    }

    #[test]
    fn another_rate_is_noticed_once_and_jumps_are_not() {
        const NONE: [u64; 0] = [];
        let run = |frame: &dyn Fn(u32) -> (u32, u64)| -> Vec<u64> {
            let mut check = RateCheck::default();
            let frames = (0..1000).map(frame);
            let follow = |(number, time_us)| check.follow(number, time_us, 100.0);
            frames.filter_map(follow).map(|hz| hz.round() as u64).collect()
        };
        let at = |number: u32, period_us: u64| (number, u64::from(number) * period_us);
        assert_eq!(run(&|n| at(n, 10_000)), NONE);
        assert_eq!(run(&|n| at(n, 10_050)), NONE, "a clock that is half a percent off");
        let changes = |n: u32| {
            let (slow, fast) = (n.min(500), n.saturating_sub(500));
            (n, u64::from(slow) * 10_000 + u64::from(fast) * 5_000)
        };
        assert_eq!(run(&changes), [200]);
        // Every second number, as from a QTM that processes half of the frames.
        assert_eq!(run(&|n| at(2 * n, 10_000)), NONE);
        assert_eq!(run(&|n| (1, u64::from(n) * 5_000)), NONE, "it stands still");
        assert_eq!(run(&|n| (n + 400 * (n / 300), u64::from(n) * 10_000)), NONE, "it jumps");
    }

    #[test]
    fn numbers_count_where_they_advance() {
        // A late time stamp between 7 and 8, then two frames missing.
        assert_eq!(counters(&[(7, 0), (8, 14_000), (9, 20_000), (12, 50_000)]), [7, 8, 9, 12]);
        assert_eq!(counters(&[(u32::MAX, 0), (0, 10_000), (1, 20_000)]), [u32::MAX, 0, 1]);
    }

    #[test]
    fn time_counts_where_the_number_stands_still() {
        let frames = [(1, 0), (1, 10_000), (1, 20_001), (1, 49_998), (1, 60_000)];
        assert_eq!(counters(&frames), [1, 2, 3, 6, 7]);
        // Two frames of 10 ms that QTM stamped 3 ms apart are still two.
        assert_eq!(counters(&[(1, 0), (1, 3_000)]), [1, 2]);
    }

    #[test]
    fn jitter_of_time_stamps_does_not_add_up() {
        // 3 ms late, the next one lost, and 4 ms early: intervals of 13 ms, of which none is two frames.
        assert_eq!(counters(&[(1, 0), (1, 13_000), (1, 26_000)]), [1, 2, 4]);
        // A true rate that is 0.1 % below the stated one.
        let frames: Vec<_> = (0..5000).map(|k| (1, k * 10_010)).collect();
        assert_eq!(counters(&frames), (1..=5000).collect::<Vec<_>>());
    }

    #[test]
    fn a_number_that_catches_up_is_not_counted_twice() {
        let frames = [(1, 0), (1, 10_000), (1, 20_000), (4, 30_000), (5, 40_000), (7, 60_000)];
        assert_eq!(counters(&frames), [1, 2, 3, 4, 5, 7]);
    }

    #[test]
    fn late_frames_and_duplicates_move_nothing() {
        let by_number = [(5, 50_000), (7, 70_000), (6, 60_000), (7, 70_000), (8, 80_000)];
        assert_eq!(counters(&by_number), [5, 7, 6, 7, 8]);
        let by_time = [(1, 50_000), (1, 70_000), (1, 60_000), (1, 70_000), (1, 80_000)];
        assert_eq!(counters(&by_time), [1, 3, 2, 3, 4]);
    }

    #[test]
    fn a_number_that_begins_to_advance_goes_on() {
        assert_eq!(counters(&[(1, 0), (1, 10_000), (2, 20_000), (3, 30_000)]), [1, 2, 3, 4]);
    }

    #[test]
    fn a_count_that_begins_again_goes_far_back() {
        assert_eq!(counters(&[(500, 5_000_000), (1, 10_000), (2, 20_000)]), [500, 1, 2]);
    }
}

//! The frame axis: one counter out of QTM's frame number and its time stamp.
//!
//! Live, QTM's number may stand still while its time goes on
//! (<https://github.com/qualisys/qualisys_python_sdk/issues/37>). The time, in whole microseconds, then tells how many frames
//! have passed. Where the number advances, it is what counts: a time stamp may be late.

/// Frames by their numbers or times, as a counter that wraps.
#[derive(Debug, Default)]
pub(super) struct FrameAxis {
    /// Duration of a frame.
    period_us: f64,
    /// Number, time and counter of the last frame that was not late.
    last: Option<(u32, u64, u32)>,
}

/// A number that goes back by more is no late frame: the count began again. The recorder applies the same rule.
const LATE_MAX: i64 = 64;

impl FrameAxis {
    /// An axis for frames at this rate.
    pub(super) fn new(rate_millihertz: u32) -> Self {
        Self { period_us: 1e9 / f64::from(rate_millihertz.max(1)), last: None }
    }

    /// The counter of a frame. Of two equal ones, the second is a duplicate, and one below the last is late.
    pub(super) fn counter(&mut self, number: u32, time_us: u64) -> u32 {
        let Some((last_number, last_us, last)) = self.last else {
            self.last = Some((number, time_us, number));
            return number;
        };
        let by_number = i64::from(number.wrapping_sub(last_number).cast_signed());
        let elapsed_us = time_us.wrapping_sub(last_us).cast_signed();
        let steps = if by_number == 0 { self.frames_in(elapsed_us) } else { by_number };
        let counter = last.wrapping_add(steps as u32);
        let is_late = (-LATE_MAX..=0).contains(&steps) && elapsed_us <= 0;
        if !is_late {
            self.last = Some((number, time_us, counter));
        }
        counter
    }

    /// Frames in a time, at least one if it is not zero.
    fn frames_in(&self, elapsed_us: i64) -> i64 {
        match (elapsed_us as f64 / self.period_us).round() as i64 {
            0 => elapsed_us.signum(),
            // Beyond this the recorder takes it for a jump in any case.
            frames => frames.clamp(i64::from(i32::MIN), i64::from(i32::MAX)),
        }
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

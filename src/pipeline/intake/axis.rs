//! The device's frame counter as an axis of rows.

/// A frame this far ahead is a counter that jumped, not loss: 17 minutes at 1000 Hz.
const MISSING_MAX: i32 = 1 << 20;

/// A frame this far behind may have come late or twice: links do not reorder further. Beyond it the
/// device began anew.
const LATE_MIN: i32 = -64;

/// What a frame's counter says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    /// The next frame, after so many that did not come.
    Next { missing: u32 },
    /// Seen before, or late: its row has passed.
    Again,
    /// The counter went where no loss can take it; the frame counts as the next one.
    Jump,
}

/// Follows the counter, which wraps.
#[derive(Debug, Default)]
pub(super) struct Axis {
    last: Option<(u32, u64)>,
}

impl Axis {
    /// The device's clock tells a late frame from a counter that began anew.
    pub(super) fn step(&mut self, seq: u32, device_ticks: u64) -> Step {
        let step = match self.last {
            None => Step::Next { missing: 0 },
            Some((last, ticks)) => match seq.wrapping_sub(last).cast_signed() {
                ahead @ 1..=MISSING_MAX => Step::Next { missing: ahead as u32 - 1 },
                LATE_MIN..=0 if device_ticks <= ticks => return Step::Again,
                _ => Step::Jump,
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
    fn counts_through_the_wrap() {
        let mut axis = Axis::default();
        assert_eq!(axis.step(u32::MAX - 1, 10), Step::Next { missing: 0 });
        assert_eq!(axis.step(u32::MAX, 20), Step::Next { missing: 0 });
        assert_eq!(axis.step(2, 50), Step::Next { missing: 2 });
        assert_eq!(axis.step(2, 50), Step::Again);
        assert_eq!(axis.step(1, 40), Step::Again);
        assert_eq!(axis.step(3, 60), Step::Next { missing: 0 });
    }

    #[test]
    fn a_counter_that_begins_anew_is_a_jump() {
        let mut axis = Axis::default();
        axis.step(500, 10);
        assert_eq!(axis.step(480, 20), Step::Jump, "its clock went on");
        assert_eq!(axis.step(0, 5), Step::Jump, "counter and clock began anew");
        assert_eq!(axis.step(1, 30), Step::Next { missing: 0 });
        assert_eq!(axis.step(1 << 30, 40), Step::Jump);
    }
}

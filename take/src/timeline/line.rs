//! Arrivals: a line through device time that follows them, and steps off it.

use mocapd_codec::range::{BinaryCoder, Bit};

use super::number::Number;

/// Fraction bits of offset and slope.
const FRACTION: u32 = 16;

/// How much of a step the offset and the slope take over: 1/16 and 1/4096.
const OFFSET_SHIFT: u32 = 4;
const SLOPE_SHIFT: u32 = 12;

/// Beyond so many steps the line begins anew: a batch, or a clock that was set.
const STEPS_MAX: u64 = 64;

/// The line strays no further from where it began: six hours, or as much a row.
const STRAY_MAX: i64 = 1 << 47;

/// Rows that came with the row before them are counted up to this.
const BATCH_MAX: usize = 7;

/// Longest step: three minutes.
pub(super) const SHIFT_MAX: u8 = 24;

/// What follows the arrivals from row to row.
#[derive(Debug)]
pub(super) struct Line {
    tick_hz: u64,
    /// The step is 10 us times two to this.
    shift: u8,
    from_ticks: u64,
    from_arrival_10us: u64,
    /// How far the line lies above that, and by how much more each row, in 10 us / 65536.
    offset: i64,
    slope: i64,
    last_10us: u64,
    steps: Number,
    together: [Bit; BATCH_MAX + 1],
    n_together: usize,
}

impl Line {
    /// From a row that arrived so.
    pub(super) fn new(tick_hz: u64, shift: u8, ticks: u64, arrival_10us: u64) -> Self {
        let mut together = [Bit::expecting(128); BATCH_MAX + 1];
        together[0] = Bit::expecting(2);
        Self {
            tick_hz: tick_hz.max(1),
            shift,
            from_ticks: ticks,
            from_arrival_10us: arrival_10us,
            offset: 0,
            slope: 0,
            last_10us: arrival_10us,
            steps: Number::new(32),
            together,
            n_together: 0,
        }
    }

    /// The row `rows` after the last: its arrival to within half a step, or the one that is decoded.
    pub(super) fn code(
        &mut self,
        coder: &mut impl BinaryCoder,
        rows: u64,
        ticks: u64,
        arrival_10us: u64,
    ) -> u64 {
        let rows = i64::try_from(rows).unwrap_or(i64::MAX);
        self.offset = stray(self.offset.saturating_add(self.slope.saturating_mul(rows)));
        let half = 1_u64 << self.shift >> 1;
        let with_last = distance(arrival_10us, self.last_10us).unsigned_abs() <= half;
        if coder.bit(&mut self.together[self.n_together], with_last) {
            self.n_together = (self.n_together + 1).min(BATCH_MAX);
            return self.last_10us;
        }
        self.n_together = 0;
        let passed = i128::from(distance(ticks, self.from_ticks)) * 100_000;
        let expected = self
            .from_arrival_10us
            .wrapping_add(passed.div_euclid(i128::from(self.tick_hz)) as u64)
            .wrapping_add_signed(self.offset >> FRACTION);
        let late = i128::from(distance(arrival_10us, expected));
        let steps = (late + i128::from(half)) >> self.shift;
        let steps = self.steps.code(coder, steps as i64);
        self.last_10us = expected.wrapping_add((steps as u64) << self.shift);
        if steps.unsigned_abs() > STEPS_MAX {
            self.from_ticks = ticks;
            self.from_arrival_10us = self.last_10us;
            self.offset = 0;
        } else {
            let by = steps << self.shift << FRACTION;
            self.offset = stray(self.offset + (by >> OFFSET_SHIFT));
            self.slope = stray(self.slope + (by >> SLOPE_SHIFT));
        }
        self.last_10us
    }
}

fn stray(value: i64) -> i64 {
    value.clamp(-STRAY_MAX, STRAY_MAX)
}

/// From `b` to `a`, the short way round.
fn distance(a: u64, b: u64) -> i64 {
    a.wrapping_sub(b).cast_signed()
}

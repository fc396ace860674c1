//! Adaptive models that predict ticks, arrivals and timecodes from row to row and code the prediction errors.

use mocapd_codec::range::{BinaryCoder, Bit};

// Signed integers that are mostly near zero: docs/take-format.md, "Numbers".

/// Contexts distinguish the last two values up to these magnitudes; batched arrivals turn them into a sawtooth.
const LAST_MAX: i64 = 3;
const BEFORE_MAX: i64 = 1;
const CONTEXTS: usize = ((2 * LAST_MAX + 1) * (2 * BEFORE_MAX + 1)) as usize;

/// Magnitudes up to this are coded in unary.
const LONGER: usize = 12;

/// Lower limits of the activity classes.
const CLASSES: [u32; 5] = [12, 48, 128, 320, 1024];

/// An adaptive model of one kind of signed integer.
#[derive(Debug)]
pub(crate) struct ResidualModel {
    nonzero: [Bit; CONTEXTS],
    negative: [Bit; CONTEXTS],
    longer: [[Bit; LONGER]; CLASSES.len() + 1],
    exponent: [Bit; 63],
    last: i64,
    before: i64,
    activity: u32,
}

impl ResidualModel {
    /// `odds`: the initial probability, in 1/256, that a value after two zeros is not zero.
    pub(crate) fn new(odds: u8) -> Self {
        let mut nonzero = [Bit::expecting(128); CONTEXTS];
        nonzero[CONTEXTS / 2] = Bit::expecting(odds);
        Self {
            nonzero,
            negative: [Bit::NEW; CONTEXTS],
            longer: [[Bit::NEW; LONGER]; CLASSES.len() + 1],
            exponent: [Bit::NEW; 63],
            last: 0,
            before: 0,
            activity: 0,
        }
    }

    /// Encodes `value` and returns it; with a decoder, ignores it and returns the decoded value.
    pub(crate) fn code(&mut self, coder: &mut impl BinaryCoder, value: i64) -> i64 {
        let last = self.last.clamp(-LAST_MAX, LAST_MAX) + LAST_MAX;
        let before = self.before.clamp(-BEFORE_MAX, BEFORE_MAX) + BEFORE_MAX;
        let context = (last * (2 * BEFORE_MAX + 1) + before) as usize;
        let value = if coder.bit(&mut self.nonzero[context], value != 0) {
            let negative = coder.bit(&mut self.negative[context], value < 0);
            let magnitude = self.code_magnitude(coder, value.unsigned_abs()).cast_signed();
            if negative { magnitude.wrapping_neg() } else { magnitude }
        } else {
            0
        };
        let seen = value.unsigned_abs().min(31) as u32;
        self.activity = self.activity - (self.activity >> 3) + 32 * seen;
        self.before = std::mem::replace(&mut self.last, value);
        value
    }

    /// Codes a magnitude of at least 1, modulo 2^64.
    fn code_magnitude(&mut self, coder: &mut impl BinaryCoder, magnitude: u64) -> u64 {
        let class = CLASSES.iter().filter(|&&from| self.activity >= from).count();
        for (steps, longer) in (1..).zip(&mut self.longer[class]) {
            if !coder.bit(longer, magnitude > steps) {
                return steps;
            }
        }
        // `rest`, at least 1, has its highest bit at `exponent`.
        let rest = magnitude.wrapping_sub(LONGER as u64);
        let top = rest.max(1).ilog2();
        let mut exponent = 0;
        while exponent < 63 && coder.bit(&mut self.exponent[exponent as usize], exponent < top) {
            exponent += 1;
        }
        let low = coder.plain(rest & !(1 << top), exponent);
        (1_u64 << exponent | low).wrapping_add(LONGER as u64)
    }
}

// Device ticks from row to row: a rational number of ticks per row, and the fraction of a tick carried between rows.

/// Maximum number of rows of a period; enough for any rate that devices state.
const ROWS_MAX: u64 = 0xffff;

/// A frame period, as a number of ticks in a number of rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FramePeriod {
    pub(super) ticks: u64,
    /// At least 1, at most 65 535.
    pub(super) rows: u64,
}

impl FramePeriod {
    /// The shortest period that is within one tick per million rows of the rate, or the closest.
    pub(super) fn from_rate(tick_hz: u64, rate_hz: f64) -> Self {
        let wanted = tick_hz.max(1) as f64 / rate_hz;
        // Convergents of the continued fraction; casts saturate.
        let (mut before, mut last) = ((1_u64, 0_u64), (wanted.floor() as u64, 1));
        let mut rest = wanted.fract();
        while (last.0 as f64 / last.1 as f64 - wanted).abs() > 1e-6 && rest > 1e-9 {
            let inverse = rest.recip();
            let whole = inverse.floor() as u64;
            let next = |last: u64, before: u64| last.saturating_mul(whole).saturating_add(before);
            let convergent = (next(last.0, before.0), next(last.1, before.1));
            if convergent.1 > ROWS_MAX {
                break;
            }
            (before, last) = (last, convergent);
            rest = inverse.fract();
        }
        Self { ticks: last.0, rows: last.1 }
    }

    /// The period measured between two rows; `None` if they are too far apart, or ticks decreased.
    pub(super) fn between(first: (u64, u64), last: (u64, u64)) -> Option<Self> {
        let rows = last.0.checked_sub(first.0).filter(|n| (1..=ROWS_MAX).contains(n))?;
        let ticks = last.1.checked_sub(first.1)?;
        let mut divisor = (rows, ticks);
        while divisor.1 > 0 {
            divisor = (divisor.1, divisor.0 % divisor.1);
        }
        Some(Self { ticks: ticks / divisor.0, rows: rows / divisor.0 })
    }
}

/// Predicts the ticks of each row from those of the previous one.
#[derive(Debug, Clone, Copy)]
pub(super) struct TickPredictor {
    period: FramePeriod,
    ticks: u64,
    /// Elapsed fraction of the next tick, in 1/`period.rows`.
    part: u64,
}

impl TickPredictor {
    /// Starts at a row with these ticks. `None` for a period of no rows or too many.
    pub(super) fn new(period: FramePeriod, ticks: u64) -> Option<Self> {
        let part = period.rows / 2;
        (1..=ROWS_MAX).contains(&period.rows).then_some(Self { period, ticks, part })
    }

    /// A clock that does not advance.
    pub(super) fn stopped() -> Self {
        Self { period: FramePeriod { ticks: 0, rows: 1 }, ticks: 0, part: 0 }
    }

    /// The ticks predicted for the row that is `rows` rows further on.
    pub(super) fn predict(&mut self, rows: u64) -> u64 {
        let n = u128::from(self.period.rows);
        let passed = u128::from(self.part) + u128::from(self.period.ticks) * u128::from(rows);
        self.part = (passed % n) as u64;
        self.ticks = self.ticks.wrapping_add((passed / n) as u64);
        self.ticks
    }

    /// Corrects the prediction by its error.
    pub(super) fn correct(&mut self, error: i64) {
        self.ticks = self.ticks.wrapping_add_signed(error);
        // The fraction closest to the predicted one.
        match error {
            0 => {}
            1.. => self.part = 0,
            _ => self.part = self.period.rows - 1,
        }
    }
}

// Arrivals: a line over device time follows them; arrivals are coded as steps from it.

/// Fraction bits of offset and slope.
const FRACTION: u32 = 16;

/// Adaptation rates of offset and slope per step: 1/16 and 1/4096.
const OFFSET_SHIFT: u32 = 4;
const SLOPE_SHIFT: u32 = 12;

/// Beyond this many steps the line restarts: a batch, or a clock that was set.
const STEPS_MAX: u64 = 64;

/// Largest offset from the start of the line: six hours. The limit of the slope per row is the same.
const LINE_MAX: i64 = 1 << 47;

/// Maximum number of rows that are counted as arriving together with the previous row.
const BATCH_MAX: usize = 7;

/// Longest quantisation step: three minutes.
pub(super) const SHIFT_MAX: u8 = 24;

/// Predicts arrivals from row to row.
#[derive(Debug)]
pub(super) struct ArrivalModel {
    tick_hz: u64,
    /// The quantisation step is 10 us times two to this power.
    shift: u8,
    from_ticks: u64,
    from_arrival_10us: u64,
    /// Offset of the line from its start, and its increase per row, in 10 us / 65536.
    offset: i64,
    slope: i64,
    last_10us: u64,
    steps: ResidualModel,
    together: [Bit; BATCH_MAX + 1],
    n_together: usize,
}

impl ArrivalModel {
    /// Starts at a row with these ticks and this arrival.
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
            steps: ResidualModel::new(32),
            together,
            n_together: 0,
        }
    }

    /// Encodes the arrival of the row `rows` after the last one and returns it to within half a step; with a decoder,
    /// returns the decoded arrival.
    pub(super) fn code(
        &mut self,
        coder: &mut impl BinaryCoder,
        rows: u64,
        ticks: u64,
        arrival_10us: u64,
    ) -> u64 {
        let rows = i64::try_from(rows).unwrap_or(i64::MAX);
        self.offset = clamp_line(self.offset.saturating_add(self.slope.saturating_mul(rows)));
        let half = 1_u64 << self.shift >> 1;
        let with_last = distance(arrival_10us, self.last_10us).unsigned_abs() <= half;
        if coder.bit(&mut self.together[self.n_together], with_last) {
            self.n_together = (self.n_together + 1).min(BATCH_MAX);
            return self.last_10us;
        }
        self.n_together = 0;
        let passed = i128::from(distance(ticks, self.from_ticks)) * 100_000;
        let passed_10us = passed.div_euclid(i128::from(self.tick_hz)) as u64;
        let expected = self.from_arrival_10us.wrapping_add(passed_10us);
        let expected = expected.wrapping_add_signed(self.offset >> FRACTION);
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
            self.offset = clamp_line(self.offset + (by >> OFFSET_SHIFT));
            self.slope = clamp_line(self.slope + (by >> SLOPE_SHIFT));
        }
        self.last_10us
    }
}

fn clamp_line(value: i64) -> i64 {
    value.clamp(-LINE_MAX, LINE_MAX)
}

/// The signed distance from `b` to `a` modulo 2^64.
fn distance(a: u64, b: u64) -> i64 {
    a.wrapping_sub(b).cast_signed()
}

// Timecodes: equal to the previous one, one frame later, or stored in full.

/// Maximum number of rows of one timecode that are counted: 480 Hz at 30 frames per second.
const HELD_MAX: usize = 16;

/// Predicts each timecode from the previous one.
#[derive(Debug)]
pub(super) struct TimecodeModel {
    last: Option<[u8; 4]>,
    /// Rows since the last change.
    n_held: usize,
    /// The frame number at which the seconds last advanced.
    top: u8,
    present: [Bit; 2],
    held: [Bit; HELD_MAX + 1],
    /// Contexts: other frame numbers, and the one in `top`.
    next: [Bit; 2],
    carry: [Bit; 2],
}

impl TimecodeModel {
    pub(super) fn new() -> Self {
        Self {
            last: None,
            n_held: 0,
            top: u8::MAX,
            present: [Bit::expecting(0), Bit::expecting(255)],
            held: [Bit::expecting(128); HELD_MAX + 1],
            next: [Bit::expecting(240), Bit::expecting(16)],
            carry: [Bit::expecting(240); 2],
        }
    }

    /// Encodes `timecode` and returns it; with a decoder, ignores it and returns the decoded one.
    pub(super) fn code(
        &mut self,
        coder: &mut impl BinaryCoder,
        timecode: Option<[u8; 4]>,
    ) -> Option<[u8; 4]> {
        let present = &mut self.present[usize::from(self.last.is_some())];
        if !coder.bit(present, timecode.is_some()) {
            self.last = None;
            return None;
        }
        let given = timecode.unwrap_or_default();
        let last = self.last.unwrap_or_default();
        if coder.bit(&mut self.held[self.n_held], given == last) {
            self.n_held = (self.n_held + 1).min(HELD_MAX);
            self.last = Some(last);
            return self.last;
        }
        self.n_held = 0;
        let at_top = usize::from(last[3] == self.top);
        let (next, carried) = (next_frame(last), next_second(last));
        let coded = if coder.bit(&mut self.next[at_top], given == next) {
            next
        } else if coder.bit(&mut self.carry[at_top], given == carried) {
            self.top = last[3];
            carried
        } else {
            (coder.plain(u64::from(u32::from_be_bytes(given)), 32) as u32).to_be_bytes()
        };
        self.last = Some(coded);
        self.last
    }
}

fn next_frame([hours, minutes, seconds, frames]: [u8; 4]) -> [u8; 4] {
    [hours, minutes, seconds, frames.wrapping_add(1)]
}

fn next_second([hours, minutes, seconds, _]: [u8; 4]) -> [u8; 4] {
    match (hours, minutes, seconds) {
        (23, 59, 59) => [0; 4],
        (_, 59, 59) => [hours.wrapping_add(1), 0, 0, 0],
        (_, _, 59) => [hours, minutes.wrapping_add(1), 0, 0],
        _ => [hours, minutes, seconds.wrapping_add(1), 0],
    }
}

//! Device ticks from row to row: so many ticks in so many rows, and what is left of a tick between them.

/// Rows of a period that is given: that of any rate a device names.
const ROWS_MAX: u64 = 0xffff;

/// A period, as ticks in rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Period {
    pub(super) ticks: u64,
    /// At least 1, at most 65 535.
    pub(super) rows: u64,
}

impl Period {
    /// The shortest that is within a tick in a million rows of the rate, or the nearest there is.
    pub(super) fn of_rate(tick_hz: u64, rate_hz: f64) -> Self {
        let wanted = tick_hz.max(1) as f64 / rate_hz;
        // Convergents of the continued fraction; casts saturate.
        let (mut before, mut last) = ((1_u64, 0_u64), (wanted.floor() as u64, 1));
        let mut rest = wanted.fract();
        while (last.0 as f64 / last.1 as f64 - wanted).abs() > 1e-6 && rest > 1e-9 {
            let inverse = rest.recip();
            let (whole, next) = (inverse.floor() as u64, |a: u64, b: u64, n: u64| {
                a.saturating_mul(n).saturating_add(b)
            });
            let convergent = (next(last.0, before.0, whole), next(last.1, before.1, whole));
            if convergent.1 > ROWS_MAX {
                break;
            }
            (before, last) = (last, convergent);
            rest = inverse.fract();
        }
        Self { ticks: last.0, rows: last.1 }
    }

    /// Measured between two rows; `None` when they are too far apart, or time did not pass.
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

/// Predicts the ticks of each row from those of the row before.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pace {
    period: Period,
    ticks: u64,
    /// What has passed of the next tick, in 1/`period.rows`.
    part: u64,
}

impl Pace {
    /// From a row with these ticks. `None` for a period without rows or with too many.
    pub(super) fn new(period: Period, ticks: u64) -> Option<Self> {
        let part = period.rows / 2;
        (1..=ROWS_MAX).contains(&period.rows).then_some(Self { period, ticks, part })
    }

    /// A clock that stands still.
    pub(super) fn still() -> Self {
        Self { period: Period { ticks: 0, rows: 1 }, ticks: 0, part: 0 }
    }

    /// The ticks of the row that is so many rows on.
    pub(super) fn predict(&mut self, rows: u64) -> u64 {
        let n = u128::from(self.period.rows);
        let passed = u128::from(self.part) + u128::from(self.period.ticks) * u128::from(rows);
        self.part = (passed % n) as u64;
        self.ticks = self.ticks.wrapping_add((passed / n) as u64);
        self.ticks
    }

    /// By how much that was wrong.
    pub(super) fn correct(&mut self, error: i64) {
        self.ticks = self.ticks.wrapping_add_signed(error);
        // The part that is nearest to what was predicted.
        match error {
            0 => {}
            1.. => self.part = 0,
            _ => self.part = self.period.rows - 1,
        }
    }
}

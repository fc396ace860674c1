//! What lies between two takes that are joined.

use std::ops::Range;

use super::{CUT, SourceTake};
use crate::{
    record::{Device, Header, SeriesPlace},
    timeline::RowTime,
};

/// The longest time between two takes that counts as an outage within one recording, in seconds: the service waits for
/// its device as long (`take.reconnect`). After a longer time it begins another take, which is a recording of its own.
const OUTAGE_S_MAX: f64 = 60.0;

/// Most that the two clocks of a recording may differ over an outage, in seconds. A queue holds frames back for a
/// fraction of that, and crystals differ by a few milliseconds a minute.
const CLOCKS_APART_S_MAX: f64 = 1.0;

/// What lies between one take and the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Seam {
    /// Nothing: the second continues the first.
    Continuous,
    /// Both are of one recording, and this many frames between them are in neither: by the clocks of both, or by their
    /// places in a divided recording.
    Missing(u64),
    /// Unknown: the two are not known to be of one recording.
    Unknown,
}

impl Seam {
    /// Rows of the joined take that lie in neither of the two.
    pub(super) fn rows(self) -> u64 {
        if let Self::Missing(rows) = self { rows } else { 0 }
    }

    /// The seam between `before` and `after`.
    pub(super) fn between(before: &SourceTake, after: &SourceTake) -> Self {
        let (one, other) = (&before.map().header, &after.map().header);
        let origins = CutOrigin::of(one).zip(CutOrigin::of(other));
        if origins.is_some_and(|(one, other)| other.follows(&one)) {
            return Self::Continuous;
        }
        let in_series = SeriesPlace::rows_between(before.place(), after.place());
        let missing = match (&one.device, &other.device) {
            (Some(_), Some(_)) if in_series.is_some() => in_series,
            (Some(a), Some(b)) if is_one_device(a, b) => missing_by_clocks(before, after),
            (None, None) => {
                let next_frame = before.first_frame().checked_add(before.map().n_rows);
                let continues = next_frame == Some(after.first_frame());
                (is_one_file(one, other) && continues).then_some(0)
            }
            _ => None,
        };
        match missing {
            Some(0) => Self::Continuous,
            Some(rows) => Self::Missing(rows),
            None => Self::Unknown,
        }
    }
}

fn is_one_device(a: &Device, b: &Device) -> bool {
    let identity = |device: &Device| {
        (device.driver.clone(), device.model.clone(), device.serial.clone(), device.tick_hz)
    };
    identity(a) == identity(b)
}

fn is_one_file(one: &Header, other: &Header) -> bool {
    let files = one.source.as_ref().zip(other.source.as_ref());
    files.is_some_and(|(a, b)| (&a.format, &a.file) == (&b.format, &b.file))
}

/// Rows between two recordings of one device, by its clock and the host's; `None` unless they show that both belong to
/// one recording.
fn missing_by_clocks(before: &SourceTake, after: &SourceTake) -> Option<u64> {
    let ([first, last], [next, _]) = before.ends.zip(after.ends)?;
    let header = &before.map().header;
    let tick_hz = header.device.as_ref()?.tick_hz;
    let until_end = before.map().n_rows.checked_sub(last.0)?;
    let clock = DeviceClock::new(tick_hz, header.rate_hz, first, last);
    clock.missing(last.1, next.1, until_end.checked_add(next.0)?)
}

/// The take and the rows that a part was cut from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct CutOrigin {
    pub(super) take_id: String,
    pub(super) rows: Range<u64>,
}

impl CutOrigin {
    /// The origin that the header of a part states in its settings.
    pub(super) fn of(header: &Header) -> Option<Self> {
        let (_, text) = header.settings.iter().rfind(|(key, _)| key == CUT)?;
        let (take_id, rest) = text.split_once(": frames ")?;
        let (rows, _) = rest.split_once(" of ")?;
        let (start, end) = rows.split_once("..")?;
        let rows = start.parse().ok()?..end.parse().ok()?;
        Some(Self { take_id: take_id.to_owned(), rows })
    }

    /// The setting, for a part of a take of `n_rows` rows.
    pub(super) fn to_setting(&self, n_rows: u64, software: &str) -> String {
        let Self { take_id, rows: Range { start, end } } = self;
        format!("{take_id}: frames {start}..{end} of {n_rows}, by {software}")
    }

    /// Whether these rows follow `before` in the same take.
    fn follows(&self, before: &Self) -> bool {
        self.take_id == before.take_id && self.rows.start == before.rows.end
    }
}

/// The clock of a device, measured over a take.
struct DeviceClock {
    tick_hz: f64,
    rate_hz: f64,
    ticks_per_row: f64,
}

impl DeviceClock {
    /// Measures the period between the first and the last recorded row.
    fn new(tick_hz: u64, rate_hz: f64, first: (u64, RowTime), last: (u64, RowTime)) -> Self {
        let tick_hz = tick_hz.max(1) as f64;
        let (rows, ticks) = (
            last.0.saturating_sub(first.0) as f64,
            last.1.device_ticks.wrapping_sub(first.1.device_ticks).cast_signed() as f64,
        );
        let nominal = tick_hz / rate_hz;
        let measured = ticks / rows;
        // A clock that jumped during the take does not measure it.
        let is_plausible = (measured / nominal - 1.0).abs() < 0.01;
        let ticks_per_row = if is_plausible { measured } else { nominal };
        Self { tick_hz, rate_hz, ticks_per_row }
    }

    /// Rows that are missing between the rows recorded at `last` and `next`, if `rows` lie between them when none is.
    /// `None` unless both clocks show that the second follows the first within an outage.
    fn missing(&self, last: RowTime, next: RowTime, rows: u64) -> Option<u64> {
        let ticks = next.device_ticks.wrapping_sub(last.device_ticks).cast_signed() as f64;
        let arrivals = next.arrival_10us.wrapping_sub(last.arrival_10us).cast_signed() as f64;
        let apart_s = arrivals * 1e-5 - ticks / self.tick_hz;
        let found = (ticks / self.ticks_per_row).round();
        let missing = found - rows as f64;
        let is_possible = missing >= 0.0 && missing <= OUTAGE_S_MAX * self.rate_hz;
        (is_possible && apart_s.abs() <= CLOCKS_APART_S_MAX).then_some(missing as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of a device with a clock of 1 MHz at 100 Hz, `late_ms` after its exposure.
    fn at(row: u64, late_ms: u64) -> RowTime {
        let device_ticks = 7_000_000 + row * 10_000;
        RowTime { device_ticks, arrival_10us: 5_000 + row * 1_000 + late_ms * 100, timecode: None }
    }

    fn missing(last: u64, next: RowTime, rows: u64) -> Option<u64> {
        let clock = DeviceClock::new(1_000_000, 100.0, (0, at(0, 1)), (last, at(last, 3)));
        clock.missing(at(last, 3), next, rows)
    }

    #[test]
    fn the_next_row_continues_and_later_ones_leave_a_gap() {
        assert_eq!(missing(99, at(100, 0), 1), Some(0));
        assert_eq!(missing(99, at(100, 400), 1), Some(0), "a frame that was held back");
        assert_eq!(missing(99, at(250, 2), 1), Some(150));
        // Rows at the ends of the takes that were lost there.
        assert_eq!(missing(99, at(250, 2), 151), Some(0));
        assert_eq!(missing(99, at(6_100, 2), 1), Some(6_000), "a minute");
    }

    #[test]
    fn other_clocks_and_longer_times_are_other_recordings() {
        assert_eq!(missing(99, at(6_101, 2), 1), None, "more than a minute");
        assert_eq!(missing(99, at(50, 2), 1), None, "before the end of the first");
        assert_eq!(missing(99, at(99, 2), 1), None, "the same row again");
        let other_host = RowTime { arrival_10us: 999_999_999, ..at(100, 0) };
        assert_eq!(missing(99, other_host, 1), None);
    }

    #[test]
    fn the_period_is_measured() {
        // 59.94 Hz, called 60: after a minute, a row and a half would be missing.
        let row = |row: u64| {
            let us = (row as f64 / 59.94 * 1e6).round() as u64;
            RowTime { device_ticks: us, arrival_10us: us / 10, timecode: None }
        };
        let clock = DeviceClock::new(1_000_000, 60.0, (0, row(0)), (3_000, row(3_000)));
        assert_eq!(clock.missing(row(3_000), row(5_997), 1), Some(2_996));
        // A take of one row measures nothing.
        let clock = DeviceClock::new(1_000_000, 60.0, (0, row(0)), (0, row(0)));
        assert_eq!(clock.missing(row(0), row(1), 1), Some(0));
    }
}

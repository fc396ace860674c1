//! What lies between two takes that are joined.

use super::super::*;

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

//! Times as people read them: on the clock of this machine's time zone, with its offset from UTC, everywhere.
//!
//! Programs get milliseconds since 1970 or UTC, in JSON and in takes.

use jiff::{Timestamp, tz::TimeZone};

/// A moment to the second, such as `2026-11-23T14:05:09+01:00`. `None` for one that no calendar has.
#[must_use]
pub fn of_unix_ms(unix_ms: i64) -> Option<String> {
    Timestamp::from_millisecond(unix_ms).ok().map(|time| words(time, TimeZone::system()))
}

/// Now, to the microsecond.
#[must_use]
pub fn now() -> String {
    let now = Timestamp::now().to_zoned(TimeZone::system());
    now.strftime("%Y-%m-%dT%H:%M:%S%.6f%:z").to_string()
}

fn words(time: Timestamp, zone: TimeZone) -> String {
    time.to_zoned(zone).strftime("%Y-%m-%dT%H:%M:%S%:z").to_string()
}

#[cfg(test)]
mod tests {
    use jiff::tz::Offset;

    use super::*;

    #[test]
    fn a_time_has_its_offset() {
        let time = Timestamp::from_second(1_763_899_509).unwrap();
        let at = |seconds| words(time, Offset::from_seconds(seconds).unwrap().to_time_zone());
        assert_eq!(at(0), "2025-11-23T12:05:09+00:00");
        assert_eq!(at(3600), "2025-11-23T13:05:09+01:00");
        assert_eq!(at(-12_600), "2025-11-23T08:35:09-03:30");
        assert_eq!(of_unix_ms(i64::MAX), None);
    }
}

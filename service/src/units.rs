//! Values as people write and read them, such as `0.5mm`, `10s` and `240Hz`, and times in this machine's time zone.

use std::time::Duration;

use jiff::{Timestamp, tz::TimeZone};
use mocapd_codec::poses::ANGLE_DEGREES;
pub use mocapd_take::quantity::{
    duration, duration_above_zero, frequency_hz, rate_hz, size_bytes, tolerance,
};

/// Parses an angle in degrees that the codec can keep as a bound.
///
/// # Errors
/// A message that says what to give.
pub fn angle_degrees(text: &str) -> Result<f64, String> {
    let number = text.trim().strip_suffix("deg").map(str::trim_end);
    let degrees = number
        .and_then(|number| number.parse().ok())
        .filter(|degrees| ANGLE_DEGREES.contains(degrees));
    degrees.ok_or_else(|| {
        format!(
            "'{text}' is no angle from {} to {} degrees: give one such as 0.05deg",
            ANGLE_DEGREES.start(),
            ANGLE_DEGREES.end()
        )
    })
}

/// Formats a duration in the largest unit without a fraction, or otherwise in seconds with every digit.
pub(crate) fn duration_text(time: Duration) -> String {
    let (s, ns) = (time.as_secs(), time.subsec_nanos());
    match (s, ns) {
        (0, 0) => "0s".to_owned(),
        (s, 0) if s % 3600 == 0 => format!("{}h", s / 3600),
        (s, 0) if s % 60 == 0 => format!("{}min", s / 60),
        (s, 0) => format!("{s}s"),
        (0, ns) if ns % 1_000_000 == 0 => format!("{}ms", ns / 1_000_000),
        _ => format!("{}s", format!("{s}.{ns:09}").trim_end_matches('0')),
    }
}

/// Formats a size in the largest binary unit without a fraction.
pub(crate) fn size_text(bytes: u64) -> String {
    let units = [(40, "TiB"), (30, "GiB"), (20, "MiB"), (10, "KiB")];
    let fits = |shift: u32| bytes > 0 && bytes.trailing_zeros() >= shift;
    match units.into_iter().find(|&(shift, _)| fits(shift)) {
        Some((shift, unit)) => format!("{}{unit}", bytes >> shift),
        None => format!("{bytes}B"),
    }
}

/// Formats a time in this machine's time zone, to the second and with its offset from UTC, such as
/// `2026-11-23T14:05:09+01:00`. `None` if no calendar has it.
#[must_use]
pub fn local_time(unix_ms: i64) -> Option<String> {
    Timestamp::from_millisecond(unix_ms).ok().map(|time| format_local(time, local_zone()))
}

/// This machine's time zone. `TimeZone::system` first lists all zones that the system knows, to find a name: a tenth of
/// what `info` of an hour costs.
fn local_zone() -> TimeZone {
    let is_chosen = std::env::var_os("TZ").is_some();
    let local = std::fs::read("/etc/localtime").ok().filter(|_| !is_chosen);
    let zone = local.and_then(|bytes| TimeZone::tzif("local", &bytes).ok());
    zone.unwrap_or_else(TimeZone::system)
}

/// The current local time to the microsecond. Programs get milliseconds since 1970 or UTC instead, in JSON and in
/// takes.
#[must_use]
pub fn local_now() -> String {
    let now = Timestamp::now().to_zoned(TimeZone::system());
    now.strftime("%Y-%m-%dT%H:%M:%S%.6f%:z").to_string()
}

fn format_local(time: Timestamp, zone: TimeZone) -> String {
    time.to_zoned(zone).strftime("%Y-%m-%dT%H:%M:%S%:z").to_string()
}

#[cfg(test)]
mod tests {
    use jiff::tz::Offset;

    use super::*;

    #[test]
    fn times_and_sizes_are_read_back_exactly() {
        for (ms, text) in [
            (0, "0s"),
            (250, "250ms"),
            (1500, "1.5s"),
            (10_000, "10s"),
            (90_000, "90s"),
            (600_000, "10min"),
            (7_200_000, "2h"),
        ] {
            assert_eq!(duration_text(Duration::from_millis(ms)), text);
        }
        // Up to the longest that a key takes, to the nanosecond.
        let mut time = Duration::from_nanos(1);
        while time < Duration::from_secs(744 * 3600) {
            assert_eq!(duration(&duration_text(time)), Ok(time), "{time:?}");
            time = time * 17 / 10 + Duration::from_nanos(3);
        }
        let mut bytes = 1_u64;
        while bytes < 1 << 50 {
            assert_eq!(size_bytes(&size_text(bytes)), Ok(bytes), "{bytes}");
            bytes = bytes * 17 / 10 + 3;
        }
        assert_eq!(size_text(256 << 20), "256MiB");
        assert_eq!(size_text(0), "0B");
    }

    #[test]
    fn a_time_has_its_offset() {
        let time = Timestamp::from_second(1_763_899_509).unwrap();
        let zone = |seconds| Offset::from_seconds(seconds).unwrap().to_time_zone();
        let at = |seconds| format_local(time, zone(seconds));
        assert_eq!(at(0), "2025-11-23T12:05:09+00:00");
        assert_eq!(at(3600), "2025-11-23T13:05:09+01:00");
        assert_eq!(at(-12_600), "2025-11-23T08:35:09-03:30");
        assert_eq!(local_time(i64::MAX), None);
    }
}

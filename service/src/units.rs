//! Values as people write and read them, such as `0.5mm`, `10s` and `240Hz`, and times in this machine's time zone.

use std::time::Duration;

use jiff::{Timestamp, tz::TimeZone};
use mocapd_codec::Tolerance;

/// Splits a value into number and unit.
fn split(text: &str) -> Result<(f64, &str), String> {
    let text = text.trim();
    // The `e` of an exponent belongs to the number: the unit begins at the first letter that is not one.
    let at = text
        .char_indices()
        .find(|&(i, c)| {
            let digit_follows = text[i + c.len_utf8()..]
                .starts_with(|next: char| next.is_ascii_digit() || next == '-' || next == '+');
            !(c.is_ascii_digit() || "+-.".contains(c) || ((c == 'e' || c == 'E') && digit_follows))
        })
        .map_or(text.len(), |(i, _)| i);
    let (number, unit) = text.split_at(at);
    let value: f64 =
        number.parse().map_err(|_| format!("'{text}' does not begin with a number"))?;
    if !value.is_finite() {
        return Err(format!("'{text}' is not a finite number"));
    }
    Ok((value, unit.trim()))
}

/// Converts a value with one of `units`, each with its factor; `of` names the quantity and its units.
fn in_unit(text: &str, units: &[(&str, f64)], of: &str) -> Result<f64, String> {
    let (value, unit) = split(text)?;
    let known = units.iter().find(|(name, _)| *name == unit);
    known.map(|(_, factor)| value * factor).ok_or_else(|| format!("'{unit}' is not a unit of {of}"))
}

/// Parses `0.5mm`, `100um`, `2cm` or `0.001m`; a bare number is millimetres.
///
/// # Errors
/// What is wrong and what to write; for 0 that is `lossless`, the setting that keeps every bit.
pub fn tolerance(text: &str, lossless: &str) -> Result<Tolerance, String> {
    let units = [("mm", 1.0), ("", 1.0), ("um", 1e-3), ("µm", 1e-3), ("cm", 10.0), ("m", 1000.0)];
    let mm = in_unit(text, &units, "length: use um, mm, cm or m")?;
    if mm == 0.0 {
        return Err(format!("a tolerance of 0 keeps every bit: use {lossless}"));
    }
    if mm < 0.0 {
        return Err(format!(
            "a tolerance cannot be negative ({text}): give a distance such as 0.5mm"
        ));
    }
    Tolerance::from_mm(mm).map_err(|error| error.to_string())
}

/// Parses `500ms`, `10s`, `2min` or `1h`; a bare number is seconds.
///
/// # Errors
/// What is wrong and what to write.
pub fn duration(text: &str) -> Result<Duration, String> {
    let units = [("s", 1.0), ("", 1.0), ("ms", 1e-3), ("min", 60.0), ("m", 60.0), ("h", 3600.0)];
    let seconds = in_unit(text, &units, "time: use ms, s, min or h")?;
    // No take is longer than a year, which is far below the limits of Duration.
    if !(0.0..=3.2e7).contains(&seconds) {
        return Err(format!("'{text}' is not a usable duration: give something like 10s"));
    }
    Ok(Duration::from_secs_f64(seconds))
}

/// Units of bytes.
const SIZES: [(&str, f64); 12] = [
    ("B", 1.0),
    ("", 1.0),
    ("kB", 1e3),
    ("KB", 1e3),
    ("MB", 1e6),
    ("GB", 1e9),
    ("TB", 1e12),
    ("KiB", 1024.0),
    ("kiB", 1024.0),
    ("MiB", 1048576.0),
    ("GiB", 1073741824.0),
    ("TiB", 1099511627776.0),
];

/// Parses `256MiB`, `2GB` or `500kB`; a bare number is bytes.
///
/// # Errors
/// What is wrong and what to write.
pub fn size_bytes(text: &str) -> Result<u64, String> {
    let bytes = in_unit(text, &SIZES, "size: use B, kB, MB, GB, MiB or GiB")?;
    // No disk is larger, and f64 represents every whole number of bytes up to here.
    if !(0.0..=9e15).contains(&bytes) {
        return Err(format!("'{text}' is not a usable size: give something like 2GiB"));
    }
    Ok(bytes.round() as u64)
}

/// Units of rates and frequencies.
const RATES: [(&str, f64); 5] = [("Hz", 1.0), ("hz", 1.0), ("", 1.0), ("kHz", 1e3), ("khz", 1e3)];

/// Parses `240`, `240Hz` or `1kHz`; 1 to 10 000 Hz.
///
/// # Errors
/// What is wrong and what to write.
pub fn rate_hz(text: &str) -> Result<f64, String> {
    let hz = in_unit(text, &RATES, "rate: use Hz or kHz")?;
    if !(1.0..=10_000.0).contains(&hz) {
        return Err(format!("{hz} Hz is not a usable frame rate: use 1 to 10000"));
    }
    Ok(hz)
}

/// Parses `6`, `6Hz` or `0.5kHz`; more than 0 and at most 10 kHz.
///
/// # Errors
/// What is wrong and what to write.
pub fn frequency_hz(text: &str) -> Result<f64, String> {
    let hz = in_unit(text, &RATES, "frequency: use Hz or kHz")?;
    if hz > 0.0 && hz <= 10_000.0 {
        return Ok(hz);
    }
    Err(format!("'{text}' is not a usable frequency: give something like 6Hz"))
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
    Timestamp::from_millisecond(unix_ms).ok().map(|time| format_local(time, TimeZone::system()))
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
    fn units_are_understood() {
        for (text, mm) in
            [("0.5mm", 0.5), ("0.5", 0.5), ("100 um", 0.1), ("2cm", 20.0), ("1e-3m", 1.0)]
        {
            assert!((tolerance(text, "lossless").unwrap().mm() - mm).abs() < 1e-12, "{text}");
        }
        assert_eq!(duration("1.5s").unwrap(), Duration::from_millis(1500));
        assert_eq!(duration("2min").unwrap(), Duration::from_secs(120));
        assert!((rate_hz("1kHz").unwrap() - 1000.0).abs() < 1e-9);
        for (text, bytes) in [("0", 0), ("512", 512), ("1.5 MB", 1_500_000), ("2GiB", 2 << 30)] {
            assert_eq!(size_bytes(text), Ok(bytes));
        }
        for text in ["-1", "1 floppy", "nan", "1e20", ""] {
            assert!(size_bytes(text).is_err(), "{text}");
        }
    }

    #[test]
    fn invalid_values_are_explained() {
        assert!(tolerance("0mm", "--lossless").unwrap_err().contains("--lossless"));
        for text in ["-1mm", "nan", "inf", "1e999", "mm", "1 furlong", "1e-9mm", ""] {
            assert!(tolerance(text, "lossless").is_err(), "{text}");
        }
        for text in ["-1s", "1e9h", "soon"] {
            assert!(duration(text).is_err(), "{text}");
        }
        for text in ["0", "-60", "1e6", "60fps"] {
            assert!(rate_hz(text).is_err(), "{text}");
            assert!(frequency_hz(text).is_err(), "{text}");
        }
        assert_eq!(frequency_hz("0.5Hz"), Ok(0.5));
    }

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

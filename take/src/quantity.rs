//! Quantities with their units, as people write them: `0.5mm`, `10s`, `240Hz`, `2GiB`.

use std::time::Duration;

use mocapd_codec::Tolerance;

/// A quantity that is written as a number and a unit.
struct Quantity {
    name: &'static str,
    /// The spellings of its units, each with its factor; the empty spelling means a bare number.
    units: &'static [(&'static str, f64)],
    /// The units that a message lists.
    listed: &'static str,
    example: &'static str,
}

const LENGTH: Quantity = Quantity {
    name: "length",
    units: &[("mm", 1.0), ("", 1.0), ("um", 1e-3), ("µm", 1e-3), ("cm", 10.0), ("m", 1000.0)],
    listed: "um, mm, cm or m",
    example: "0.5mm",
};

const TIME: Quantity = Quantity {
    name: "time",
    units: &[("s", 1.0), ("", 1.0), ("ms", 1e-3), ("min", 60.0), ("m", 60.0), ("h", 3600.0)],
    listed: "ms, s, min or h",
    example: "10s",
};

const SIZE: Quantity = Quantity {
    name: "size",
    units: &[
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
    ],
    listed: "B, kB, MB, GB, MiB or GiB",
    example: "2GiB",
};

/// Units of rates and frequencies.
const HERTZ: &[(&str, f64)] = &[("Hz", 1.0), ("hz", 1.0), ("", 1.0), ("kHz", 1e3), ("khz", 1e3)];

const RATE: Quantity =
    Quantity { name: "rate", units: HERTZ, listed: "Hz or kHz", example: "240Hz" };

const FREQUENCY: Quantity =
    Quantity { name: "frequency", units: HERTZ, listed: "Hz or kHz", example: "6Hz" };

impl Quantity {
    /// Parses a finite number and a unit, and converts it to the unit with the factor 1.
    fn parse(&self, text: &str) -> Result<f64, String> {
        let text = text.trim();
        // The `e` of an exponent belongs to the number: the unit begins at the first letter that is not one.
        let at = text
            .char_indices()
            .find(|&(i, c)| {
                let digit_follows = text[i + c.len_utf8()..]
                    .starts_with(|next: char| next.is_ascii_digit() || next == '-' || next == '+');
                let is_exponent = (c == 'e' || c == 'E') && digit_follows;
                !(c.is_ascii_digit() || "+-.".contains(c) || is_exponent)
            })
            .map_or(text.len(), |(i, _)| i);
        let (number, unit) = text.split_at(at);
        let value: f64 = number.parse().map_err(|_| {
            format!("'{text}' does not begin with a number: give something like {}", self.example)
        })?;
        if !value.is_finite() {
            return Err(format!("'{text}' is not a finite number"));
        }
        let unit = unit.trim();
        let known = self.units.iter().find(|(name, _)| *name == unit);
        known
            .map(|(_, factor)| value * factor)
            .ok_or_else(|| format!("'{unit}' is not a unit of {}: use {}", self.name, self.listed))
    }
}

/// Parses a length of 0 or more: `0.5mm`, `100um`, `2cm` or `0.001m`; a bare number is in millimetres.
///
/// # Errors
/// What is wrong and what to write.
pub fn length_mm(text: &str) -> Result<f64, String> {
    let mm = LENGTH.parse(text)?;
    if mm >= 0.0 && mm.is_finite() {
        return Ok(mm);
    }
    Err(format!("'{text}' is not a usable length: give something like 0.5mm"))
}

/// Parses `0.5mm`, `100um`, `2cm` or `0.001m`; a bare number is in millimetres.
///
/// # Errors
/// What is wrong and what to write; for 0 that is `lossless`, the setting that keeps every bit.
pub fn tolerance(text: &str, lossless: &str) -> Result<Tolerance, String> {
    let mm = LENGTH.parse(text)?;
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
    let seconds = TIME.parse(text)?;
    // No take is longer than a year, which is far below the limits of Duration.
    if !(0.0..=3.2e7).contains(&seconds) {
        return Err(format!("'{text}' is not a usable duration: give something like 10s"));
    }
    Ok(Duration::from_secs_f64(seconds))
}

/// Parses a duration as [`duration`] does, but refuses 0.
///
/// # Errors
/// What is wrong and what to write.
pub fn duration_above_zero(text: &str) -> Result<Duration, String> {
    match duration(text)? {
        Duration::ZERO => Err(format!("'{text}' is zero: give a length of time such as 10s")),
        length => Ok(length),
    }
}

/// Parses `256MiB`, `2GB` or `500kB`; a bare number is bytes.
///
/// # Errors
/// What is wrong and what to write.
pub fn size_bytes(text: &str) -> Result<u64, String> {
    let bytes = SIZE.parse(text)?;
    // No disk is larger, and f64 represents every whole number of bytes up to here.
    if !(0.0..=9e15).contains(&bytes) {
        return Err(format!("'{text}' is not a usable size: give something like 2GiB"));
    }
    Ok(bytes.round() as u64)
}

/// Parses `240`, `240Hz` or `1kHz`; 1 to 10 000 Hz.
///
/// # Errors
/// What is wrong and what to write.
pub fn rate_hz(text: &str) -> Result<f64, String> {
    let hz = RATE.parse(text)?;
    if !(1.0..=10_000.0).contains(&hz) {
        return Err(format!("{hz} Hz is not a usable frame rate: use 1 to 10000 Hz"));
    }
    Ok(hz)
}

/// Parses `6`, `6Hz` or `0.5kHz`; more than 0 and at most 10 kHz.
///
/// # Errors
/// What is wrong and what to write.
pub fn frequency_hz(text: &str) -> Result<f64, String> {
    let hz = FREQUENCY.parse(text)?;
    if hz > 0.0 && hz <= 10_000.0 {
        return Ok(hz);
    }
    Err(format!("'{text}' is not a usable frequency: give something like 6Hz"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_understood() {
        for (text, mm) in
            [("0.5mm", 0.5), ("0.5", 0.5), ("100 um", 0.1), ("2cm", 20.0), ("1e-3m", 1.0)]
        {
            assert!((tolerance(text, "lossless").unwrap().mm() - mm).abs() < 1e-12, "{text}");
        }
        assert_eq!(length_mm("0"), Ok(0.0));
        assert_eq!(length_mm("50 um"), Ok(0.05));
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
        for text in ["0", "0s", "-0", "-1s", "1e-12s"] {
            assert!(duration_above_zero(text).is_err(), "{text}");
        }
        for text in ["-0.1mm", "1e308m", "thin"] {
            assert!(length_mm(text).is_err(), "{text}");
        }
        for text in ["0", "-60", "1e6", "60fps"] {
            assert!(rate_hz(text).is_err(), "{text}");
            assert!(frequency_hz(text).is_err(), "{text}");
        }
        assert_eq!(frequency_hz("0.5Hz"), Ok(0.5));
        let refused = |text| duration(text).unwrap_err();
        assert_eq!(refused("soon"), "'soon' does not begin with a number: give something like 10s");
        assert_eq!(refused("2 weeks"), "'weeks' is not a unit of time: use ms, s, min or h");
    }
}

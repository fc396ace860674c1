//! Values with units.

/// A length in millimetres: `0.05mm`, `50um`, `1cm`; a bare number is millimetres.
pub(super) fn length_mm(text: &str) -> Result<f64, String> {
    with_unit(text, &[("mm", 1.0), ("um", 1e-3), ("cm", 10.0), ("", 1.0)], "0.05mm")
}

/// A duration in seconds: `10s`, `500ms`, `2min`; a bare number is seconds.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let units = [("min", 60.0), ("ms", 1e-3), ("s", 1.0), ("", 1.0)];
    let value = with_unit(text, &units, "10s")?;
    if value > 0.0 { Ok(value) } else { Err("it must be more than 0".to_owned()) }
}

fn with_unit(text: &str, units: &[(&str, f64)], example: &str) -> Result<f64, String> {
    let said = || format!("'{text}' is no such value, write it like {example}");
    let (number, factor) = units
        .iter()
        .find_map(|(unit, factor)| text.strip_suffix(unit).map(|number| (number, factor)))
        .ok_or_else(said)?;
    let number: f64 = number.trim().parse().map_err(|_| said())?;
    if number.is_finite() && number >= 0.0 { Ok(number * factor) } else { Err(said()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_understood() {
        assert_eq!(length_mm("0.5mm"), Ok(0.5));
        assert_eq!(length_mm("50 um"), Ok(0.05));
        assert_eq!(length_mm("0"), Ok(0.0));
        assert_eq!(seconds("500ms"), Ok(0.5));
        assert_eq!(seconds("2min"), Ok(120.0));
        assert_eq!(seconds("10"), Ok(10.0));
        for bad in ["", "mm", "-1", "NaN", "1e999", "inf s", "5 parsec"] {
            assert!(length_mm(bad).is_err() && seconds(bad).is_err(), "{bad}");
        }
        assert!(seconds("0s").is_err());
    }
}

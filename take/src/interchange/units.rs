//! Units of length, and how a stored number becomes millimetres.

use std::cell::Cell;

use crate::motion::{GAP, Position};

/// Millimetres in one of the unit a source names: `mm`, `cm`, `m`, `in` and their spellings, in any case.
pub(super) fn millimetres_per(unit: &str) -> Option<f64> {
    let unit = unit.trim().to_ascii_lowercase();
    Some(match unit.as_str() {
        "mm" | "millimeter" | "millimetre" | "millimeters" | "millimetres" => 1.0,
        "cm" | "centimeter" | "centimetre" | "centimeters" | "centimetres" => 10.0,
        "m" | "meter" | "metre" | "meters" | "metres" => 1000.0,
        "in" | "inch" | "inches" | "\"" => 25.4,
        _ => return None,
    })
}

/// The factor to millimetres of a unit as written, and the warning when it is not known.
pub(super) fn factor_or_warn(unit: &str, warnings: &mut Vec<String>) -> f64 {
    if let Some(factor) = millimetres_per(unit) {
        return factor;
    }
    warnings.push(if unit.is_empty() {
        "No unit of length is stated; positions were read as millimetres.".to_owned()
    } else {
        format!("The unit of length `{unit}` is not known; positions were read as millimetres.")
    });
    1.0
}

/// From stored positions to millimetres: each coordinate is multiplied in f64 and rounded once to f32.
#[derive(Debug)]
pub(super) struct Millimetres {
    pub(super) factor: f64,
    not_finite: Cell<usize>,
}

impl Millimetres {
    pub(super) fn new(factor: f64) -> Self {
        Self { factor, not_finite: Cell::new(0) }
    }

    /// A coordinate that is not finite, before or after, makes the sample a gap, and is counted.
    pub(super) fn position(&self, stored: [f64; 3]) -> Position {
        let position = stored.map(|v| (v * self.factor) as f32);
        if position.iter().all(|v| v.is_finite()) {
            return position;
        }
        self.not_finite.set(self.not_finite.get() + 1);
        GAP
    }

    /// Says how many samples became gaps that way.
    pub(super) fn report(&self, warnings: &mut Vec<String>) {
        let n = self.not_finite.get();
        if n > 0 {
            warnings.push(format!("{n} samples are not finite; they are gaps."));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::is_gap;

    #[test]
    fn units_are_known_by_every_spelling() {
        for (unit, factor) in
            [("mm", 1.0), (" MM ", 1.0), ("cm", 10.0), ("Meters", 1000.0), ("in", 25.4)]
        {
            assert_eq!(millimetres_per(unit), Some(factor), "{unit}");
        }
        assert_eq!(millimetres_per("furlong"), None);
    }

    #[test]
    fn a_value_that_overflows_f32_is_a_gap() {
        let metres = Millimetres::new(1000.0);
        let mut warnings = Vec::new();
        assert_eq!(metres.position([0.1, -0.2, 0.3]), [100.0, -200.0, 300.0]);
        metres.report(&mut warnings);
        assert_eq!(warnings, [""; 0]);
        assert!(is_gap(metres.position([1e38, 0.0, 0.0])));
        metres.report(&mut warnings);
        assert_eq!(warnings, ["1 samples are not finite; they are gaps."]);
    }
}

//! The unit of a mesh: no format of this module carries one, so that it is read from comments, or inferred from the size.

use std::fmt;

use super::{Mesh, Note};

/// A unit of length that scans come in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// m.
    Metre,
    /// cm.
    Centimetre,
    /// mm.
    Millimetre,
    /// in: never inferred, since no size of a body tells it from centimetres.
    Inch,
}

/// Largest distance between two points of a body, in millimetres: from a child of 0.7 m that crouches to a man of 2.2 m
/// who stretches his arms up. The range spans less than a factor of ten, so that no size fits two units.
const EXTENT_MM: std::ops::RangeInclusive<f64> = 400.0..=3000.0;

impl Unit {
    const INFERRED: [Self; 3] = [Self::Metre, Self::Centimetre, Self::Millimetre];

    /// Millimetres in one of it.
    #[must_use]
    pub fn mm(self) -> f64 {
        match self {
            Self::Metre => 1000.0,
            Self::Centimetre => 10.0,
            Self::Millimetre => 1.0,
            Self::Inch => 25.4,
        }
    }

    /// From its sign or name, in any case: `mm`, `Millimeters`.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        match name.to_ascii_lowercase().as_str() {
            "m" | "meter" | "meters" | "metre" | "metres" => Some(Self::Metre),
            "cm" | "centimeter" | "centimeters" | "centimetre" | "centimetres" => {
                Some(Self::Centimetre)
            }
            "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => {
                Some(Self::Millimetre)
            }
            "in" | "inch" | "inches" => Some(Self::Inch),
            _ => None,
        }
    }

    /// From a comment such as `File units = meters` or `units: mm`; the last word is the unit, and nothing else counts.
    #[must_use]
    pub(crate) fn from_comment(comment: &[u8]) -> Option<Self> {
        let comment = std::str::from_utf8(comment.get(..80.min(comment.len()))?).ok()?;
        let (_, rest) = comment
            .to_ascii_lowercase()
            .split_once("unit")
            .map(|(a, b)| (a.len(), b.to_owned()))?;
        let rest = rest.strip_prefix('s').unwrap_or(&rest);
        Self::from_name(rest.trim_matches(|c: char| c.is_whitespace() || ":=.".contains(c)))
    }

    /// The unit in which the mesh has the size of a body, with that size in millimetres.
    ///
    /// # Errors
    /// [`UnitError`] where the size fits none.
    pub fn infer(mesh: &Mesh) -> Result<Self, UnitError> {
        let extent = mesh.extent();
        let fits = |unit: &Self| EXTENT_MM.contains(&(extent * unit.mm()));
        Self::INFERRED.into_iter().find(fits).ok_or(UnitError { extent })
    }

    /// Whether the mesh has the size of a body in this unit.
    #[must_use]
    pub fn fits(self, mesh: &Mesh) -> bool {
        EXTENT_MM.contains(&(mesh.extent() * self.mm()))
    }
}

/// Statures from a child of 1.2 m to a man of 2.2 m.
const STATURE_MM: std::ops::RangeInclusive<f64> = 1200.0..=2200.0;

/// What a reader should know of a unit that was inferred: a scan in inches has the size of a small child in centimetres.
/// `stature` is in the mesh's own unit.
pub(crate) fn ambiguity(inferred: Unit, stature: f64) -> Option<Note> {
    let [taken, inches] = [inferred, Unit::Inch].map(|unit| stature * unit.mm());
    if inferred != Unit::Centimetre || !STATURE_MM.contains(&inches) {
        return None;
    }
    let text = format!(
        "taken as cm the subject is some {:.0} cm tall, as inches {:.0} cm: state which it is, --unit cm or --unit in",
        taken / 10.0,
        inches / 10.0
    );
    Some(Note::new("unit-ambiguous", text))
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Metre => "m",
            Self::Centimetre => "cm",
            Self::Millimetre => "mm",
            Self::Inch => "in",
        })
    }
}

/// A mesh that is of no body's size.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "the mesh is {extent:.4} across, which is a body's size in neither m, cm nor mm: state its unit (--unit), or export it in one of these"
)]
pub struct UnitError {
    /// Largest extent, in the mesh's own unit.
    pub extent: f64,
}

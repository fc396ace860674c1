//! The unit of length of a mesh. None of the mesh formats stores one, so it is read from comments or inferred from the
//! size.

use std::fmt;

use super::{Mesh, Note};

/// A unit of length used in scans.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// Metre.
    Metre,
    /// Centimetre.
    Centimetre,
    /// Millimetre.
    Millimetre,
    /// Inch, never inferred: no body size distinguishes it from the centimetre.
    Inch,
}

/// Plausible extents of a body, in millimetres: from a crouching child of 0.7 m to a man of 2.2 m with raised arms. The
/// range spans less than a factor of ten, so no size fits two of the inferred units.
const EXTENT_MM: std::ops::RangeInclusive<f64> = 400.0..=3000.0;

impl Unit {
    const INFERRED: [Self; 3] = [Self::Metre, Self::Centimetre, Self::Millimetre];

    /// Millimetres per unit.
    #[must_use]
    pub fn mm(self) -> f64 {
        match self {
            Self::Metre => 1000.0,
            Self::Centimetre => 10.0,
            Self::Millimetre => 1.0,
            Self::Inch => 25.4,
        }
    }

    /// Parses a symbol or a name in any case, such as `mm` or `Millimeters`.
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

    /// Parses a comment such as `File units = meters` or `units: mm`. The unit must be the last word.
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

    /// The unit that gives the mesh the size of a body.
    ///
    /// # Errors
    /// [`UnitError`] if the size fits no unit.
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

/// Statures, from a child of 1.2 m to a man of 2.2 m.
const STATURE_MM: std::ops::RangeInclusive<f64> = 1200.0..=2200.0;

/// The note that asks for `--unit` when an inferred centimetre may be an inch: a scan in inches has the size of a small
/// child in centimetres. `stature` is in the mesh's unit.
pub(crate) fn ambiguity(inferred: Unit, stature: f64) -> Option<Note> {
    let [taken, inches] = [inferred, Unit::Inch].map(|unit| stature * unit.mm());
    if inferred != Unit::Centimetre || !STATURE_MM.contains(&inches) {
        return None;
    }
    let text = format!(
        "the subject is about {:.0} cm tall in centimetres, {:.0} cm in inches: choose with --unit cm or --unit in",
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

/// A mesh whose size fits no unit.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "the mesh is {extent:.4} units across, not the size of a body in m, cm or mm: give its unit with --unit, or export it in one of these"
)]
pub struct UnitError {
    /// Extent of the mesh, in its own unit.
    pub extent: f64,
}

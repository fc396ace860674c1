//! The vertical axis, the up direction, and rotations by quarter and half turns from one up axis to another.

use std::{fmt, str::FromStr};

use mocapd_codec::Position;

/// The vertical axis, if the source states it. The variants are in the order of their codes in HEADER.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UpAxis {
    /// The source does not state it.
    #[default]
    Unknown,
    /// +x
    X,
    /// +y
    Y,
    /// +z
    Z,
}

impl UpAxis {
    /// Parses `x`, `y` or `z`, in either case.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::X, Self::Y, Self::Z]
            .into_iter()
            .find(|axis| axis.name().is_some_and(|of_axis| of_axis.eq_ignore_ascii_case(name)))
    }

    /// `x`, `y` or `z`, if known.
    #[must_use]
    pub fn name(self) -> Option<&'static str> {
        ["x", "y", "z"].get(self.index()?).copied()
    }

    /// 0, 1 or 2, if known.
    #[must_use]
    pub fn index(self) -> Option<usize> {
        (self as usize).checked_sub(1)
    }

    /// The code in HEADER.
    #[must_use]
    pub fn code(self) -> u8 {
        self as u8
    }

    /// Decodes the code in HEADER; other values mean unknown.
    #[must_use]
    pub fn from_code(code: u8) -> Self {
        [Self::X, Self::Y, Self::Z].into_iter().find(|axis| axis.code() == code).unwrap_or_default()
    }
}

/// A signed axis: `x`, `-z`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Direction {
    axis: UpAxis,
    is_negative: bool,
}

impl Direction {
    /// The axis without its sign.
    #[must_use]
    pub fn axis(self) -> UpAxis {
        self.axis
    }

    /// Whether the direction is opposite to the axis.
    #[must_use]
    pub fn is_negative(self) -> bool {
        self.is_negative
    }
}

impl FromStr for Direction {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (is_negative, name) = match text.strip_prefix('-') {
            Some(name) => (true, name),
            None => (false, text.strip_prefix('+').unwrap_or(text)),
        };
        UpAxis::from_name(name)
            .map(|axis| Self { axis, is_negative })
            .ok_or_else(|| format!("'{text}' is not an axis: use x, y, z, -x, -y or -z"))
    }
}

impl fmt::Display for Direction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.is_negative { "-" } else { "" };
        write!(f, "{sign}{}", self.axis.name().unwrap_or("?"))
    }
}

/// A rotation by multiples of 90° about an axis. It permutes coordinates and flips signs, so it is exact in floating
/// point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Rotation {
    /// For each new coordinate the index of the old one.
    from: [usize; 3],
    /// Whether the coordinate changes its sign.
    negative: [bool; 3],
}

impl Rotation {
    pub(crate) const IDENTITY: Self = Self { from: [0, 1, 2], negative: [false; 3] };

    /// The quarter turn about the third axis that takes the axis `from` to the axis `to`; `None` if either is unknown.
    pub(crate) fn between(from: UpAxis, to: UpAxis) -> Option<Self> {
        let (old, new) = (from.index()?, to.index()?);
        if old == new {
            return Some(Self::IDENTITY);
        }
        let mut rotation = Self::IDENTITY;
        // The coordinate along `from` moves to `to`. The one along `to` moves to `from` with its sign flipped: that
        // keeps the determinant at 1 and so the axes right-handed.
        rotation.from[new] = old;
        rotation.from[old] = new;
        rotation.negative[old] = true;
        Some(rotation)
    }

    /// A half turn that reverses `axis`, about one of the other two.
    pub(crate) fn upside_down(axis: UpAxis) -> Self {
        let negative = match axis {
            UpAxis::Unknown => [false; 3],
            UpAxis::X => [true, false, true],
            UpAxis::Y | UpAxis::Z => [false, true, true],
        };
        Self { negative, ..Self::IDENTITY }
    }

    pub(crate) fn is_identity(&self) -> bool {
        *self == Self::IDENTITY
    }

    /// Rotates a vector of f64.
    pub(crate) fn apply_f64(&self, at: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| {
            let value = at[self.from[axis]];
            if self.negative[axis] { -value } else { value }
        })
    }

    /// Rotates a position or another vector.
    pub(crate) fn apply(&self, at: Position) -> Position {
        if self.is_identity() {
            return at;
        }
        std::array::from_fn(|axis| {
            let value = at[self.from[axis]];
            if self.negative[axis] { -value } else { value }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AXES: [UpAxis; 3] = [UpAxis::X, UpAxis::Y, UpAxis::Z];

    fn determinant(rotation: Rotation) -> f32 {
        let unit_vectors = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let [a, b, c] = unit_vectors.map(|e| rotation.apply(e));
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    }

    #[test]
    fn rotations_keep_up_up_and_axes_right_handed() {
        for from in AXES {
            let mut up = [0.0; 3];
            up[from.index().expect("known")] = 1.0;
            assert_eq!(
                Rotation::upside_down(from).apply(up),
                up.map(|v: f32| if v == 0.0 { v } else { -v })
            );
            assert!((determinant(Rotation::upside_down(from)) - 1.0).abs() < 1e-9);
            for to in AXES {
                let rotation = Rotation::between(from, to).expect("both known");
                let rotated = rotation.apply(up);
                assert_eq!(rotated[to.index().expect("known")].to_bits(), 1f32.to_bits());
                assert!((determinant(rotation) - 1.0).abs() < 1e-9, "{from:?} {to:?}");
            }
        }
        // The usual conversion from z up to y up.
        let rotation = Rotation::between(UpAxis::Z, UpAxis::Y).expect("both known");
        assert_eq!(rotation.apply([1.0, 2.0, 3.0]), [1.0, 3.0, -2.0]);
    }

    #[test]
    fn directions_parse_and_display() {
        for text in ["x", "-x", "y", "-y", "z", "-z"] {
            assert_eq!(text.parse::<Direction>().map(|d| d.to_string()), Ok(text.to_owned()));
        }
        assert_eq!("+Z".parse::<Direction>().map(|d| d.to_string()), Ok("z".to_owned()));
        assert!("up".parse::<Direction>().is_err());
    }
}

//! Which way is up, and turning what has another axis up.

use std::{fmt, str::FromStr};

use crate::motion::{Position, UpAxis};

/// A direction along an axis: `x`, `-z`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Direction {
    axis: UpAxis,
    is_negative: bool,
}

impl Direction {
    /// The axis, whichever way along it.
    #[must_use]
    pub fn axis(self) -> UpAxis {
        self.axis
    }

    /// Whether it is the way down the axis.
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
            .ok_or_else(|| format!("'{text}' is no axis: use x, y, z, -x, -y or -z"))
    }
}

impl fmt::Display for Direction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.is_negative { "-" } else { "" };
        write!(f, "{sign}{}", self.axis.name().unwrap_or("?"))
    }
}

/// A turn by quarters and halves: coordinates change places and signs, and no bit of their values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Turn {
    /// Where each new coordinate comes from.
    from: [usize; 3],
    /// Whether it changes its sign.
    negative: [bool; 3],
}

impl Turn {
    /// Everything stays.
    pub(crate) const NONE: Self = Self { from: [0, 1, 2], negative: [false; 3] };

    /// From one axis up to another, about the third one: a quarter turn. `None` where one of them is not known.
    pub(crate) fn between(from: UpAxis, to: UpAxis) -> Option<Self> {
        let (old, new) = (from.index()?, to.index()?);
        if old == new {
            return Some(Self::NONE);
        }
        let mut turn = Self::NONE;
        // What was up is up again; where it goes stands what was there, the other way, so that the third axis, about
        // which it turns, stays and right-handed axes remain right-handed.
        turn.from[new] = old;
        turn.from[old] = new;
        turn.negative[old] = true;
        Some(turn)
    }

    /// A half turn after which what was up is down.
    pub(crate) fn upside_down(axis: UpAxis) -> Self {
        let negative = match axis {
            UpAxis::Unknown => [false; 3],
            UpAxis::X => [true, false, true],
            UpAxis::Y | UpAxis::Z => [false, true, true],
        };
        Self { negative, ..Self::NONE }
    }

    /// Whether everything stays.
    pub(crate) fn is_none(&self) -> bool {
        *self == Self::NONE
    }

    /// Turns a position, or another vector in space.
    pub(crate) fn of(&self, at: Position) -> Position {
        if self.is_none() {
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

    fn determinant(turn: Turn) -> f32 {
        let [a, b, c] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|e| turn.of(e));
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    }

    #[test]
    fn turns_keep_up_up_and_axes_right_handed() {
        for from in AXES {
            let mut up = [0.0; 3];
            up[from.index().expect("known")] = 1.0;
            assert_eq!(
                Turn::upside_down(from).of(up),
                up.map(|v: f32| if v == 0.0 { v } else { -v })
            );
            assert!((determinant(Turn::upside_down(from)) - 1.0).abs() < 1e-9);
            for to in AXES {
                let turn = Turn::between(from, to).expect("both known");
                assert_eq!(turn.of(up)[to.index().expect("known")].to_bits(), 1f32.to_bits());
                assert!((determinant(turn) - 1.0).abs() < 1e-9, "{from:?} {to:?}");
            }
        }
        // As is usual from z up to y up.
        let turn = Turn::between(UpAxis::Z, UpAxis::Y).expect("both known");
        assert_eq!(turn.of([1.0, 2.0, 3.0]), [1.0, 3.0, -2.0]);
    }

    #[test]
    fn directions_are_read_and_written() {
        for text in ["x", "-x", "y", "-y", "z", "-z"] {
            assert_eq!(text.parse::<Direction>().map(|d| d.to_string()), Ok(text.to_owned()));
        }
        assert_eq!("+Z".parse::<Direction>().map(|d| d.to_string()), Ok("z".to_owned()));
        assert!("up".parse::<Direction>().is_err());
    }
}

//! The functions of distance that a map is made of.

/// φ(r), one of the families of (Yang et al. 2004, (11)). r and `d` are in the unit of the coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Basis {
    /// (d² + r²)^-t, with d and t above 0: an inverse multiquadric. Far from the nodes nothing but the polynomial is left.
    Inverse {
        /// How wide it is.
        d: f64,
        /// How fast it falls.
        t: f64,
    },
    /// (d² + r²)^(m-t), with d from 0, m 1 or 2, t between 0 and 1: a multiquadric.
    Power {
        /// How round its tip is: at 0 it is sharp.
        d: f64,
        /// 1 or 2: beyond that the linear polynomial does not make the map unique.
        m: u32,
        /// Taken off the exponent.
        t: f64,
    },
    /// (d² + r²)^(m-1) · ln(d² + r²), with d above 0, m 1 or 2: at 2 and a small d, a thin plate.
    Logarithm {
        /// How round its tip is.
        d: f64,
        /// 1 or 2.
        m: u32,
    },
}

impl Basis {
    /// The one that (Yang et al. 2004) uses: d = 1, m = 1, t = 1/2, the multiquadric √(1 + r²).
    pub const PAPER: Self = Self::Power { d: 1.0, m: 1, t: 0.5 };

    /// The same with d times `factor`: for coordinates in another unit.
    pub fn scaled(self, factor: f64) -> Self {
        match self {
            Self::Inverse { d, t } => Self::Inverse { d: d * factor, t },
            Self::Power { d, m, t } => Self::Power { d: d * factor, m, t },
            Self::Logarithm { d, m } => Self::Logarithm { d: d * factor, m },
        }
    }

    /// φ at a squared distance.
    pub fn at_squared(&self, r2: f64) -> f64 {
        match *self {
            Self::Inverse { d, t } => (d * d + r2).powf(-t),
            // By far the commonest, and a root is a tenth of a power's work.
            Self::Power { d, m: 1, t: 0.5 } => (d * d + r2).sqrt(),
            Self::Power { d, m, t } => (d * d + r2).powf(f64::from(m) - t),
            Self::Logarithm { d, m: 1 } => (d * d + r2).ln(),
            Self::Logarithm { d, m } => {
                let s = d * d + r2;
                s.powf(f64::from(m) - 1.0) * s.ln()
            }
        }
    }

    /// What is wrong with its parameters, if something is.
    pub(super) fn fault(&self) -> Option<&'static str> {
        let above = |x: f64| x.is_finite() && x > 0.0;
        match *self {
            Self::Inverse { d, t } if !(above(d) && above(t)) => {
                Some("d and t of an inverse basis are above 0")
            }
            Self::Power { d, .. } if !(d.is_finite() && d >= 0.0) => {
                Some("d of a power basis is 0 or more")
            }
            Self::Power { t, .. } if !(t > 0.0 && t < 1.0) => {
                Some("t of a power basis is between 0 and 1")
            }
            Self::Logarithm { d, .. } if !above(d) => Some("d of a logarithmic basis is above 0"),
            Self::Power { m, .. } | Self::Logarithm { m, .. } if !(1..=2).contains(&m) => {
                Some("m is 1 or 2: more needs polynomials of a higher degree")
            }
            _ => None,
        }
    }
}

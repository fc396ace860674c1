//! The vertical axis.

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

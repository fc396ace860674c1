//! The effort of an encoder of `dense`.

use std::{fmt, str::FromStr};

use super::LEVELS;
use crate::CodecError;

/// How much time the encoder of `dense` takes to make blocks smaller; other resamplers have one way to encode.
///
/// Time is relative to effort 1, and bytes are the change from it: geometric means over 20 recorded takes at six tolerances from 0.1
/// to 20 mm.
///
/// | effort | rows whose points are searched | plans at a time | time | bytes |
/// |---|---|---|---|---|
/// | 1 | none | | 1 | 0 |
/// | 2 | anchors | 1 | 3.3 | -2.1 % |
/// | 3 | and stride 32 | 1 | 3.7 | -3.9 % |
/// | 4 | and strides 16 and 8 | 1 | 5.7 | -6.7 % |
/// | 5 | and stride 4 | 1 | 8.1 | -7.6 % |
/// | 6 | as 4 | 4 | 12 | -7.9 % |
/// | 7 | as 5 | 4 | 22 | -8.7 % |
/// | 8 | and stride 2 | 4 | 41 | -9.2 % |
/// | 9 | as 8 | 12 | 106 | -9.6 % |
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Effort(u8);

/// How far plans look ahead.
#[derive(Debug, Clone, Copy)]
pub(super) struct SearchDepth {
    /// The shortest searched stride is `1 << least_bit`; anchors alone for [`LEVELS`].
    pub(super) least_bit: usize,
    /// Number of plans that are followed at the same time.
    pub(super) beam: usize,
}

impl Effort {
    /// The minimum effort: each row is chosen without looking ahead. Recordings always use it.
    pub const MIN: Self = Self(1);
    /// The maximum effort.
    pub const MAX: Self = Self(9);

    /// # Errors
    /// `InvalidArgument` unless the level is 1 to 9.
    pub fn new(level: u8) -> Result<Self, CodecError> {
        if (Self::MIN.0..=Self::MAX.0).contains(&level) {
            return Ok(Self(level));
        }
        Err(CodecError::InvalidArgument(format!("effort {level} is out of range: give 1 to 9")))
    }

    /// The level, 1 to 9.
    #[must_use]
    pub fn level(self) -> u8 {
        self.0
    }

    /// The depth of the search; `None` where nothing is searched.
    pub(super) fn depth(self) -> Option<SearchDepth> {
        let (least_bit, beam) = match self.0 {
            0..=1 => return None,
            2 => (LEVELS, 1),
            3 => (5, 1),
            4 => (3, 1),
            5 => (2, 1),
            6 => (3, 4),
            7 => (2, 4),
            8 => (1, 4),
            _ => (1, 12),
        };
        Some(SearchDepth { least_bit, beam })
    }
}

impl Default for Effort {
    /// The minimum effort.
    fn default() -> Self {
        Self::MIN
    }
}

impl fmt::Display for Effort {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl FromStr for Effort {
    type Err = CodecError;

    fn from_str(text: &str) -> Result<Self, CodecError> {
        let level = text.parse().map_err(|_| {
            CodecError::InvalidArgument(format!(
                "'{text}' is not an effort: give a number from 1 to 9"
            ))
        })?;
        Self::new(level)
    }
}

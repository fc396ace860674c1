//! Why a photograph cannot be used, and what to do.

use super::read::{BYTES_MAX, PIXELS_MAX, SIDE_MIN_PX};

/// A photograph that cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PhotoError {
    /// Nothing in it.
    #[error("the photograph is empty: expected the bytes of a PNG, JPEG or PNM file")]
    Empty,
    /// More bytes than are read.
    #[error("the photograph has {bytes} bytes, and at most {BYTES_MAX} are read: save it as JPEG")]
    Bytes {
        /// How many it has.
        bytes: usize,
    },
    /// Another format, or none.
    #[error("not a PNG, JPEG or PNM picture ({found}): save it as PNG or JPEG")]
    Format {
        /// What its first bytes say.
        found: String,
    },
    /// Cut off.
    #[error("the photograph ends too early ({what}): copy it again, it was cut off")]
    Truncated {
        /// What is missing.
        what: String,
    },
    /// Right format, wrong content.
    #[error("the photograph cannot be decoded ({reason}): open it in a viewer and save it again")]
    Damaged {
        /// The decoder's words.
        reason: String,
    },
    /// Too few pixels for a face.
    #[error(
        "the photograph is {width} x {height} pixels, and a face needs a side of {SIDE_MIN_PX} at least: use a larger one"
    )]
    Small {
        /// Pixels.
        width: u64,
        /// Pixels.
        height: u64,
    },
    /// More pixels than are decoded.
    #[error(
        "the photograph is {width} x {height} pixels, and at most {PIXELS_MAX} pixels are decoded: scale it down, 1000 across a face are plenty"
    )]
    Large {
        /// Pixels.
        width: u64,
        /// Pixels.
        height: u64,
    },
    /// Pixels that do not make the picture.
    #[error(
        "{width} x {height} pixels were promised, and {found} given: give row after row, whole"
    )]
    Pixels {
        /// Pixels.
        width: usize,
        /// Pixels.
        height: usize,
        /// How many there were.
        found: usize,
    },
}

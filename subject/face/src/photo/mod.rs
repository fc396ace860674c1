//! A photograph: decoded within limits, with what a face detector needs to know about its colours.

mod read;
#[cfg(test)]
mod tests;

use std::fmt;

pub use read::{BYTES_MAX, PIXELS_MAX, SIDE_MIN_PX};

use crate::plane::Plane;

/// Standard deviation of chroma, after removing its regression on luma, below which there is no colour. Chroma
/// subsampling of a grey JPEG leaves about 0.5; sepia follows luma; the dullest photograph of a face has above 4.
const CHROMA_DEVIATION_MIN: f64 = 1.5;
/// Distance of the illuminant's r, g chromaticities from white (1/3, 1/3) that counts as a colour cast: a lamp of 2856
/// K at daylight white balance has about 0.1, skin that fills the picture 0.05.
const CAST_MIN: f64 = 0.08;
/// Norm of the illuminant's estimate (shades of grey, Finlayson and Trezzi 2004).
const NORM: i32 = 6;
/// Maximum number of pixels that are sampled, evenly.
const SAMPLES_MAX: usize = 1 << 16;

/// A photograph, upright, 8 bits per channel. Coordinates start at 0, x to the right, y down; integers are the centres
/// of pixels.
#[derive(Clone, PartialEq)]
pub struct Photo {
    width: usize,
    height: usize,
    /// Row by row; `width * height` of them.
    pixels: Vec<[u8; 3]>,
    /// SHA-256 of the file; zeros for a photograph made from pixels.
    pub sha256: [u8; 32],
    /// Usefulness of its colours.
    pub colour: Colour,
    /// What was done to it, and what is unusual about it.
    pub notes: Vec<Note>,
}

/// A remark for the photographer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Note {
    /// Rotated or mirrored by its EXIF orientation.
    Turned,
    /// Reduced from 16 bits or more per channel to 8.
    Reduced,
    /// Transparent in places, which are grey now.
    Transparent,
    /// CMYK, converted without its colour profile.
    Cmyk,
    /// Animated; its first picture is used.
    Animated,
    /// Without colours ([`Colour::Grey`]).
    Grey,
    /// Lit with a colour cast ([`Colour::Cast`]).
    Cast,
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Turned => "rotated by its EXIF orientation",
            Self::Reduced => "reduced from more than 8 bits per channel to 8",
            Self::Transparent => "transparent in places, which are treated as grey",
            Self::Cmyk => "CMYK, converted without its profile: colours are rough, RGB is better",
            Self::Animated => "animated: only its first picture is used",
            Self::Grey => "without colours: faces are found by shape alone, lips are less certain",
            Self::Cast => "colour cast: set the white balance, or skin is less certain",
        })
    }
}

impl fmt::Debug for Photo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Photo")
            .field("width", &self.width)
            .field("height", &self.height)
            .field("colour", &self.colour)
            .field("notes", &self.notes)
            .finish_non_exhaustive()
    }
}

impl Photo {
    /// A photograph of `width` by `height` pixels, row by row from the top left.
    ///
    /// # Errors
    /// [`PhotoError::Pixels`] unless there are `width * height` pixels; [`PhotoError::Small`] and [`PhotoError::Large`]
    /// as for a file.
    pub fn from_pixels(
        width: usize,
        height: usize,
        pixels: Vec<[u8; 3]>,
    ) -> Result<Self, PhotoError> {
        read::check_size(width as u64, height as u64)?;
        if width.checked_mul(height) != Some(pixels.len()) {
            return Err(PhotoError::Pixels { width, height, found: pixels.len() });
        }
        let colour = Colour::of(&pixels);
        let mut notes = Vec::new();
        match colour {
            Colour::Natural => {}
            Colour::Cast => notes.push(Note::Cast),
            Colour::Grey => notes.push(Note::Grey),
        }
        Ok(Self { width, height, pixels, sha256: [0; 32], colour, notes })
    }

    /// In pixels.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// In pixels.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// Red, green, blue, row by row.
    #[must_use]
    pub fn pixels(&self) -> &[[u8; 3]] {
        &self.pixels
    }

    /// The colour at `x`, `y`; the border repeats outside.
    #[must_use]
    pub fn rgb(&self, x: isize, y: isize) -> [u8; 3] {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.pixels.get(y * self.width + x).copied().unwrap_or_default()
    }

    /// A plane computed from each pixel's colour.
    #[must_use]
    pub fn plane(&self, value: impl Fn([u8; 3]) -> f32) -> Plane {
        let values = self.pixels.iter().map(|&rgb| value(rgb)).collect();
        Plane::from_values(self.width, self.height, values)
    }

    /// Luma of ITU-R BT.601, 0 to 255.
    #[must_use]
    pub fn grey(&self) -> Plane {
        self.plane(luma)
    }
}

/// Luma of ITU-R BT.601, 0 to 255.
#[must_use]
pub fn luma([red, green, blue]: [u8; 3]) -> f32 {
    0.299 * f32::from(red) + 0.587 * f32::from(green) + 0.114 * f32::from(blue)
}

/// Usefulness of a photograph's colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colour {
    /// Colours in nearly white light.
    Natural,
    /// Colours under a colour cast: skin may have any hue.
    Cast,
    /// No colours, or shades of a single one (sepia).
    Grey,
}

impl Colour {
    /// Classifies a picture's pixels.
    fn of(pixels: &[[u8; 3]]) -> Self {
        let step = pixels.len().div_ceil(SAMPLES_MAX).max(1);
        let samples = || pixels.iter().step_by(step).map(|pixel| pixel.map(f64::from));
        if chroma_deviation(samples()) < CHROMA_DEVIATION_MIN {
            return Self::Grey;
        }
        let light = illuminant(samples());
        let sum: f64 = light.iter().sum();
        let [red, green, _] = light.map(|channel| channel / sum.max(1e-9) - 1.0 / 3.0);
        if red.hypot(green) > CAST_MIN { Self::Cast } else { Self::Natural }
    }
}

/// Colour of the illuminant, each channel 0 to 255: the 6-norm of the pixels that are neither black nor saturated.
fn illuminant(samples: impl Iterator<Item = [f64; 3]>) -> [f64; 3] {
    let mut sums = [0.0; 3];
    let mut count = 0.0;
    for sample in samples.filter(|sample| sample.iter().all(|&channel| channel < 250.0)) {
        count += 1.0;
        for (sum, channel) in sums.iter_mut().zip(sample) {
            *sum += (channel / 255.0).powi(NORM);
        }
    }
    if count == 0.0 {
        return [255.0; 3];
    }
    sums.map(|sum| 255.0 * (sum / count).powf(1.0 / f64::from(NORM)))
}

/// Root mean square of Cb and Cr after removing their regressions on luma.
fn chroma_deviation(samples: impl Iterator<Item = [f64; 3]>) -> f64 {
    // Sums of 1, y, y^2, and for each chroma c: c, c y, c^2.
    let (mut n, mut y1, mut y2) = (0.0, 0.0, 0.0);
    let mut chroma = [[0.0; 3]; 2];
    for [red, green, blue] in samples {
        let y = 0.299 * red + 0.587 * green + 0.114 * blue;
        n += 1.0;
        y1 += y;
        y2 += y * y;
        for (sums, c) in chroma.iter_mut().zip([0.564 * (blue - y), 0.713 * (red - y)]) {
            sums[0] += c;
            sums[1] += c * y;
            sums[2] += c * c;
        }
    }
    if n == 0.0 {
        return 0.0;
    }
    let variance_y = y2 / n - (y1 / n).powi(2);
    let residual = chroma.iter().map(|[c1, cy, c2]| {
        let covariance = cy / n - c1 * y1 / (n * n);
        let explained = if variance_y > 1e-9 { covariance.powi(2) / variance_y } else { 0.0 };
        (c2 / n - (c1 / n).powi(2) - explained).max(0.0)
    });
    residual.sum::<f64>().sqrt()
}

/// Why a photograph cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PhotoError {
    /// The file is empty.
    #[error("the photograph is empty: expected the bytes of a PNG, JPEG or PNM file")]
    Empty,
    /// The file is too large.
    #[error("the photograph has {bytes} bytes, the limit is {BYTES_MAX}: save it as JPEG")]
    Bytes {
        /// Its size in bytes.
        bytes: usize,
    },
    /// Not a supported format.
    #[error("not a PNG, JPEG or PNM picture ({found}): save it as PNG or JPEG")]
    Format {
        /// What its first bytes suggest.
        found: String,
    },
    /// The file is cut off.
    #[error("the photograph is cut off ({what}): copy it again")]
    Truncated {
        /// What is missing.
        what: String,
    },
    /// The content does not decode.
    #[error("the photograph cannot be decoded ({reason}): open it in a viewer and save it again")]
    Damaged {
        /// The decoder's message.
        reason: String,
    },
    /// Too small for a face.
    #[error(
        "the photograph is {width} x {height} pixels, a face needs at least {SIDE_MIN_PX} each way: use a larger one"
    )]
    Small {
        /// Pixels.
        width: u64,
        /// Pixels.
        height: u64,
    },
    /// Too large to decode.
    #[error(
        "the photograph is {width} x {height} pixels, the limit is {PIXELS_MAX}: scale it down, 1000 pixels across a face are plenty"
    )]
    Large {
        /// Pixels.
        width: u64,
        /// Pixels.
        height: u64,
    },
    /// The number of pixels does not match the size.
    #[error("expected {width} x {height} pixels, found {found}: pass complete rows")]
    Pixels {
        /// Pixels.
        width: usize,
        /// Pixels.
        height: usize,
        /// Number of pixels given.
        found: usize,
    },
}

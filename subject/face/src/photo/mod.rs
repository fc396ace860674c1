//! A photograph: foreign bytes into colours, bounded, and with what a finder of faces must know about them.

mod read;
#[cfg(test)]
mod tests;

use std::fmt;

pub use read::{BYTES_MAX, PIXELS_MAX, SIDE_MIN_PX};

use crate::plane::Plane;

/// Standard deviation of chroma, once what follows from luma is taken off, below which there is no colour. Chroma
/// subsampling of a grey JPEG leaves about 0.5; sepia follows luma; the dullest photograph of a face has above 4.
const CHROMA_DEVIATION_MIN: f64 = 1.5;
/// Distance of the light's r, g chromaticities from white's, (1/3, 1/3), that is a cast: a lamp of 2856 K, taken with
/// daylight's white balance, is about 0.1 away; skin that fills the picture 0.05.
const CAST_MIN: f64 = 0.08;
/// Norm of the illuminant's estimate (Finlayson and Trezzi 2004, shades of grey).
const NORM: i32 = 6;
/// Pixels that are looked at; evenly taken.
const SAMPLES_MAX: usize = 1 << 16;

/// A photograph, upright, 8 bits a channel. Coordinates are 0-based, x to the right, y down, and whole numbers are the
/// centres of pixels.
#[derive(Clone, PartialEq)]
pub struct Photo {
    width: usize,
    height: usize,
    /// Row by row; `width * height` of them.
    pixels: Vec<[u8; 3]>,
    /// SHA-256 of the bytes that it was read from; zeros where it was made of pixels.
    pub sha256: [u8; 32],
    /// What its colours are good for.
    pub colour: Colour,
    /// What was done to it, and what is odd about it.
    pub notes: Vec<Note>,
}

/// Something that whoever took the photograph may want to know.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Note {
    /// It was turned or mirrored as its EXIF orientation says.
    Turned,
    /// It had 16 bits or more a channel, and is used with 8.
    Reduced,
    /// It was transparent in places, which are grey now.
    Transparent,
    /// It was CMYK, and was converted without its colour profile.
    Cmyk,
    /// It was animated, and its first picture is used.
    Animated,
    /// It has no colours ([`Colour::Grey`]).
    Grey,
    /// Its light is coloured ([`Colour::Cast`]).
    Cast,
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Turned => "turned as its EXIF orientation says",
            Self::Reduced => "reduced from more than 8 bits a channel to 8",
            Self::Transparent => "transparent in places, which are taken as grey",
            Self::Cmyk => "CMYK, converted without its profile: colours are rough, RGB is better",
            Self::Animated => "animated: only its first picture is used",
            Self::Grey => "without colours: faces are found by shape alone, and lips are less sure",
            Self::Cast => "lit in one colour: white balance is worth setting, skin is less sure",
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
    /// [`PhotoError::Pixels`] if `pixels` are not `width * height`, [`PhotoError::Small`] and [`PhotoError::Large`] as for
    /// one that is read.
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

    /// The colour nearest to `x`, `y`; at the border where that is outside.
    #[must_use]
    pub fn rgb(&self, x: isize, y: isize) -> [u8; 3] {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.pixels.get(y * self.width + x).copied().unwrap_or_default()
    }

    /// What `value` makes of each colour.
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

/// What the colours of a photograph are good for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colour {
    /// Colours, in light that is near enough to white.
    Natural,
    /// Colours, in light that is not: skin may have any hue.
    Cast,
    /// No colours, or shades of a single one (sepia).
    Grey,
}

impl Colour {
    /// Of a picture's pixels.
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

/// The light's colour, each channel 0 to 255: the 6-norm of what is neither black nor burnt out.
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

/// Root of the mean square of Cb and Cr once their regressions on luma are taken off.
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

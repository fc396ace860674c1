//! A photograph: decoded within limits, with what a face detector needs to know about its colours.

#[cfg(test)]
mod tests;

use std::{fmt, io::Cursor};

use image::{
    ColorType, DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits,
    codecs::png::PngDecoder, metadata::Orientation,
};
use sha2::{Digest, Sha256};

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
        check_size(width as u64, height as u64)?;
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

/// Largest file: a JPEG of 40 megapixels at its best quality has about half of that.
pub const BYTES_MAX: usize = 64 << 20;
/// Maximum number of pixels: 120 MB as 8-bit RGB, 320 MB as 16-bit RGBA, which takes most.
pub const PIXELS_MAX: u64 = 40_000_000;
/// Minimum length of the shorter side.
pub const SIDE_MIN_PX: u64 = 32;
/// Memory limit of the decoder: the largest picture, and as much again for coefficients of progressive JPEG.
const DECODER_BYTES_MAX: u64 = 8 * PIXELS_MAX * 2;
/// Largest expansion in decoding. PNG at one bit per pixel and deflate's 1032:1 gives 8256:1; progressive JPEG has at
/// least one bit for 64 pixels of three channels, 1536:1.
const GROWTH_MAX: u64 = 8256;
/// Largest expansion of PNM, whose tightest form turns one bit per pixel into a byte.
const PNM_GROWTH_MAX: u64 = 8;

impl Photo {
    /// Reads a PNG, JPEG or PNM file.
    ///
    /// The result is upright by the EXIF orientation. 16 bits become 8, transparency becomes grey, grey becomes three
    /// equal channels, CMYK becomes RGB without a profile, and an animation is reduced to its first picture;
    /// [`Photo::notes`] lists what was done.
    ///
    /// # Errors
    /// [`PhotoError`] if the bytes are not a supported picture, are cut off, or exceed [`BYTES_MAX`],
    /// [`PIXELS_MAX`] or [`SIDE_MIN_PX`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, PhotoError> {
        if bytes.is_empty() {
            return Err(PhotoError::Empty);
        }
        if bytes.len() > BYTES_MAX {
            return Err(PhotoError::Bytes { bytes: bytes.len() });
        }
        let mut notes = Vec::new();
        let picture = decode(bytes, &mut notes)?;
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        let transparent = picture.color().has_alpha();
        let pixels = if transparent {
            let rgba = picture.into_rgba8();
            if rgba.pixels().any(|pixel| pixel.0[3] < u8::MAX) {
                notes.push(Note::Transparent);
            }
            rgba.pixels().map(|pixel| over_grey(pixel.0)).collect()
        } else {
            picture.into_rgb8().pixels().map(|pixel| pixel.0).collect()
        };
        let mut photo = Self::from_pixels(width, height, pixels)?;
        notes.append(&mut photo.notes);
        photo.notes = notes;
        photo.sha256 = Sha256::digest(bytes).into();
        Ok(photo)
    }
}

fn decode(bytes: &[u8], notes: &mut Vec<Note>) -> Result<DynamicImage, PhotoError> {
    let format = image::guess_format(bytes).map_err(|_| unknown(bytes))?;
    let growth = match format {
        ImageFormat::Jpeg => {
            let jpeg = Jpeg::of(bytes);
            if !jpeg.whole {
                return Err(PhotoError::Truncated { what: "no end-of-image marker".into() });
            }
            if jpeg.components == 4 {
                notes.push(Note::Cmyk);
            }
            GROWTH_MAX
        }
        ImageFormat::Png => {
            if PngDecoder::new(Cursor::new(bytes)).and_then(|png| png.is_apng()).unwrap_or(false) {
                notes.push(Note::Animated);
            }
            GROWTH_MAX
        }
        ImageFormat::Pnm => PNM_GROWTH_MAX,
        other => return Err(PhotoError::Format { found: format!("{other:?}") }),
    };
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    // The size is checked below with a message that says what to do; these limits bound what a decoder allocates before
    // and after.
    let mut limits = Limits::default();
    limits.max_alloc = Some(DECODER_BYTES_MAX);
    reader.limits(limits);
    let mut decoder = reader.into_decoder().map_err(|error| refused(&error))?;
    let (width, height) = decoder.dimensions();
    check_size(u64::from(width), u64::from(height))?;
    if decoder.total_bytes() > (bytes.len() as u64).saturating_mul(growth) {
        let what = format!("{} bytes cannot hold {width} x {height} pixels", bytes.len());
        return Err(PhotoError::Truncated { what });
    }
    // Damaged EXIF is no reason to reject a picture.
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    let mut picture = DynamicImage::from_decoder(decoder).map_err(|error| refused(&error))?;
    let colour = picture.color();
    if !matches!(colour, ColorType::L8 | ColorType::La8 | ColorType::Rgb8 | ColorType::Rgba8) {
        notes.push(Note::Reduced);
    }
    if orientation != Orientation::NoTransforms {
        notes.push(Note::Turned);
        picture.apply_orientation(orientation);
    }
    Ok(picture)
}

/// Rejects sizes out of range before anything is allocated.
fn check_size(width: u64, height: u64) -> Result<(), PhotoError> {
    if width.min(height) < SIDE_MIN_PX {
        return Err(PhotoError::Small { width, height });
    }
    if width.saturating_mul(height) > PIXELS_MAX {
        return Err(PhotoError::Large { width, height });
    }
    Ok(())
}

/// Blends over mid-grey, which is neither skin nor as dark as an iris.
fn over_grey([red, green, blue, alpha]: [u8; 4]) -> [u8; 3] {
    let alpha = u16::from(alpha);
    [red, green, blue]
        .map(|channel| ((u16::from(channel) * alpha + 128 * (255 - alpha) + 127) / 255) as u8)
}

fn unknown(bytes: &[u8]) -> PhotoError {
    let start: Vec<String> = bytes.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    PhotoError::Format { found: format!("it begins with {}", start.join(" ")) }
}

fn refused(error: &ImageError) -> PhotoError {
    let reason = error.to_string();
    let cut =
        ["unexpected end", "unexpected eof", "eof", "failed to fill whole buffer", "truncated"];
    let lower = reason.to_lowercase();
    match error {
        ImageError::Limits(_) => PhotoError::Damaged {
            reason: format!("its decoder needs more than {DECODER_BYTES_MAX} bytes of memory"),
        },
        _ if cut.iter().any(|word| lower.contains(word)) => PhotoError::Truncated { what: reason },
        _ => PhotoError::Damaged { reason },
    }
}

/// What the markers of a JPEG file say.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Jpeg {
    /// Components of its frame: 1 is grey, 3 colour, 4 CMYK or YCCK.
    components: u8,
    /// Whether there is an end-of-image marker. Decoders fill missing rows with grey, and a face may be half in them.
    whole: bool,
}

impl Jpeg {
    /// Walks the markers (ITU-T T.81, B.1.1): segments by their length, entropy-coded data up to the next marker that
    /// is neither stuffing nor a restart.
    fn of(bytes: &[u8]) -> Self {
        let mut jpeg = Self::default();
        let mut at = 2;
        while let Some(&byte) = bytes.get(at) {
            let marker = bytes.get(at + 1).copied();
            at += 1;
            let (0xff, Some(marker)) = (byte, marker) else { continue };
            match marker {
                // Stuffing, fill bytes, TEM, restarts and SOI have no length.
                0x00 | 0xff | 0x01 | 0xd0..=0xd8 => {}
                0xd9 => {
                    jpeg.whole = true;
                    return jpeg;
                }
                _ => {
                    let (Some(&high), Some(&low)) = (bytes.get(at + 1), bytes.get(at + 2)) else {
                        return jpeg;
                    };
                    // Frames are SOF0 to SOF15 without DHT, JPG and DAC.
                    if matches!(marker, 0xc0..=0xcf) && !matches!(marker, 0xc4 | 0xc8 | 0xcc) {
                        jpeg.components = bytes.get(at + 8).copied().unwrap_or_default();
                    }
                    at += 1 + usize::from(u16::from_be_bytes([high, low])).max(2);
                }
            }
        }
        jpeg
    }
}

//! Decoding of image files within limits.

use std::io::Cursor;

use image::codecs::png::PngDecoder;
use image::metadata::Orientation;
use image::{ColorType, DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};
use sha2::{Digest, Sha256};

use super::{Note, Photo, PhotoError};

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
pub(super) fn check_size(width: u64, height: u64) -> Result<(), PhotoError> {
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
pub(super) struct Jpeg {
    /// Components of its frame: 1 is grey, 3 colour, 4 CMYK or YCCK.
    pub(super) components: u8,
    /// Whether there is an end-of-image marker. Decoders fill missing rows with grey, and a face may be half in them.
    pub(super) whole: bool,
}

impl Jpeg {
    /// Walks the markers (ITU-T T.81, B.1.1): segments by their length, entropy-coded data up to the next marker that
    /// is neither stuffing nor a restart.
    pub(super) fn of(bytes: &[u8]) -> Self {
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

//! A photograph: foreign bytes into colours, bounded, and with what a finder of faces must know about them.

mod colour;
mod container;
mod error;
mod read;
#[cfg(test)]
mod tests;

use std::fmt;

pub use colour::Colour;
pub use error::PhotoError;
pub use read::{BYTES_MAX, PIXELS_MAX, SIDE_MIN_PX};

use super::plane::Plane;

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

//! Where the landmarks lie at first sight: linear regressions, one after the other, from how the crop looks to the face
//! (Xiong and De la Torre 2013). The first looks at the whole crop, each other one at what lies around the landmarks of the
//! one before it.
//!
//! What is said of all landmarks is a sum of a few ways in which faces differ in a crop: turned, nodding, wide, with an open
//! mouth, beside the middle. `benches/subject/face_glance.py` learns them, and how a look tells them, from random heads.

mod cells;
mod patches;
mod stage;
#[cfg(test)]
mod tests;

pub use cells::CELLS_LOOK;
pub use patches::PATCHES_LOOK;
use stage::Stage;

use super::Rough;
use super::crop::Crop;
use super::search::Point;
use crate::{Photo, Plane};

/// Landmarks that are told, by their numbers in iBUG-68: all that the generic face has.
pub const TOLD: [usize; 60] = [
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25,
    26, 27, 30, 31, 32, 33, 34, 35, 36, 37, 38, 39, 40, 41, 42, 43, 44, 45, 46, 47, 48, 49, 50, 51,
    52, 53, 54, 55, 56, 57, 58, 59, 62, 66,
];

/// The landmarks of [`TOLD`] in the crop (pixels).
pub type Told = [Point; TOLD.len()];

/// What a glance is at: a face's crop, and how it looks.
#[derive(Debug, Clone)]
pub struct Glance {
    crop: Crop,
    roots: Plane,
}

impl Glance {
    /// At the face that `rough` points at.
    #[must_use]
    pub fn at(photo: &Photo, rough: &Rough) -> Glance {
        let crop = Crop::cut(photo, rough);
        // Roots: noise in the dark is no slope, nor is that of light. Half as wide and as high.
        let luma = crop.plane(|[r, g, b]| 0.299 * r + 0.587 * g + 0.114 * b);
        let roots = luma.halved().map(|v| v.max(0.0).sqrt());
        Glance { crop, roots }
    }

    /// A point of the photograph in the crop (pixels).
    #[must_use]
    pub fn in_crop(&self, p: [f64; 2]) -> [f64; 2] {
        self.crop.in_crop(p)
    }

    /// A point of the crop in the photograph (pixels).
    #[must_use]
    pub fn to_photo(&self, p: [f64; 2]) -> [f64; 2] {
        self.crop.to_photo(p)
    }

    /// What the first regression looks at: [`CELLS_LOOK`] bytes.
    #[must_use]
    pub fn cells(&self) -> Vec<u8> {
        cells::look(&self.roots)
    }

    /// What each other one does: [`PATCHES_LOOK`] bytes.
    #[must_use]
    pub fn patches(&self, told: &Told) -> Vec<u8> {
        patches::look(&self.roots, told)
    }

    pub(super) fn crop(&self) -> &Crop {
        &self.crop
    }

    /// The landmarks, as they look to lie.
    #[must_use]
    pub fn told(&self) -> Told {
        let mut told = Stage::first().told(&self.cells());
        for stage in Stage::others() {
            let moves = stage.told(&self.patches(&told));
            for (point, by) in told.iter_mut().zip(moves) {
                *point = [point[0] + by[0], point[1] + by[1]];
            }
        }
        told
    }
}

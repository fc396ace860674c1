//! Faces as (Yang et al. 2004) find them: blocks of skin, holes in them, and a template. Kept beside
//! [`find`](super::find) so that both can be measured on the same photographs.
//!
//! What the paper leaves open is chosen here: the thresholds, the structuring element, T0, the template's drawing and
//! `T_E`. Two things it does not have are added: a block is cut where the neck begins (at 1.45 of its width), and axes are
//! averaged as axes.

mod block;
mod skin;
mod template;
#[cfg(test)]
mod tests;

use super::Photo;
use super::find::Found;
use super::plane::Mask;
use block::{Block, blocks, direction_rad};
use template::{EYE_LEFT, EYE_RIGHT, MOUTH, NOSE, Zone, energy};

/// Skin is what is likelier than this, in shares of the likeliest colour: the Gaussian's ellipse of 1.55 deviations. At
/// 0.1 faces run into walls on the development photographs, and at 0.5 they fall apart.
const SKIN_MIN: f32 = 0.3;
/// The longer side that the search works on, in pixels.
const SIDE_PX: f32 = 320.0;
/// Half the side of the square of erosion and dilation, less a half, on it.
const OPENING_PX: usize = 1;
/// A face's rectangle is at most this much higher than it is wide; what is lower is neck.
const HEIGHT_MAX: f32 = 1.45;
/// And at least this much: what is wider is no face.
const HEIGHT_MIN: f32 = 0.9;
/// The paper's `T_E`: those faces of the development photographs that are blocks at all have more.
const ENERGY_MIN: f32 = -0.1;
/// What the energy's distance to the threshold is measured in, for a score of 0 to 1.
const ENERGY_SOFT: f32 = 0.2;
/// Distances of the outer eye corners, and of the irises' middles, in widths of the rectangle.
const IO_OF_WIDTH: f64 = 0.64;

/// A rectangle in the turned picture, as its corners in the photograph: top left, top right, bottom right, bottom left of
/// the face.
pub type Corners = [[f64; 2]; 4];

/// A face, and the boxes that its features are looked for in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PaperFace {
    /// Where the template has eyes and mouth, the roll of the holes' axes, and a score from the template's energy.
    pub found: Found,
    /// The whole face: `MRB_A`.
    pub bounds: Corners,
    /// Eye and brow: first the ones at the picture's left.
    pub eyes: [Corners; 2],
    /// The nose.
    pub nose: Corners,
    /// The mouth.
    pub mouth: Corners,
}

/// The bounding rectangle of a block, turned by its direction.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Turned {
    /// Its top left corner.
    corner: [f32; 2],
    /// From it to the top right one.
    across: [f32; 2],
    /// From it to the bottom left one.
    down: [f32; 2],
}

impl Turned {
    /// Around the skin of a block. None if the shape is no face's.
    fn around(skin: &Mask, roll_rad: f32) -> Option<Self> {
        let (sin, cos) = roll_rad.sin_cos();
        let (mut low, mut high) = ([f32::MAX; 2], [f32::MIN; 2]);
        for (i, _) in skin.values().iter().enumerate().filter(|(_, inside)| **inside) {
            let (x, y) = ((i % skin.width()) as f32, (i / skin.width()) as f32);
            let turned = [x * cos + y * sin, y * cos - x * sin];
            for ((low, high), at) in low.iter_mut().zip(&mut high).zip(turned) {
                *low = low.min(at);
                *high = high.max(at);
            }
        }
        let width = high[0] - low[0];
        let height = (high[1] - low[1]).min(HEIGHT_MAX * width);
        (width >= 8.0 && height >= HEIGHT_MIN * width).then(|| Self {
            corner: [low[0] * cos - low[1] * sin, low[0] * sin + low[1] * cos],
            across: [width * cos, width * sin],
            down: [-height * sin, height * cos],
        })
    }

    /// A place of it, in shares of its width and height.
    fn at(&self, x: f32, y: f32) -> [f32; 2] {
        [
            self.corner[0] + x * self.across[0] + y * self.down[0],
            self.corner[1] + x * self.across[1] + y * self.down[1],
        ]
    }
}

/// The faces of a photograph, surest first; none where it has no colours.
#[must_use]
pub fn faces(photo: &Photo) -> Vec<PaperFace> {
    let shrink = (photo.width().max(photo.height()) as f32 / SIDE_PX).max(1.0);
    let side = |px: usize| ((px as f32 / shrink).round() as usize).max(1);
    let (width, height) = (side(photo.width()), side(photo.height()));
    let mask = skin::skin(photo, width, height).mask(|likely| likely >= SKIN_MIN);
    let grey = photo.grey().resized(width, height);
    let edges = grey.gradient().magnitude;
    let scale = [photo.width() as f64 / width as f64, photo.height() as f64 / height as f64];
    let mut faces: Vec<PaperFace> = blocks(&mask.opened(OPENING_PX))
        .iter()
        .filter_map(|Block { skin, holes }| {
            let roll_rad = direction_rad(holes);
            let turned = Turned::around(skin, roll_rad as f32)?;
            let energy = energy(&grey, &edges, &turned);
            (energy > ENERGY_MIN).then(|| face(&turned, roll_rad, energy, scale))
        })
        .collect();
    faces.sort_by(|a, b| b.found.score.total_cmp(&a.found.score));
    faces
}

fn face(turned: &Turned, roll_rad: f64, energy: f32, scale: [f64; 2]) -> PaperFace {
    let at = |x: f32, y: f32| {
        let [x, y] = turned.at(x, y).map(f64::from);
        [(x + 0.5) * scale[0] - 0.5, (y + 0.5) * scale[1] - 0.5]
    };
    let corners = |Zone(left, top, right, bottom): Zone| {
        [at(left, top), at(right, top), at(right, bottom), at(left, bottom)]
    };
    // Irises are looked for in the lower half of their boxes.
    let eye = |Zone(left, top, right, bottom): Zone| {
        at((left + right) / 2.0, top + 0.68 * (bottom - top))
    };
    let middle =
        |Zone(left, top, right, bottom): Zone| at((left + right) / 2.0, (top + bottom) / 2.0);
    let bounds = corners(Zone(0.0, 0.0, 1.0, 1.0));
    let [left, right, ..] = bounds;
    let width = (right[0] - left[0]).hypot(right[1] - left[1]);
    let found = Found {
        eyes: [eye(EYE_LEFT), eye(EYE_RIGHT)],
        mouth: middle(MOUTH),
        roll_rad,
        io_px: IO_OF_WIDTH * width,
        score: 1.0 / (1.0 + f64::from((ENERGY_MIN - energy) / ENERGY_SOFT).exp()),
    };
    let eyes = [corners(EYE_LEFT), corners(EYE_RIGHT)];
    PaperFace { found, bounds, eyes, nose: corners(NOSE), mouth: corners(MOUTH) }
}

//! Faces as (Yang et al. 2004) find them: blocks of skin, holes in them, and a template. Kept beside
//! [`find`](super::find) so that both can be measured on the same photographs.
//!
//! What the paper leaves open is chosen here: the thresholds, the structuring element, T0, the template's drawing and
//! `T_E`. Two things it does not have are added: a block is cut where the neck begins (at 1.45 of its width), and axes are
//! averaged as axes.

#[cfg(test)]
mod tests;

use super::find::DetectedFace;
use super::photo::Photo;
use super::plane::{Blob, Labels, Mask, Plane};

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
const INTEROCULAR_PER_WIDTH: f64 = 0.64;

/// Holes below this share of the block's area are dropped: the paper's T0, whose value it does not give. An eye has about
/// a hundredth.
const HOLE_SHARE_MIN: f64 = 0.001;
/// The paper's bounds on the number of holes.
const HOLES_MIN: usize = 3;
const HOLES_MAX: usize = 10;
/// Blocks below this share of the photograph are not looked at: with 3 holes and a template there is nothing to see.
const BLOCK_SHARE_MIN: f64 = 0.004;
/// Points across and down: the paper's M x N.
const ACROSS: usize = 24;
const DOWN: usize = 30;
/// What edges and brightness count: the paper's alpha and beta. Lips are darker than skin, so beta is negative.
const ALPHA: f32 = 1.0;
const BETA: f32 = -1.0;
/// Mean of r and g, and their covariance (rr, rg, gg), from the development photographs (`benches/subject/skin.py`): the
/// paper does not give its own.
const MEAN: [f32; 2] = [0.4269, 0.3131];
const COVARIANCE: [f32; 3] = [0.001_304, -0.000_211, 0.000_140];
/// R + G + B below which a pixel has no hue, and is no skin.
const DARK: f32 = 30.0;

/// A zone of the template, in shares of the face's rectangle.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Zone {
    left: f32,
    top: f32,
    right: f32,
    bottom: f32,
}

const fn zone([left, top, right, bottom]: [f32; 4]) -> Zone {
    Zone { left, top, right, bottom }
}

/// Where eye and brow, and the mouth are: first the ones at the picture's left.
const EYE_LEFT: Zone = zone([0.10, 0.18, 0.47, 0.48]);
const EYE_RIGHT: Zone = zone([0.53, 0.18, 0.90, 0.48]);
const MOUTH: Zone = zone([0.22, 0.66, 0.78, 0.90]);

/// Black: brows, eyes, the nose's base and the mouth's outline have edges. Our drawing, for the paper's is a small figure.
const BLACK: [Zone; 7] = [
    zone([0.15, 0.22, 0.43, 0.29]),
    zone([0.57, 0.22, 0.85, 0.29]),
    zone([0.17, 0.33, 0.41, 0.42]),
    zone([0.59, 0.33, 0.83, 0.42]),
    zone([0.37, 0.58, 0.63, 0.65]),
    zone([0.29, 0.71, 0.71, 0.76]),
    zone([0.31, 0.81, 0.69, 0.85]),
];
/// Grey: the lips.
const GREY: Zone = zone([0.31, 0.74, 0.69, 0.82]);

/// The faces of a photograph, surest first; none where it has no colours.
#[must_use]
pub fn faces(photo: &Photo) -> Vec<DetectedFace> {
    let shrink = (photo.width().max(photo.height()) as f32 / SIDE_PX).max(1.0);
    let side = |px: usize| ((px as f32 / shrink).round() as usize).max(1);
    let (width, height) = (side(photo.width()), side(photo.height()));
    let mask = skin(photo, width, height).map(|likely| likely >= SKIN_MIN);
    let grey = photo.grey().resized(width, height);
    let edges = grey.gradient().magnitude;
    let scale = [photo.width() as f64 / width as f64, photo.height() as f64 / height as f64];
    let mut faces: Vec<DetectedFace> = blocks(&mask.opened(OPENING_PX))
        .iter()
        .filter_map(|Block { skin, holes }| {
            let roll_rad = direction_rad(holes);
            let turned = RotatedBox::around(skin, roll_rad as f32)?;
            let energy = energy(&grey, &edges, &turned);
            (energy > ENERGY_MIN).then(|| found(&turned, roll_rad, energy, scale))
        })
        .collect();
    faces.sort_by(|a, b| b.score.total_cmp(&a.score));
    faces
}

/// Where the template has eyes and mouth, the roll of the holes' axes, and a score from the template's energy.
fn detection(turned: &RotatedBox, roll_rad: f64, energy: f32, scale: [f64; 2]) -> DetectedFace {
    let at = |x: f32, y: f32| {
        let [x, y] = turned.at(x, y).map(f64::from);
        [(x + 0.5) * scale[0] - 0.5, (y + 0.5) * scale[1] - 0.5]
    };
    // Irises are looked for in the lower half of their boxes.
    let eye = |eye: Zone| at((eye.left + eye.right) / 2.0, eye.top + 0.68 * (eye.bottom - eye.top));
    let (left, right) = (at(0.0, 0.0), at(1.0, 0.0));
    DetectedFace {
        eyes: [eye(EYE_LEFT), eye(EYE_RIGHT)],
        mouth: at((MOUTH.left + MOUTH.right) / 2.0, (MOUTH.top + MOUTH.bottom) / 2.0),
        roll_rad,
        interocular_px: INTEROCULAR_PER_WIDTH * (right[0] - left[0]).hypot(right[1] - left[1]),
        score: 1.0 / (1.0 + f64::from((ENERGY_MIN - energy) / ENERGY_SOFT).exp()),
    }
}

/// The bounding rectangle of a block, turned by its direction.
#[derive(Debug, Clone, Copy, PartialEq)]
struct RotatedBox {
    /// Its top left corner.
    corner: [f32; 2],
    /// From it to the top right one.
    across: [f32; 2],
    /// From it to the bottom left one.
    down: [f32; 2],
}

impl RotatedBox {
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

/// E = alpha sum of edges in the black zones + beta sum of brightness in the grey one (eq. 4). Both are means, in shares
/// of the mean over the whole rectangle, so that neither the size nor the light of a photograph changes E.
fn energy(grey: &Plane, edges: &Plane, face: &RotatedBox) -> f32 {
    let (mut all_edges, mut all_grey, mut black, mut lips) = (0.0, 0.0, [0.0; 2], [0.0; 2]);
    for i in 0..ACROSS * DOWN {
        let x = ((i % ACROSS) as f32 + 0.5) / ACROSS as f32;
        let y = ((i / ACROSS) as f32 + 0.5) / DOWN as f32;
        let [px, py] = face.at(x, y);
        let (edge, bright) = (edges.sample(px, py), grey.sample(px, py));
        all_edges += edge;
        all_grey += bright;
        if BLACK.iter().any(|zone| zone.holds(x, y)) {
            black = [black[0] + edge, black[1] + 1.0];
        }
        if GREY.holds(x, y) {
            lips = [lips[0] + bright, lips[1] + 1.0];
        }
    }
    let count = (ACROSS * DOWN) as f32;
    let share = |[sum, n]: [f32; 2], all: f32| sum / n.max(1.0) / (all / count).max(1e-3);
    ALPHA * share(black, all_edges) + BETA * share(lips, all_grey)
}

impl Zone {
    fn holds(&self, x: f32, y: f32) -> bool {
        let Self { left, top, right, bottom } = *self;
        (left..right).contains(&x) && (top..bottom).contains(&y)
    }
}

/// A block of skin with three holes at least.
#[derive(Debug, Clone)]
struct Block {
    /// The skin, without its holes filled.
    skin: Mask,
    /// Its holes, largest first.
    holes: Vec<Blob>,
}

/// The blocks of a mask of skin that have holes enough.
fn blocks(skin: &Mask) -> Vec<Block> {
    let labels = Labels::of(skin, false);
    let least = BLOCK_SHARE_MIN * (skin.width() * skin.height()) as f64;
    let large = labels.blobs.iter().enumerate().filter(|(_, blob)| blob.area as f64 >= least);
    large
        .filter_map(|(i, blob)| {
            let skin = labels.mask(i);
            let holes = holes(&skin, blob);
            (holes.len() >= HOLES_MIN).then_some(Block { skin, holes })
        })
        .collect()
}

/// What a block encloses: the parts of the rest that do not reach around it.
fn holes(skin: &Mask, blob: &Blob) -> Vec<Blob> {
    let rest = Labels::of(&skin.map(|inside| !inside), true);
    let within = |hole: &&Blob| {
        hole.left > blob.left
            && hole.top > blob.top
            && hole.right < blob.right
            && hole.bottom < blob.bottom
            && hole.area as f64 >= HOLE_SHARE_MIN * blob.area as f64
    };
    let mut holes: Vec<Blob> = rest.blobs.iter().filter(within).copied().collect();
    holes.sort_by(|a, b| b.area.cmp(&a.area).then(a.top.cmp(&b.top)).then(a.left.cmp(&b.left)));
    holes.truncate(HOLES_MAX);
    holes
}

/// The direction of a face (eq. 3), as the roll of the line of its eyes in radians, -pi/2 to pi/2: the mean of its holes'
/// axes. The paper takes the plain mean, which fails where angles wrap; axes are averaged at twice their angle, weighed
/// by area and eccentricity, for a round hole has no direction.
fn direction_rad(holes: &[Blob]) -> f64 {
    let (mut sin, mut cos) = (0.0, 0.0);
    for hole in holes {
        let weight = hole.area as f64 * hole.eccentricity();
        let twice = 2.0 * hole.axis_rad();
        sin += weight * twice.sin();
        cos += weight * twice.cos();
    }
    if sin == 0.0 && cos == 0.0 { 0.0 } else { 0.5 * sin.atan2(cos) }
}

/// Skin(p) = exp(-(p - m)' S^-1 (p - m) / 2), with p = (r, g) and r = R / (R + G + B), at `width` by `height` pixels.
fn skin(photo: &Photo, width: usize, height: usize) -> Plane {
    let channel = |i: usize| {
        photo.plane(|rgb| f32::from(rgb.get(i).copied().unwrap_or_default())).resized(width, height)
    };
    let (red, green, blue) = (channel(0), channel(1), channel(2));
    let sum = red.zip(&green, |a, b| a + b).zip(&blue, |a, b| a + b);
    // Two planes are joined at a time: first the chromaticities, with none for what is black.
    let ratio = |value: f32, sum: f32| if sum < DARK { f32::NAN } else { value / sum };
    red.zip(&sum, ratio).zip(&green.zip(&sum, ratio), likelihood)
}

fn likelihood(r: f32, g: f32) -> f32 {
    if r.is_nan() || g.is_nan() {
        return 0.0;
    }
    let [rr, rg, gg] = COVARIANCE;
    let (dr, dg) = (r - MEAN[0], g - MEAN[1]);
    let square = (gg * dr * dr - 2.0 * rg * dr * dg + rr * dg * dg) / (rr * gg - rg * rg);
    (-0.5 * square).exp()
}

//! Face detection of (Yang et al. 2004, sections 1 and 2) as printed: skin segmentation, a check of the holes in each
//! block of skin, and a template. It is kept for comparison with [`find`](super::find) on the same photographs.
//!
//! 1. Skin is a Gaussian of r and g chromaticity (equations 1 and 2), thresholded and opened; connected blocks are
//!    candidates.
//!
//! 2. A block needs at least three holes: eyes, brows, nostrils, mouth. The mean axis of the holes (3) gives the roll.
//!
//! 3. In the rotated rectangle of the block, the energy of the template (4) sums edges in its black zones and
//!    brightness in its grey zone.
//!
//! The paper gives no thresholds, structuring element, T0, template or `T_E`; they are chosen here. Two things are
//! added: a block is cut where the neck begins (at 1.45 of its width), and axes are averaged as axial data.
//!
//! 1. Skin is a Gaussian of r and g chromaticity (equations 1 and 2), thresholded and opened; connected blocks are
//!    candidates.
//!
//! 2. A block needs at least three holes: eyes, brows, nostrils, mouth. The mean axis of the holes (3) gives the roll.
//!
//! 3. In the rotated rectangle of the block, the energy of the template (4) sums edges in its black zones and
//!    brightness in its grey zone.
//!
//! The paper gives no thresholds, structuring element, T0, template or `T_E`; they are chosen here. Two things are
//! added: a block is cut where the neck begins (at 1.45 of its width), and axes are averaged as axial data.

use super::{
    find::DetectedFace,
    photo::Photo,
    plane::{Blob, Labels, Mask, Plane},
};

/// Skin threshold as a fraction of the likeliest colour: the Gaussian's ellipse of 1.55 deviations. At 0.1 faces merge
/// with walls on the development photographs, at 0.5 they fall apart.
const SKIN_MIN: f32 = 0.3;
/// Longer side of the working image, in pixels.
const SIDE_PX: f32 = 320.0;
/// Radius of the opening's square, in pixels of the working image.
const OPENING_PX: usize = 1;
/// Largest ratio of height to width of a face's rectangle; what is lower is neck.
const HEIGHT_MAX: f32 = 1.45;
/// Minimum ratio of height to width.
const HEIGHT_MIN: f32 = 0.9;
/// The paper's `T_E`: faces of the development photographs that form blocks have more.
const ENERGY_MIN: f32 = -0.1;
/// Scale of the logistic score around the threshold.
const ENERGY_SOFT: f32 = 0.2;
/// Outer interocular distance as a fraction of the rectangle's width.
const INTEROCULAR_PER_WIDTH: f64 = 0.64;

/// The paper's T0, whose value it does not give: least area of a hole as a fraction of the block. An eye has about a
/// hundredth.
const HOLE_SHARE_MIN: f64 = 0.001;
/// The paper's limits on the number of holes.
const HOLES_MIN: usize = 3;
const HOLES_MAX: usize = 10;
/// Minimum area of a block as a fraction of the photograph: smaller ones show no features.
const BLOCK_SHARE_MIN: f64 = 0.004;
/// Samples across and down: the paper's M x N.
const ACROSS: usize = 24;
const DOWN: usize = 30;
/// The paper's alpha and beta, the weights of edges and brightness. Lips are darker than skin, so beta is negative.
const ALPHA: f32 = 1.0;
const BETA: f32 = -1.0;
/// Mean of r and g and their covariance (rr, rg, gg), from the development photographs (`benches/subject/skin.py`); the
/// paper does not give its own.
const MEAN: [f32; 2] = [0.4269, 0.3131];
const COVARIANCE: [f32; 3] = [0.001_304, -0.000_211, 0.000_140];
/// Minimum R + G + B: a darker pixel has no hue and is not skin.
const DARK: f32 = 30.0;

/// A zone of the template, in fractions of the face's rectangle.
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

/// Zones of eyes with brows, the one at the picture's left first, and of the mouth.
const EYE_LEFT: Zone = zone([0.10, 0.18, 0.47, 0.48]);
const EYE_RIGHT: Zone = zone([0.53, 0.18, 0.90, 0.48]);
const MOUTH: Zone = zone([0.22, 0.66, 0.78, 0.90]);

/// Black zones: brows, eyes, base of the nose and outline of the mouth have edges. The drawing is ours, since the
/// paper's is a small figure.
const BLACK: [Zone; 7] = [
    zone([0.15, 0.22, 0.43, 0.29]),
    zone([0.57, 0.22, 0.85, 0.29]),
    zone([0.17, 0.33, 0.41, 0.42]),
    zone([0.59, 0.33, 0.83, 0.42]),
    zone([0.37, 0.58, 0.63, 0.65]),
    zone([0.29, 0.71, 0.71, 0.76]),
    zone([0.31, 0.81, 0.69, 0.85]),
];
/// Grey zone: the lips.
const GREY: Zone = zone([0.31, 0.74, 0.69, 0.82]);

/// Detects the faces of a photograph, best first; none if it has no colours.
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
            (energy > ENERGY_MIN).then(|| detection(&turned, roll_rad, energy, scale))
        })
        .collect();
    faces.sort_by(|a, b| b.score.total_cmp(&a.score));
    faces
}

/// Converts the template's eyes and mouth, the roll and the energy into a detection.
fn detection(turned: &RotatedBox, roll_rad: f64, energy: f32, scale: [f64; 2]) -> DetectedFace {
    let at = |x: f32, y: f32| {
        let [x, y] = turned.at(x, y).map(f64::from);
        [(x + 0.5) * scale[0] - 0.5, (y + 0.5) * scale[1] - 0.5]
    };
    // Irises lie in the lower half of their boxes.
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

/// The bounding rectangle of a block, rotated by its direction.
#[derive(Debug, Clone, Copy, PartialEq)]
struct RotatedBox {
    /// Top left corner.
    corner: [f32; 2],
    /// Vector to the top right corner.
    across: [f32; 2],
    /// Vector to the bottom left corner.
    down: [f32; 2],
}

impl RotatedBox {
    /// The rectangle around a block's skin; none if its shape is not a face's.
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

    /// A point of the rectangle, in fractions of its width and height.
    fn at(&self, x: f32, y: f32) -> [f32; 2] {
        [
            self.corner[0] + x * self.across[0] + y * self.down[0],
            self.corner[1] + x * self.across[1] + y * self.down[1],
        ]
    }
}

/// E = alpha sum of edges in the black zones + beta sum of brightness in the grey one (eq. 4). Both sums are means
/// relative to the mean over the rectangle, so that E depends neither on size nor on lighting.
fn energy(grey: &Plane, edges: &Plane, face: &RotatedBox) -> f32 {
    let (mut all_edges, mut all_grey, mut black, mut lips) = (0.0, 0.0, [0.0; 2], [0.0; 2]);
    for i in 0..ACROSS * DOWN {
        let x = ((i % ACROSS) as f32 + 0.5) / ACROSS as f32;
        let y = ((i / ACROSS) as f32 + 0.5) / DOWN as f32;
        let [px, py] = face.at(x, y);
        let (edge, bright) = (edges.sample(px, py), grey.sample(px, py));
        all_edges += edge;
        all_grey += bright;
        if BLACK.iter().any(|zone| zone.contains(x, y)) {
            black = [black[0] + edge, black[1] + 1.0];
        }
        if GREY.contains(x, y) {
            lips = [lips[0] + bright, lips[1] + 1.0];
        }
    }
    let count = (ACROSS * DOWN) as f32;
    let share = |[sum, n]: [f32; 2], all: f32| sum / n.max(1.0) / (all / count).max(1e-3);
    ALPHA * share(black, all_edges) + BETA * share(lips, all_grey)
}

impl Zone {
    fn contains(&self, x: f32, y: f32) -> bool {
        let Self { left, top, right, bottom } = *self;
        (left..right).contains(&x) && (top..bottom).contains(&y)
    }
}

/// A block of skin with at least three holes.
#[derive(Debug, Clone)]
struct Block {
    /// The skin without its holes.
    skin: Mask,
    /// Its holes, largest first.
    holes: Vec<Blob>,
}

/// The blocks of a skin mask with enough holes.
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

/// The holes of a block: enclosed components of its complement.
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

/// Direction of a face (eq. 3) as the roll of the line of its eyes, in radians from -pi/2 to pi/2: the mean axis of its
/// holes. The paper's plain mean fails where angles wrap; here doubled angles are averaged, weighted by area and
/// eccentricity, since a round hole has no direction.
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
    // Two planes at a time: first the chromaticities, NaN for black pixels.
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

#[cfg(test)]
mod tests {
    use super::{RotatedBox, blocks, direction_rad, faces};
    use crate::{
        Photo,
        plane::{Labels, Mask},
    };

    /// A face of ellipses, `half` pixels half as wide, rotated by `roll_rad`, in front of a blue wall.
    fn drawn(half: f32, roll_rad: f32) -> Photo {
        let (sin, cos) = roll_rad.sin_cos();
        let pixels = (0..200 * 200)
            .map(|i| {
                let (dx, dy) = ((i % 200) as f32 - 100.0, (i / 200) as f32 - 100.0);
                let (x, y) = ((dx * cos + dy * sin) / half, (dy * cos - dx * sin) / half);
                let inside = |cx: f32, cy: f32, wide: f32, high: f32| {
                    ((x.abs() - cx) / wide).hypot((y - cy) / high) < 1.0
                };
                let features = [
                    inside(0.41, -0.59, 0.27, 0.07),
                    inside(0.42, -0.32, 0.21, 0.10),
                    inside(0.0, 0.33, 0.2, 0.06),
                    inside(0.0, 0.74, 0.38, 0.12),
                ];
                match (inside(0.0, 0.0, 1.0, 1.3), features) {
                    (true, [.., true]) => [120, 40, 60],
                    (true, [false, false, false, false]) => [200, 146, 122],
                    (true, _) => [50, 45, 44],
                    (false, _) => [90, 110, 170],
                }
            })
            .collect();
        Photo::from_pixels(200, 200, pixels).unwrap()
    }

    #[test]
    fn a_drawn_face_is_found_with_its_roll() {
        for (half, roll_rad) in [(40.0, 0.0), (60.0, 0.0), (55.0, 0.3), (55.0, -0.4)] {
            let found = faces(&drawn(half, roll_rad));
            let [found] = found.as_slice() else {
                panic!("{half} {roll_rad}: {found:?}");
            };
            assert!((found.roll_rad - f64::from(roll_rad)).abs() < 0.05, "{}", found.roll_rad);
            let (sin, cos) = f64::from(roll_rad).sin_cos();
            let half = f64::from(half);
            let place = |x: f64, y: f64| {
                [100.0 + half * (x * cos - y * sin), 100.0 + half * (x * sin + y * cos)]
            };
            for (eye, side) in found.eyes.iter().zip([-0.42, 0.42]) {
                let at = place(side, -0.32);
                let off = (eye[0] - at[0]).hypot(eye[1] - at[1]) / found.interocular_px;
                assert!(off < 0.15, "{roll_rad}: {off}");
            }
            // The left eye is at the picture's left.
            assert!(found.eyes[0][0] < found.eyes[1][0]);
        }
    }

    #[test]
    fn skin_without_holes_is_not_a_face() {
        let pixels = (0..120 * 120)
            .map(|i: i32| {
                let inside = (i % 120 - 60).pow(2) + (i / 120 - 60).pow(2) < 45 * 45;
                if inside { [200, 146, 122] } else { [40, 90, 160] }
            })
            .collect();
        assert_eq!(faces(&Photo::from_pixels(120, 120, pixels).unwrap()), []);
        let black = Photo::from_pixels(40, 40, vec![[0; 3]; 1600]).unwrap();
        assert_eq!(faces(&black), []);
    }

    #[test]
    fn axes_are_averaged_as_axes() {
        // Two bars, slightly to either side of upright: their axial mean is upright, unlike the arithmetic mean of the
        // angles.
        let bars = Mask::from_values(
            40,
            40,
            (0..1600)
                .map(|i: i32| {
                    let (x, y) = (i % 40, i / 40);
                    (x - 8 - y / 8).abs() < 2 || (x - 32 + y / 8).abs() < 2
                })
                .collect(),
        );
        let blobs = Labels::of(&bars, true).blobs;
        assert_eq!(blobs.len(), 2);
        assert!((direction_rad(&blobs).abs() - std::f64::consts::FRAC_PI_2).abs() < 0.02);
        assert_eq!(direction_rad(&[]), 0.0);
    }

    #[test]
    fn a_block_keeps_its_ten_largest_holes() {
        let inside = |x: usize, y: usize| {
            let hole = |c: usize| (c - 4) % 12 < 4;
            !(4..94).contains(&x) || !(4..94).contains(&y) || !hole(x) || !hole(y)
        };
        let mask =
            Mask::from_values(98, 98, (0..98 * 98).map(|i| inside(i % 98, i / 98)).collect());
        let blocks = blocks(&mask);
        assert_eq!(blocks.len(), 1);
        assert_eq!(blocks[0].holes.len(), 10);
        // A square with the minimum height of a face.
        assert!(RotatedBox::around(&blocks[0].skin, 0.0).is_some());
    }
}

//! The paper's own way to the points (Yang et al. 2004, section 3), as a baseline: each feature by itself, in the box that
//! the face's position gives it.
//!
//! What the paper leaves open is chosen and named below: the boxes' sizes, the size of a jump, of a window
//! and of a circle, how like its seed a pixel must be to be grown into, and the weights of the snakes.

mod features;

use super::crop::{Crop, EYE_DISTANCE, HEIGHT, Maps, WIDTH};
use super::outline::{Heights, twelve};
use super::{BROWS, EYES, FacePoints, MOUTH, NOSE, RoughFace};
use crate::photo::Photo;
use crate::plane::{Gradient, Plane};
use crate::vector::{self, Point};

/// Confidence of a point whose step found nothing and fell back to a place in its box.
const FALLBACK: f64 = 0.2;

/// Points of the snake.
const OUTLINE_POINTS: usize = 64;
/// A pixel is of the face region when it is no less like the skin than this (0 to 1). The paper's threshold is not given.
const OUTLINE_UNLIKE: f32 = 0.5;
/// The face region's holes (eyes, brows, mouth) are closed up to this radius (pixels).
const HOLES_PX: usize = 5;
/// No outline lies nearer to the middle than this, or farther (pixels).
const OUTLINE_RADII: (i32, i32) = (35, 125);

/// The 53 points of the face that `rough` points at, by the paper's methods.
#[must_use]
pub fn find(photo: &Photo, rough: &RoughFace) -> FacePoints {
    let crop = Crop::cut(photo, rough);
    let places = [rough.left_eye, rough.right_eye, rough.mouth].map(|p| crop.in_crop(p));
    let [left, right, mouth_at] = places;
    let light = crop.plane(|[r, g, b]| 0.299 * r + 0.587 * g + 0.114 * b).blurred(1.0);
    let saturation = crop
        .plane(|[r, g, b]| {
            let top = r.max(g).max(b);
            if top > 0.0 { 1.0 - r.min(g).min(b) / top } else { 0.0 }
        })
        .blurred(1.0);
    let slope = light.gradient();
    let mut points = FacePoints::default();
    let sure = |found: bool| if found { 1.0 } else { FALLBACK };

    let mut brow_y = 0.0;
    for ((at, eye), brow) in [left, right].into_iter().zip(EYES).zip(BROWS) {
        let eye_box = Bounds::eye(at);
        let iris = features::iris(&slope, eye_box.lower_half());
        let lids = features::eye(&light, &iris, eye_box.lower_half());
        points.put(&eye, &lids.points, sure(lids.found), &crop);
        let line = features::brow(&light, eye_box.upper_half(), iris.x);
        points.put(&brow, &line.points, sure(line.found), &crop);
        brow_y += line.points.iter().map(|p| p[1]).sum::<f64>() / 10.0;
    }
    let middle = vector::middle(left, right);
    let base = features::nose(&slope, Bounds::nose(middle, mouth_at));
    points.put(&NOSE, &base.points, sure(base.found), &crop);
    let base_y = base.points.iter().map(|p| p[1]).sum::<f64>() / 5.0;
    let lips = features::mouth(&saturation, mouth_at);
    points.put(&MOUTH, &lips.points, sure(lips.found), &crop);

    let centre = vector::middle(middle, mouth_at);
    let cheek = |eye: Point| [eye[0], (eye[1] + mouth_at[1]) / 2.0];
    let skin = [cheek(left), cheek(right), [centre[0], middle[1] + 0.25 * EYE_DISTANCE]];
    let half = Maps::of(&crop).unlike_skin(&skin);
    let unlike = Plane::from_fn(WIDTH, HEIGHT, |x, y| half.sample(x as f32 / 2.0, y as f32 / 2.0));
    let line = outline(&unlike, &slope, centre);
    let heights = Heights { brows: brow_y, eyes: middle[1], nose: base_y, mouth: mouth_at[1] };
    for (id, at) in twelve(&line, centre[0], &heights) {
        points.set(id, crop.to_photo(at), 1.0);
    }
    points.outline = line.iter().map(|p| crop.to_photo(*p)).collect();
    points
}

/// The outline of the face by a closed snake from the outline of the skin region.
///
/// The outline, a closed polygon around `centre`. `unlike` says how little a pixel looks like the cheeks' skin.
fn outline(unlike: &Plane, slope: &Gradient, centre: Point) -> Vec<Point> {
    let skin = unlike.map(|v| v < OUTLINE_UNLIKE).closed(HOLES_PX);
    let mut curve: Vec<(i32, i32)> = (0..OUTLINE_POINTS)
        .map(|i| {
            let a = i as f64 / OUTLINE_POINTS as f64 * std::f64::consts::TAU;
            let place = |r: i32| {
                let r = f64::from(r);
                ((centre[0] + r * a.cos()).round() as i32, (centre[1] + r * a.sin()).round() as i32)
            };
            let inside = |r: &i32| {
                let (x, y) = place(*r);
                matches!((usize::try_from(x), usize::try_from(y)), (Ok(x), Ok(y)) if skin.row(y).get(x) == Some(&true))
            };
            // The first three pixels in a row that are no skin end the region.
            let end =
                (OUTLINE_RADII.0..OUTLINE_RADII.1).find(|r| (*r..*r + 3).all(|r| !inside(&r)));
            place(end.unwrap_or(OUTLINE_RADII.1))
        })
        .collect();
    fit_snake(&slope.magnitude, &mut curve, true);
    curve.into_iter().map(|(x, y)| [f64::from(x), f64::from(y)]).collect()
}

/// A rectangle of the crop (pixels), its right and bottom just outside.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Bounds {
    left: i32,
    top: i32,
    right: i32,
    bottom: i32,
}

impl Bounds {
    /// Around `at`: so far to both sides, up and down, in eye distances.
    fn around(at: Point, side: f64, up: f64, down: f64) -> Bounds {
        let px = |v: f64| v.round().clamp(-1e4, 1e4) as i32;
        Bounds {
            left: px(at[0] - side * EYE_DISTANCE),
            top: px(at[1] - up * EYE_DISTANCE),
            right: px(at[0] + side * EYE_DISTANCE) + 1,
            bottom: px(at[1] + down * EYE_DISTANCE) + 1,
        }
    }

    /// An eye with its brow: half of the box above the middle between the two, half below.
    fn eye(centre: Point) -> Bounds {
        Bounds::around(centre, 0.40, 0.62, 0.27)
    }

    /// The mouth.
    fn mouth(centre: Point) -> Bounds {
        Bounds::around(centre, 0.62, 0.30, 0.36)
    }

    /// The nose, between eyes and mouth.
    fn nose(eyes: Point, mouth: Point) -> Bounds {
        let middle = [(eyes[0] + mouth[0]) / 2.0, eyes[1]];
        let height = ((mouth[1] - eyes[1]) / EYE_DISTANCE).max(0.4);
        Bounds::around(middle, 0.36, -0.25 * height, 0.78 * height)
    }

    fn upper_half(self) -> Bounds {
        Bounds { bottom: (self.top + self.bottom) / 2, ..self }
    }

    fn lower_half(self) -> Bounds {
        Bounds { top: (self.top + self.bottom) / 2, ..self }
    }

    fn holds(self, x: i32, y: i32) -> bool {
        (self.left..self.right).contains(&x) && (self.top..self.bottom).contains(&y)
    }

    fn pixels(self) -> impl Iterator<Item = (i32, i32)> {
        (self.top..self.bottom).flat_map(move |y| (self.left..self.right).map(move |x| (x, y)))
    }
}

/// A pixel's value.
fn value(plane: &Plane, x: i32, y: i32) -> f64 {
    f64::from(plane.get(x as isize, y as isize))
}

/// Weights of continuity, curvature and image in equation (5). The paper gives none: those of (Williams and Shah 1992).
const WEIGHTS: [f64; 3] = [1.0, 1.0, 1.2];
/// Rounds at most.
const ROUNDS_MAX: usize = 120;

/// Pixels that a point may go to: itself and the four beside it, or the four across.
const BESIDE: [(i32, i32); 5] = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)];
const ACROSS: [(i32, i32); 5] = [(0, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)];

/// Lets a curve settle on the edges of `strength` (the larger, the better), by an active contour (Yang et al. 2004, equation
/// 5). An open curve keeps its ends.
///
/// It is solved greedily, with energies normalised over the neighbourhood of each point (Williams and Shah 1992); of the eight
/// neighbours the four beside and the four across are tried by turns, which halves the work and ends in the same place (Lam and
/// Yan 1994).
fn fit_snake(strength: &Plane, curve: &mut [(i32, i32)], closed: bool) {
    let n = curve.len();
    if n < 3 {
        return;
    }
    let mut still = 0;
    for round in 0..ROUNDS_MAX {
        let spacing = spacing(curve, closed);
        let pattern = if round % 2 == 0 { BESIDE } else { ACROSS };
        let mut moved = 0;
        let range = if closed { 0..n } else { 1..n - 1 };
        for i in range {
            let (Some(&here), Some(&before), Some(&after)) =
                (curve.get(i), curve.get((i + n - 1) % n), curve.get((i + 1) % n))
            else {
                continue;
            };
            let places = pattern.map(|(dx, dy)| (here.0 + dx, here.1 + dy));
            let continuity = places.map(|p| (spacing - distance(p, before)).abs());
            let curvature = places.map(|p| {
                let x = f64::from(before.0 - 2 * p.0 + after.0);
                let y = f64::from(before.1 - 2 * p.1 + after.1);
                x * x + y * y
            });
            let image = places.map(|p| -value(strength, p.0, p.1));
            let terms = [scaled(continuity, 0.0), scaled(curvature, 0.0), scaled(image, 1e-3)];
            let energy = |k: usize| -> f64 {
                terms.iter().zip(WEIGHTS).map(|(t, w)| w * t.get(k).copied().unwrap_or(0.0)).sum()
            };
            let mut best = 0;
            for k in 1..places.len() {
                if energy(k) < energy(best) - 1e-12 {
                    best = k;
                }
            }
            if best != 0
                && let (Some(point), Some(&place)) = (curve.get_mut(i), places.get(best))
            {
                *point = place;
                moved += 1;
            }
        }
        // Both patterns must have had their turn without a move.
        still = if moved * 20 <= n { still + 1 } else { 0 };
        if still == 2 {
            break;
        }
    }
}

/// From 0 to 1 over the neighbourhood; a range below `floor` is no difference.
fn scaled(energy: [f64; 5], floor: f64) -> [f64; 5] {
    let (low, high) = vector::extent(energy);
    let range = (high - low).max(floor).max(1e-12);
    energy.map(|e| (e - low) / range)
}

fn distance(a: (i32, i32), b: (i32, i32)) -> f64 {
    f64::from(a.0 - b.0).hypot(f64::from(a.1 - b.1))
}

/// Mean distance of neighbours.
fn spacing(curve: &[(i32, i32)], closed: bool) -> f64 {
    let pairs = curve.iter().zip(curve.iter().cycle().skip(1));
    let n = if closed { curve.len() } else { curve.len() - 1 };
    pairs.take(n).map(|(a, b)| distance(*a, *b)).sum::<f64>() / n as f64
}

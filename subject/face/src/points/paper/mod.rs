//! The published method for the points (Yang et al. 2004, section 3), as a baseline: each feature by itself, in the box
//! that follows from the face's position.
//!
//! Mouth corners come from projections of the saturation, eyelids and irises from a Hough transform and region growing,
//! brows from region growing, nose and face outline from snakes. The paper gives no numbers: sizes of boxes, jumps,
//! windows and circles, similarity thresholds and the snakes' weights are chosen and named below.

mod features;

use super::crop::{Crop, EYE_DISTANCE, HEIGHT, Maps, WIDTH};
use super::features::{Heights, twelve};
use super::{BROWS, EYES, FacePoints, MOUTH, NOSE, RoughFace};
use crate::photo::Photo;
use crate::plane;
use crate::plane::{Gradient, Plane, Point};

/// Confidence of a point whose step failed and fell back to a place in its box.
const FALLBACK: f64 = 0.2;

/// Number of points of the outline's snake.
const OUTLINE_POINTS: usize = 64;
/// Largest dissimilarity (0 to 1) to the skin within the face region. The paper gives no threshold.
const OUTLINE_UNLIKE: f32 = 0.5;
/// Holes of the face region (eyes, brows, mouth) are closed up to this radius (pixels).
const HOLES_PX: usize = 5;
/// Range of the outline's radius (pixels).
const OUTLINE_RADII: (i32, i32) = (35, 125);

/// Locates the 53 points of the face at `rough` by the published methods.
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
    let middle = plane::middle(left, right);
    let base = features::nose(&slope, Bounds::nose(middle, mouth_at));
    points.put(&NOSE, &base.points, sure(base.found), &crop);
    let base_y = base.points.iter().map(|p| p[1]).sum::<f64>() / 5.0;
    let lips = features::mouth(&saturation, mouth_at);
    points.put(&MOUTH, &lips.points, sure(lips.found), &crop);

    let centre = plane::middle(middle, mouth_at);
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

/// The outline of the face by a closed snake that starts at the outline of the skin region (Yang et al. 2004, equation
/// 5).
///
/// Returns a closed polygon around `centre`. `unlike` is the dissimilarity of each pixel to the skin of the cheeks.
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
            // The region ends at the first three consecutive pixels that are not skin.
            let end =
                (OUTLINE_RADII.0..OUTLINE_RADII.1).find(|r| (*r..*r + 3).all(|r| !inside(&r)));
            place(end.unwrap_or(OUTLINE_RADII.1))
        })
        .collect();
    fit_snake(&slope.magnitude, &mut curve, true);
    curve.into_iter().map(|(x, y)| [f64::from(x), f64::from(y)]).collect()
}

/// A rectangle of the crop (pixels); right and bottom are exclusive.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Bounds {
    left: i32,
    top: i32,
    right: i32,
    bottom: i32,
}

impl Bounds {
    /// A rectangle around `at`, in eye distances to both sides, up and down.
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

    /// A mouth.
    fn mouth(centre: Point) -> Bounds {
        Bounds::around(centre, 0.62, 0.30, 0.36)
    }

    /// A nose, between eyes and mouth.
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

    fn contains(self, x: i32, y: i32) -> bool {
        (self.left..self.right).contains(&x) && (self.top..self.bottom).contains(&y)
    }

    fn pixels(self) -> impl Iterator<Item = (i32, i32)> {
        (self.top..self.bottom).flat_map(move |y| (self.left..self.right).map(move |x| (x, y)))
    }
}

/// Value of a pixel.
fn value(plane: &Plane, x: i32, y: i32) -> f64 {
    f64::from(plane.get(x as isize, y as isize))
}

/// Weights of continuity, curvature and image in equation (5). The paper gives none; these are of (Williams and Shah
/// 1992).
const WEIGHTS: [f64; 3] = [1.0, 1.0, 1.2];
/// Maximum number of rounds.
const ROUNDS_MAX: usize = 120;

/// Moves of a point: to itself, the four adjacent pixels, or the four diagonal ones.
const ADJACENT: [(i32, i32); 5] = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)];
const DIAGONAL: [(i32, i32); 5] = [(0, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)];

/// Fits a snake to the edges of `strength` (Yang et al. 2004, equation 5). An open snake keeps its ends.
///
/// Greedy minimisation with energies normalised over each point's neighbourhood (Williams and Shah 1992). Adjacent and
/// diagonal neighbours alternate, which halves the work and ends in the same place (Lam and Yan 1994).
fn fit_snake(strength: &Plane, curve: &mut [(i32, i32)], closed: bool) {
    let n = curve.len();
    if n < 3 {
        return;
    }
    let mut still = 0;
    for round in 0..ROUNDS_MAX {
        let spacing = spacing(curve, closed);
        let pattern = if round % 2 == 0 { ADJACENT } else { DIAGONAL };
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
        // Stop once both patterns had a round with hardly any move.
        still = if moved * 20 <= n { still + 1 } else { 0 };
        if still == 2 {
            break;
        }
    }
}

/// Scales energies to 0 to 1 over the neighbourhood; a range below `floor` counts as no difference.
fn scaled(energy: [f64; 5], floor: f64) -> [f64; 5] {
    let (low, high) = plane::extent(energy);
    let range = (high - low).max(floor).max(1e-12);
    energy.map(|e| (e - low) / range)
}

fn distance(a: (i32, i32), b: (i32, i32)) -> f64 {
    f64::from(a.0 - b.0).hypot(f64::from(a.1 - b.1))
}

/// Mean distance between neighbours.
fn spacing(curve: &[(i32, i32)], closed: bool) -> f64 {
    let pairs = curve.iter().zip(curve.iter().cycle().skip(1));
    let n = if closed { curve.len() } else { curve.len() - 1 };
    pairs.take(n).map(|(a, b)| distance(*a, *b)).sum::<f64>() / n as f64
}

//! The paper's own way to the points (Yang et al. 2004, section 3), as a baseline: each feature by itself, in the box that
//! the face's position gives it.
//!
//! What the paper leaves open is chosen and named in the modules below: the boxes' sizes, the size of a jump, of a window
//! and of a circle, how like its seed a pixel must be to be grown into, and the weights of the snakes.

mod boxes;
mod brow;
mod contour;
mod eye;
mod mouth;
mod nose;
mod snake;

use super::crop::{Crop, EYE_DISTANCE, HEIGHT, WIDTH};
use super::maps::Maps;
use super::outline::{self, Heights};
use super::{BROWS, EYES, FacePoints, MOUTH, NOSE, Rough};
use crate::{Photo, Plane};
use boxes::Bounds;

/// Confidence of a point whose step found nothing and fell back to a place in its box.
const FALLBACK: f64 = 0.2;

/// The 53 points of the face that `rough` points at, by the paper's methods.
#[must_use]
pub fn find(photo: &Photo, rough: &Rough) -> FacePoints {
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
    let mut base_y = 0.0;
    for ((at, eye), brow) in [left, right].into_iter().zip(EYES).zip(BROWS) {
        let eye_box = Bounds::eye(at);
        let seen = eye::find(&light, &slope, eye_box);
        points.put(&eye, &seen.points, sure(seen.found), &crop);
        let (line, found) = brow::find(&light, eye_box, seen.iris);
        points.put(&brow, &line, sure(found), &crop);
        brow_y += line.iter().map(|p| p[1]).sum::<f64>() / 10.0;
    }
    let middle = [(left[0] + right[0]) / 2.0, (left[1] + right[1]) / 2.0];
    let (base, found) = nose::find(&slope, Bounds::nose(middle, mouth_at));
    points.put(&NOSE, &base, sure(found), &crop);
    base_y += base.iter().map(|p| p[1]).sum::<f64>() / 5.0;
    let (lips, found) = mouth::find(&saturation, mouth_at);
    points.put(&MOUTH, &lips, sure(found), &crop);

    let centre = [(middle[0] + mouth_at[0]) / 2.0, (middle[1] + mouth_at[1]) / 2.0];
    let cheek = |eye: [f64; 2]| [eye[0], (eye[1] + mouth_at[1]) / 2.0];
    let skin = [cheek(left), cheek(right), [centre[0], middle[1] + 0.25 * EYE_DISTANCE]];
    let half = super::skin::unlike(&Maps::of(&crop), &skin);
    let unlike = Plane::from_fn(WIDTH, HEIGHT, |x, y| half.sample(x as f32 / 2.0, y as f32 / 2.0));
    let line = contour::find(&unlike, &slope, centre);
    let heights = Heights { brows: brow_y, eyes: middle[1], nose: base_y, mouth: mouth_at[1] };
    for (id, at) in outline::twelve(&line, centre[0], &heights) {
        points.set(id, crop.to_photo(at), 1.0);
    }
    points.outline = line.iter().map(|p| crop.to_photo(*p)).collect();
    points
}

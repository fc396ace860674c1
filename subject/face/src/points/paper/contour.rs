//! The outline of the face by a closed snake from the outline of the skin region (Yang et al. 2004, section 3).

use super::snake;
use crate::Plane;
use crate::plane::Gradient;
use crate::points::search::Point;

/// Points of the snake.
const POINTS: usize = 64;
/// A pixel is of the face region when it is no less like the skin than this (0 to 1). The paper's threshold is not given.
const UNLIKE: f32 = 0.5;
/// The face region's holes (eyes, brows, mouth) are closed up to this radius (pixels).
const HOLES_PX: usize = 5;
/// No outline lies nearer to the middle than this, or farther (pixels).
const RADII: (i32, i32) = (35, 125);

/// The outline, a closed polygon around `centre`. `unlike` says how little a pixel looks like the cheeks' skin.
pub(super) fn find(unlike: &Plane, slope: &Gradient, centre: Point) -> Vec<Point> {
    let skin = unlike.mask(|v| v < UNLIKE).closed(HOLES_PX);
    let mut curve: Vec<(i32, i32)> = (0..POINTS)
        .map(|i| {
            let a = i as f64 / POINTS as f64 * std::f64::consts::TAU;
            let place = |r: i32| {
                let r = f64::from(r);
                ((centre[0] + r * a.cos()).round() as i32, (centre[1] + r * a.sin()).round() as i32)
            };
            let inside = |r: &i32| {
                let (x, y) = place(*r);
                matches!((usize::try_from(x), usize::try_from(y)), (Ok(x), Ok(y)) if skin.get(x, y))
            };
            // The first three pixels in a row that are no skin end the region.
            let end = (RADII.0..RADII.1).find(|r| (*r..*r + 3).all(|r| !inside(&r)));
            place(end.unwrap_or(RADII.1))
        })
        .collect();
    snake::settle(&slope.magnitude, &mut curve, true);
    curve.into_iter().map(|(x, y)| [f64::from(x), f64::from(y)]).collect()
}

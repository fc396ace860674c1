//! The channels of the crop that the features are looked for in.

use super::crop::{Crop, HEIGHT, WIDTH};
use super::search::Point;
use crate::Plane;

/// Added to every channel before its logarithm is taken (of 255): noise in the dark is no contrast.
const FLOOR: f32 = 12.0;

/// Logarithms, so that a difference of two pixels is a contrast whatever the light.
#[derive(Debug)]
pub(crate) struct Maps {
    /// Brightness, smoothed by 1.2 px.
    pub(crate) fine: Plane,
    /// Brightness, smoothed by 2.5 px.
    pub(crate) coarse: Plane,
    /// Redness ln(R/G), the logarithm of the pseudo-hue's odds, smoothed by 1.8 px.
    pub(crate) red: Plane,
    /// Brightness, ln(R/G) and ln(B/G) of every other pixel, as they are.
    pub(crate) raw: [Plane; 3],
}

impl Maps {
    pub(crate) fn of(crop: &Crop) -> Maps {
        let luma = crop.plane(|[r, g, b]| (FLOOR + 0.299 * r + 0.587 * g + 0.114 * b).ln());
        let red = crop.plane(|[r, g, _]| ((FLOOR + r) / (FLOOR + g)).ln());
        let half = |plane: &Plane| {
            Plane::from_fn(WIDTH / 2, HEIGHT / 2, |x, y| plane.get(2 * x as isize, 2 * y as isize))
        };
        let [_, green, blue] = &crop.rgb;
        let blueness = half(blue).zip(&half(green), |b, g| ((FLOOR + b) / (FLOOR + g)).ln());
        Maps {
            fine: luma.blurred(1.2),
            coarse: luma.blurred(2.5),
            red: red.blurred(1.8),
            raw: [half(&luma), half(&red), blueness],
        }
    }
}

/// The value at a point of a plane of the crop's size, bilinear; beyond its border that of the border.
#[inline]
pub(crate) fn at(plane: &Plane, p: Point) -> f64 {
    // As the plane's own sampling, with a size that is known here: this is where most of the time goes.
    // In this order what is not a number becomes 0.
    let held = |v: f64, size: usize| (v as f32).max(0.0).min((size - 2) as f32);
    let (x, y) = (held(p[0], WIDTH), held(p[1], HEIGHT));
    let (left, top) = (x as usize, y as usize);
    let (fx, fy) = (x - left as f32, y - top as f32);
    let from = top * WIDTH + left;
    let Some(&[a, b, .., c, d]) = plane.values().get(from..from + WIDTH + 2) else { return 0.0 };
    let (above, below) = (a + (b - a) * fx, c + (d - c) * fx);
    f64::from(above + (below - above) * fy)
}

/// `p + k n`.
pub(crate) fn along(p: Point, n: Point, k: f64) -> Point {
    [p[0] + k * n[0], p[1] + k * n[1]]
}

/// Unit vector from `a` to `b`; to the right where they are the same.
pub(crate) fn direction(a: Point, b: Point) -> Point {
    let (x, y) = (b[0] - a[0], b[1] - a[1]);
    let l = (x * x + y * y).sqrt();
    if l > 1e-9 { [x / l, y / l] } else { [1.0, 0.0] }
}

/// Upwards of a unit vector that runs to the right.
pub(crate) fn up(d: Point) -> Point {
    [d[1], -d[0]]
}

/// The point at `t` (0 to 1) of the cubic through four points at equal steps.
#[inline]
pub(crate) fn cubic(p: [Point; 4], t: f64) -> Point {
    let u = 3.0 * t;
    let w = [
        -(u - 1.0) * (u - 2.0) * (u - 3.0) / 6.0,
        u * (u - 2.0) * (u - 3.0) / 2.0,
        -u * (u - 1.0) * (u - 3.0) / 2.0,
        u * (u - 1.0) * (u - 2.0) / 6.0,
    ];
    let mut q = [0.0; 2];
    for (p, w) in p.iter().zip(w) {
        q[0] += w * p[0];
        q[1] += w * p[1];
    }
    q
}

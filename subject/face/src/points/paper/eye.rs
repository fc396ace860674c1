//! Eyes: the iris by the Hough transform, the corners by growing from the white, the lids as parabolas (Yang et al. 2004,
//! section 3).

use super::boxes::{Bounds, grow, parabola, value};
use crate::Plane;
use crate::plane::Gradient;
use crate::points::search::Point;

/// Radii of an iris (pixels): 0.07 to 0.15 of the eyes' distance. The paper gives none.
const RADII: std::ops::RangeInclusive<i32> = 4..=9;
/// A pixel votes when its slope is this share of the steepest in the box. The paper gives none.
const VOTES: f64 = 0.25;
/// The white reaches down to this share of the way from the iris' darkness to the seed. The paper gives none.
const WHITE: f64 = 0.75;

/// An eye.
#[derive(Debug, Clone, Copy)]
pub(super) struct Eye {
    /// Left corner, upper lid (2), right corner, lower lid (2, from the right).
    pub(super) points: [Point; 6],
    /// Centre of the iris.
    pub(super) iris: Point,
    /// Whether both corners were found.
    pub(super) found: bool,
}

/// The eye in the lower half of its box. `light` is brightness, 0 to 255.
pub(super) fn find(light: &Plane, slope: &Gradient, eye_box: Bounds) -> Eye {
    let bounds = eye_box.lower_half();
    let (x, y, r) = hough(slope, bounds);
    let (left, found_left) = corner(light, bounds, (x, y, r), -1);
    let (right, found_right) = corner(light, bounds, (x, y, r), 1);
    let iris = [f64::from(x), f64::from(y)];
    let lid = |height: f64, share: f64| {
        let at = left[0] + share * (right[0] - left[0]);
        [at, parabola(left, [iris[0], height], right, at)]
    };
    let (top, bottom) = (iris[1] - f64::from(r), iris[1] + f64::from(r));
    let third = 1.0 / 3.0;
    let points = [
        left,
        lid(top, third),
        lid(top, 2.0 * third),
        right,
        lid(bottom, 2.0 * third),
        lid(bottom, third),
    ];
    Eye { points, iris, found: found_left && found_right }
}

/// The circle with the most votes for its length: centre and radius. Irises are dark, so that a slope points outward.
fn hough(slope: &Gradient, b: Bounds) -> (i32, i32, i32) {
    let steepest =
        b.pixels().map(|(x, y)| value(&slope.magnitude, x, y)).fold(0.0, f64::max).max(1e-9);
    let width = b.right - b.left;
    let mut best = (0.0, (b.left + b.right) / 2, (b.top + b.bottom) / 2, *RADII.start());
    for r in RADII {
        let mut votes = vec![0.0_f64; (width * (b.bottom - b.top)).max(0) as usize];
        for (x, y) in b.pixels() {
            let m = value(&slope.magnitude, x, y);
            if m < VOTES * steepest {
                continue;
            }
            let step = f64::from(r) / m;
            let cx = x - (value(&slope.x, x, y) * step).round() as i32;
            let cy = y - (value(&slope.y, x, y) * step).round() as i32;
            if b.holds(cx, cy)
                && let Some(v) = votes.get_mut(((cy - b.top) * width + cx - b.left) as usize)
            {
                *v += m;
            }
        }
        for (cx, cy) in b.pixels() {
            // Votes scatter by rounding: the neighbours count too.
            let mut sum = 0.0;
            for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
                if b.holds(cx + dx, cy + dy) {
                    let i = (cy + dy - b.top) * width + cx + dx - b.left;
                    sum += votes.get(i as usize).copied().unwrap_or(0.0);
                }
            }
            let score = sum / f64::from(r);
            if score > best.0 {
                best = (score, cx, cy, r);
            }
        }
    }
    (best.1, best.2, best.3)
}

/// Grows the white on one side of the iris (`side` -1 or 1): its outermost pixel, or 2.2 radii from the centre where
/// nothing grows.
fn corner(light: &Plane, bounds: Bounds, iris: (i32, i32, i32), side: i32) -> (Point, bool) {
    let (x, y, r) = iris;
    let dark = value(light, x, y);
    // The seed: the brightest of a few pixels beside the iris.
    let seed = (r + 1..=r + 4)
        .flat_map(|d| (-2..=2).map(move |dy| (x + side * d, y + dy)))
        .filter(|(sx, sy)| bounds.holds(*sx, *sy))
        .max_by(|a, b| value(light, a.0, a.1).total_cmp(&value(light, b.0, b.1)));
    let fallback = ([f64::from(x) + f64::from(side) * 2.2 * f64::from(r), f64::from(y)], false);
    let Some(seed) = seed else { return fallback };
    let level = dark + WHITE * (value(light, seed.0, seed.1) - dark);
    let beside = Bounds {
        left: if side < 0 { bounds.left } else { x },
        right: if side < 0 { x + 1 } else { bounds.right },
        top: (y - r).max(bounds.top),
        bottom: (y + r + 1).min(bounds.bottom),
    };
    let region = grow(beside, seed, |px, py| value(light, px, py) >= level);
    let Some(out) = region.iter().max_by_key(|(px, _)| side * px) else { return fallback };
    // Grown to the end of its box, it is skin and not the white.
    let leaked = out.0 == bounds.left || out.0 + 1 == bounds.right;
    if leaked { fallback } else { ([f64::from(out.0), f64::from(out.1)], true) }
}

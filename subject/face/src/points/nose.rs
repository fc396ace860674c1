//! The base of the nose: left wing, left nostril, middle, right nostril, right wing.

use super::maps::{Maps, along, at, direction, up};
use super::search::{Found, Motion, Point, search, shift, stretch};

/// The base of the nose nearest to `start`.
pub(crate) fn find(maps: &Maps, start: &[Point; 5], reach: f64) -> Found<5> {
    let right = direction(start[0], start[4]);
    let n = up(right);
    let motion = |field, sd, reach, step| Motion { field, sd, reach, step };
    let motions = [
        motion(shift(right), reach / 1.5, 0.6 * reach, 2.0),
        motion(shift(n), reach / 1.5, reach, 1.5),
        motion(stretch(start, start[2], [1.0, 1.0]), 0.1, 0.1, 0.1),
    ];
    search(start, &motions, |p| score(maps, p))
}

fn score(maps: &Maps, &[a, b, c, d, e]: &[Point; 5]) -> f64 {
    let right = direction(a, e);
    let n = up(right);
    let g = |p| at(&maps.fine, p);
    let cap = |v: f64| v.clamp(-0.3, 0.6);
    // The nostrils are dark, the lip's skin below them is bright, and so is the tip above.
    let mut nostrils = 0.0;
    for p in [b, d] {
        let dark = g(along(p, n, 2.0));
        nostrils += cap(g(along(p, n, -3.5)) - dark) + 0.7 * cap(g(along(p, n, 8.0)) - dark);
    }
    let base = cap(g(along(c, n, 6.0)) - g(along(c, n, 0.5)));
    // The wings' shadow: outside is cheek.
    let wings = cap(g(along(a, right, -4.0)) - g(along(a, [right[0] * 0.7, right[1] * 0.7], 1.0)))
        + cap(g(along(e, right, 4.0)) - g(along(e, right, -0.7)));
    nostrils / 3.4 + 0.3 * base + 0.3 * wings
}

//! An eye: two lids as curves between two corners.
//! Order of the points: left corner of the picture, upper lid (2), right corner, lower lid (2, from the right).

use super::maps::{Maps, along, at, cubic, direction, up};
use super::search::{Found, Motion, Point, only, search, shift, stretch, turn};

/// Places on a lid that are looked at.
const STEPS: [f64; 7] = [0.12, 0.25, 0.38, 0.5, 0.62, 0.75, 0.88];

/// The eye nearest to `start`; `reach` (pixels) is how far it may lie.
pub(crate) fn find(maps: &Maps, start: &[Point; 6], reach: f64) -> Found<6> {
    let middle = start.iter().fold([0.0; 2], |s, p| [s[0] + p[0] / 6.0, s[1] + p[1] / 6.0]);
    let right = direction(start[0], start[3]);
    let upwards = up(right);
    let motion = |field, sd, reach, step| Motion { field, sd, reach, step };
    let motions = [
        motion(shift(right), reach / 1.5, reach, 2.0),
        motion(shift(upwards), reach / 1.5, reach, 1.5),
        motion(only(&[1, 2], upwards), 1.7, 3.0, 1.5),
        motion(only(&[4, 5], upwards), 1.2, 0.0, 0.0),
        motion(stretch(start, middle, [1.0, 0.4]), 0.08, 0.08, 0.08),
        motion(turn(start, middle), 0.07, 0.0, 0.0),
    ];
    search(start, &motions, |p| score(maps, p))
}

/// Contrast of the lids, the corners and the inside (natural logarithm).
fn score(maps: &Maps, &[a, b, c, d, e, f]: &[Point; 6]) -> f64 {
    let right = direction(a, d);
    let n = up(right);
    let g = |p| at(&maps.fine, p);
    let cap = |v: f64| v.clamp(-0.4, 0.7);
    let mut lids = 0.0;
    for t in STEPS {
        let upper = cubic([a, b, c, d], t);
        let lower = cubic([a, f, e, d], t);
        // The lashes are dark right below the upper lid's edge; below the lower lid is skin.
        lids += cap(g(along(upper, n, 3.5)) - g(along(upper, n, -0.7)));
        lids += 0.6 * cap(g(along(lower, n, -3.5)) - g(along(lower, n, 0.7)));
    }
    lids /= 1.6 * STEPS.len() as f64;
    let corners = cap(g(along(a, right, -3.5)) - g(along(a, right, 2.5)))
        + cap(g(along(d, right, 3.5)) - g(along(d, right, -2.5)));
    // The iris is darker than the white, or the skin, to its left and right: that tells an eye from a brow.
    let width = ((d[0] - a[0]).powi(2) + (d[1] - a[1]).powi(2)).sqrt();
    let middle = |s: f64| {
        let (u, l) = (cubic([a, b, c, d], 0.5 + s), cubic([a, f, e, d], 0.5 + s));
        [0.55 * u[0] + 0.45 * l[0], 0.55 * u[1] + 0.45 * l[1]]
    };
    let iris = [-0.14, 0.0, 0.14]
        .map(|s| {
            let q = middle(s);
            let dark = g(q);
            let side = g(along(q, right, 0.3 * width)).min(g(along(q, right, -0.3 * width)));
            cap(side - dark)
        })
        .into_iter()
        .fold(f64::NEG_INFINITY, f64::max);
    lids + 0.25 * corners + 0.5 * iris
}

//! A brow: a dark band over the eye.

use super::maps::{Maps, along, at, direction, up};
use super::search::{Found, Motion, Point, search, shift, stretch, turn};

/// The brow nearest to `start`, five points from the left of the picture, and above the upper lid `lid`.
pub(crate) fn find(maps: &Maps, start: &[Point; 5], lid: [Point; 2], reach: f64) -> Found<5> {
    let middle = start[2];
    let right = direction(start[0], start[4]);
    let n = up(right);
    let arch = std::array::from_fn(|i| {
        let t = i as f64 / 2.0 - 1.0;
        [n[0] * (1.0 - t * t), n[1] * (1.0 - t * t)]
    });
    let motion = |field, sd, reach, step| Motion { field, sd, reach, step };
    let motions = [
        motion(shift(right), 4.0, 0.0, 0.0),
        motion(shift(n), reach / 1.5, reach, 1.5),
        motion(turn(start, middle), 0.1, 0.12, 0.06),
        motion(arch, 1.5, 0.0, 0.0),
        motion(stretch(start, middle, [1.0, 0.3]), 0.08, 0.0, 0.0),
    ];
    search(start, &motions, |p| score(maps, p) - 0.06 * crowding(p, lid))
}

/// How much darker the band is than what lies above and below it.
fn score(maps: &Maps, &[a, b, c, d, e]: &[Point; 5]) -> f64 {
    let g = |p| at(&maps.coarse, p);
    let cap = |v: f64| v.clamp(-0.4, 0.8);
    let mut sum = 0.0;
    let mut count = 0.0;
    for (from, to) in [(a, b), (b, c), (c, d), (d, e)] {
        let n = up(direction(from, to));
        for t in [0.0, 0.5] {
            let q = [from[0] + t * (to[0] - from[0]), from[1] + t * (to[1] - from[1])];
            let dark = g(along(q, n, -1.5));
            sum += cap(g(along(q, n, 5.5)) - dark) + 0.6 * cap(g(along(q, n, -7.5)) - dark);
            count += 1.6;
        }
    }
    let right = direction(a, e);
    let ends = cap(g(along(a, right, -5.0)) - g(along(a, right, 3.0)))
        + cap(g(along(e, right, 5.0)) - g(along(e, right, -3.0)));
    sum / count + 0.08 * ends
}

/// A brow lies this far above the upper lid at least (pixels).
const CLEARANCE: f64 = 8.0;

/// How much nearer to the lid than that (pixels): a lid, or the rim of glasses, is a dark band too.
fn crowding(p: &[Point; 5], lid: [Point; 2]) -> f64 {
    let height = (lid[0][1] + lid[1][1]) / 2.0;
    let lowest = p.iter().skip(1).take(3).map(|p| p[1]).fold(f64::NEG_INFINITY, f64::max);
    (lowest - (height - CLEARANCE)).max(0.0)
}

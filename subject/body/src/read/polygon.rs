//! Polygons as triangles.

use crate::geometry::{Point, add, cross, dot, sub, unit};

/// Corners of a polygon that are cut ear by ear; that takes time with their square, or more. Larger ones are fans.
pub(super) const EARS_MAX: usize = 64;

/// Cuts a polygon of three or more corners into triangles of the same orientation. `at` gives the position of a corner.
///
/// A convex polygon could be cut anyhow. One with a notch must be cut from its ears, and a quad that is not plane is best
/// cut where its halves bend least: the ear whose triangle agrees most with the polygon's own normal goes first.
pub(super) fn triangulate(corners: &[u32], at: impl Fn(u32) -> Point, out: &mut Vec<[u32; 3]>) {
    let mut left = corners.to_vec();
    while left.len() > 3 && corners.len() <= EARS_MAX {
        let positions: Vec<Point> = left.iter().map(|&corner| at(corner)).collect();
        let normal = unit(area_vector(&positions));
        let n = left.len();
        let mut best = (0, f64::NEG_INFINITY);
        for i in 0..n {
            let value = ear(&positions, i, normal);
            if value > best.1 {
                best = (i, value);
            }
        }
        let i = best.0;
        out.push([left[(i + n - 1) % n], left[i], left[(i + 1) % n]]);
        left.remove(i);
    }
    if let [first, rest @ ..] = &left[..] {
        out.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
    }
}

/// How good an ear this corner is: the least agreement with the polygon's normal among its triangle and the two that it
/// leaves beside it; below all others where another corner lies within.
fn ear(positions: &[Point], i: usize, normal: Point) -> f64 {
    let n = positions.len();
    let at = |k: usize| positions[(i + n + k) % n];
    let (before, corner, after) = (at(n - 1), at(0), at(1));
    let facing = |a: Point, b: Point, c: Point| dot(unit(cross(sub(b, a), sub(c, a))), normal);
    let own = facing(before, corner, after);
    let inside = |p: Point| {
        [(before, corner), (corner, after), (after, before)]
            .iter()
            .all(|&(a, b)| dot(cross(sub(b, a), sub(p, a)), normal) > 0.0)
    };
    if own <= 0.0 || (2..n - 1).any(|k| inside(at(k))) {
        return -2.0 + own;
    }
    own.min(facing(before, after, at(2))).min(facing(at(n - 2), before, after)).max(-0.99)
}

/// Twice the area, along the normal.
fn area_vector(positions: &[Point]) -> Point {
    let Some(&origin) = positions.first() else { return [0.0; 3] };
    positions
        .windows(2)
        .fold([0.0; 3], |sum, pair| add(sum, cross(sub(pair[0], origin), sub(pair[1], origin))))
}

//! The outline of the face: the best closed path in polar coordinates, found by dynamic programming, which no starting
//! curve can mislead; and twelve points of it, left and right at six heights (Yang et al. 2004, section 3).

use super::crop::{Maps, at};
use crate::plane::{Plane, Point, along, distance, extent};

/// A point of the outline, with its contrast.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Ray {
    pub(crate) at: Point,
    pub(crate) contrast: f64,
}

/// Number of rays around the face.
const RAYS: usize = 72;
/// Cost of a radius one standard deviation from its expectation.
const DEVIATION_COST: f64 = 0.15;
/// Default expectation (pixels).
const RADIUS_USUAL: f64 = 80.0;
/// The longest radius (pixels).
const RADIUS_MAX: usize = 140;
/// The shortest radius (pixels).
const RADIUS_MIN: usize = 30;
/// Cost of one pixel of radius between neighbouring rays, times its square.
const SLOPE_COST: f64 = 0.015;
/// Largest difference of radii between neighbouring rays (pixels).
const SLOPE_MAX: usize = 4;
/// Number of radii per ray.
const LENGTH: usize = RADIUS_MAX - RADIUS_MIN;

/// Traces the closed outline around `centre`, one point per ray clockwise from the right of the picture, with its
/// contrast. `expected` are the expected radii, `sd` their standard deviation (pixels).
pub(crate) fn trace(
    maps: &Maps,
    unlike: &Plane,
    centre: Point,
    expected: &[f64],
    sd: f64,
) -> Vec<Ray> {
    let rays = directions();
    let place = |k: usize, i: usize| {
        along(centre, rays.get(k).copied().unwrap_or_default(), (RADIUS_MIN + i) as f64)
    };
    let penalty = |k: usize, i: usize| {
        let expected = expected.get(k).copied().unwrap_or(RADIUS_USUAL);
        let off = ((RADIUS_MIN + i) as f64 - expected) / sd;
        DEVIATION_COST * off * off
    };
    // Gain of every ray and radius, from the pixels three within and three beyond.
    let mut gain = vec![0.0_f64; RAYS * LENGTH];
    let mut tints = [[0.0_f64; 2]; LENGTH + 6];
    for (k, (row, d)) in gain.chunks_mut(LENGTH).zip(&rays).enumerate() {
        for (i, [colour, light]) in tints.iter_mut().enumerate() {
            let p = along(centre, *d, (RADIUS_MIN + i) as f64 - 3.0);
            *colour = f64::from(unlike.sample(0.5 * p[0] as f32, 0.5 * p[1] as f32));
            *light = at(&maps.fine, p);
        }
        for (i, ((g, within), beyond)) in row.iter_mut().zip(&tints).zip(&tints[6..]).enumerate() {
            let colour = beyond[0] - within[0];
            let light = (within[1] - beyond[1]).clamp(-0.3, 0.5);
            // Hair and shadow are darker than the face; a bright background is not.
            *g = colour + 0.5 * light.max(-0.3 * light) - penalty(k, i);
        }
    }
    best_path(&gain)
        .into_iter()
        .map(|(k, i)| Ray { at: place(k, i), contrast: gain_at(&gain, k, i) + penalty(k, i) })
        .collect()
}

/// Unit vectors clockwise from the right of the picture.
fn directions() -> [Point; RAYS] {
    std::array::from_fn(|k| {
        let (sin, cos) = (k as f64 / RAYS as f64 * std::f64::consts::TAU).sin_cos();
        [cos, sin]
    })
}

fn gain_at(gain: &[f64], ray: usize, radius: usize) -> f64 {
    gain.get(ray * LENGTH + radius).copied().unwrap_or(0.0)
}

/// The closed path of the largest total gain, by dynamic programming: each ray with the index of its radius.
///
/// It runs one and a half times around, so that the seam lies where the path has settled.
fn best_path(gain: &[f64]) -> Vec<(usize, usize)> {
    let turns = RAYS + RAYS / 2;
    let mut best = vec![0.0_f64; LENGTH];
    let mut from = Vec::with_capacity(turns * LENGTH);
    for k in 0..turns {
        let mut next = Vec::with_capacity(LENGTH);
        for i in 0..LENGTH {
            let near = i.saturating_sub(SLOPE_MAX)..(i + SLOPE_MAX + 1).min(LENGTH);
            let mut top = (f64::NEG_INFINITY, i);
            for (j, sum) in best.iter().enumerate().take(near.end).skip(near.start) {
                let step = i.abs_diff(j) as f64;
                let sum = sum - SLOPE_COST * step * step;
                if sum > top.0 {
                    top = (sum, j);
                }
            }
            next.push(top.0 + gain_at(gain, k % RAYS, i));
            from.push(top.1);
        }
        best = next;
    }
    let last = best.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
    let mut i = last.map_or(0, |(i, _)| i);
    let mut path: Vec<(usize, usize)> = (0..RAYS).map(|k| (k, 0)).collect();
    for k in (0..turns).rev() {
        // Skip a quarter turn at either end.
        if (RAYS / 4..turns - RAYS / 4).contains(&k)
            && let Some(ray) = path.get_mut(k % RAYS)
        {
            ray.1 = i;
        }
        i = from.get(k * LENGTH + i).copied().unwrap_or(i);
    }
    path
}

/// Radius at which each ray leaves the convex hull of `points`, with the rays of [`trace`].
pub(crate) fn hull_radii(points: &[Point], centre: Point) -> Vec<f64> {
    let hull = hull(points);
    let radius = |d: Point| {
        let mut far = 0.0_f64;
        for (p, q) in hull.iter().zip(hull.iter().cycle().skip(1)) {
            let (px, py) = (p[0] - centre[0], p[1] - centre[1]);
            let (ex, ey) = (q[0] - p[0], q[1] - p[1]);
            let det = d[0] * -ey + d[1] * ex;
            if det.abs() < 1e-9 {
                continue;
            }
            let t = (px * -ey + py * ex) / det;
            let s = (d[0] * py - d[1] * px) / det;
            if (0.0..=1.0).contains(&s) {
                far = far.max(t);
            }
        }
        far
    };
    directions().into_iter().map(radius).collect()
}

/// The vertices of the convex hull in order (Andrew 1979).
fn hull(points: &[Point]) -> Vec<Point> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let chain = |points: &mut dyn Iterator<Item = &Point>| {
        let mut chain: Vec<Point> = Vec::new();
        for p in points {
            while let [.., a, b] = chain.as_slice()
                && (b[0] - a[0]) * (p[1] - a[1]) <= (b[1] - a[1]) * (p[0] - a[0])
            {
                chain.pop();
            }
            chain.push(*p);
        }
        chain.pop();
        chain
    };
    let mut hull = chain(&mut sorted.iter());
    hull.extend(chain(&mut sorted.iter().rev()));
    hull
}

/// The outline's ray in the direction of `p`, and its point; none if `p` is the centre.
pub(crate) fn towards(outline: &[Ray], centre: Point, p: Point) -> Option<(Ray, Point)> {
    let (x, y) = (p[0] - centre[0], p[1] - centre[1]);
    let length = x.hypot(y);
    if outline.is_empty() || length < 1e-9 {
        return None;
    }
    let turn = y.atan2(x).rem_euclid(std::f64::consts::TAU) / std::f64::consts::TAU;
    let ray = outline.get((turn * outline.len() as f64).round() as usize % outline.len())?;
    let radius = distance(ray.at, centre);
    Some((*ray, [centre[0] + x / length * radius, centre[1] + y / length * radius]))
}

/// Heights of the features in the upright crop (pixels).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Heights {
    pub(crate) brows: f64,
    pub(crate) eyes: f64,
    /// Base of the nose.
    pub(crate) nose: f64,
    pub(crate) mouth: f64,
}

/// The twelve outline points, each with its index among the 53: the outermost crossings of six heights with the
/// outline.
///
/// Head top and chin follow the generic face: the hairline is as far above the brows as nine tenths of the distance
/// from the nose's base to the brows; the chin's height is midway between the lower lip and the outline's lowest point.
/// A height that misses the outline is moved to the nearest that meets it.
pub(crate) fn twelve(line: &[Point], middle_x: f64, heights: &Heights) -> Vec<(usize, Point)> {
    let (top, bottom) = extent(line.iter().map(|p| p[1]));
    if !(top.is_finite() && bottom > top) {
        return Vec::new();
    }
    let hairline = heights.brows - 0.9 * (heights.nose - heights.brows);
    // Below the lower lip: a fifth of the way to the chin.
    let lip = heights.mouth + 0.2 * (bottom - heights.mouth);
    let rows =
        [hairline, heights.brows, heights.eyes, heights.nose, heights.mouth, (lip + bottom) / 2.0];
    // Just inside the ends, where the outline still has two sides.
    let margin = 0.03 * (bottom - top);
    let mut points = Vec::with_capacity(12);
    for (i, row) in rows.into_iter().enumerate() {
        let y = row.clamp(top + margin, bottom - margin);
        let crossings = line
            .iter()
            .zip(line.iter().cycle().skip(1))
            .filter(|(a, b)| (a[1] < y) != (b[1] < y))
            .map(|(a, b)| a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
        let (left, right) =
            crossings.fold((middle_x, middle_x), |(l, r): (f64, f64), x| (l.min(x), r.max(x)));
        points.push((i, [left, y]));
        points.push((i + 6, [right, y]));
    }
    points
}

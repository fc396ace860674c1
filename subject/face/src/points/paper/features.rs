//! Location of eyes, brows, nose and mouth, each in its box (Yang et al. 2004, section 3).

use std::ops::RangeInclusive;

use super::{Bounds, fit_snake, value};
use crate::plane::{Gradient, Plane, Point, extent};

/// Radii of an iris (pixels): 0.07 to 0.15 of the eye distance. The paper gives none.
const RADII: RangeInclusive<i32> = 4..=9;
/// Minimum gradient of a voting pixel, as a fraction of the steepest in the box. The paper gives none.
const VOTES: f64 = 0.25;
/// Threshold of the white of the eye, as a fraction of the way from the iris' darkness to the seed. The paper gives
/// none.
const WHITE: f64 = 0.75;
/// Threshold of the brow, as a fraction of the way from the seed to the box's median. The paper gives none.
const DARK: f64 = 0.5;
/// Minimum width of a brow (pixels); less is a mole or noise.
const BROW_WIDTH_MIN: i32 = 12;
/// Threshold of the bridge's edges, as a fraction of the line's steepest gradient. The paper gives none.
const BRIDGE_EDGE: f64 = 0.6;
/// Number of points of the nose's snake.
const NOSE_POINTS: usize = 24;
/// A jump of the column projection, as a fraction of its range. The paper gives none.
const JUMP: f64 = 0.35;
/// Width of the sliding window (pixels). The paper gives none.
const WINDOW: i32 = 7;
/// Minimum width of the valley of an open mouth: the paper's 3 px.
const OPEN_PX: usize = 3;

/// The points of a feature, and whether they were located or follow from its box.
#[derive(Debug, Clone, Copy)]
pub(super) struct Feature<const N: usize> {
    pub(super) points: [Point; N],
    pub(super) found: bool,
}

/// An iris: a circle (pixels).
#[derive(Debug, Clone, Copy)]
pub(super) struct Iris {
    pub(super) x: i32,
    y: i32,
    radius: i32,
}

/// An eye from left to right: left corner, upper lid (2), right corner, lower lid (2, from the right). The corners come
/// from growing the white, the lids are parabolas. `light` is brightness, 0 to 255.
pub(super) fn eye(light: &Plane, iris: &Iris, bounds: Bounds) -> Feature<6> {
    let (left, found_left) = corner(light, bounds, iris, -1);
    let (right, found_right) = corner(light, bounds, iris, 1);
    let lid = |height: i32, share: f64| {
        let at = left[0] + share * (right[0] - left[0]);
        [at, parabola(left, [f64::from(iris.x), f64::from(height)], right, at)]
    };
    let (top, bottom) = (iris.y - iris.radius, iris.y + iris.radius);
    let third = 1.0 / 3.0;
    let points = [
        left,
        lid(top, third),
        lid(top, 2.0 * third),
        right,
        lid(bottom, 2.0 * third),
        lid(bottom, third),
    ];
    Feature { points, found: found_left && found_right }
}

/// The iris by the Hough transform: the circle with the most votes per length. Irises are dark, so gradients point
/// outward.
pub(super) fn iris(slope: &Gradient, b: Bounds) -> Iris {
    let steepest =
        b.pixels().map(|(x, y)| value(&slope.magnitude, x, y)).fold(0.0, f64::max).max(1e-9);
    let width = b.right - b.left;
    let mut most = 0.0;
    let mut best =
        Iris { x: (b.left + b.right) / 2, y: (b.top + b.bottom) / 2, radius: *RADII.start() };
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
            if b.contains(cx, cy)
                && let Some(v) = votes.get_mut(((cy - b.top) * width + cx - b.left) as usize)
            {
                *v += m;
            }
        }
        for (cx, cy) in b.pixels() {
            // Rounding scatters votes, so neighbours count too.
            let mut sum = 0.0;
            for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
                if b.contains(cx + dx, cy + dy) {
                    let i = (cy + dy - b.top) * width + cx + dx - b.left;
                    sum += votes.get(i as usize).copied().unwrap_or(0.0);
                }
            }
            let score = sum / f64::from(r);
            if score > most {
                (most, best) = (score, Iris { x: cx, y: cy, radius: r });
            }
        }
    }
    best
}

/// Grows the white on one side of the iris (`side` -1 or 1) and returns its outermost pixel, or 2.2 radii from the
/// centre if nothing grows.
fn corner(light: &Plane, bounds: Bounds, iris: &Iris, side: i32) -> (Point, bool) {
    let &Iris { x, y, radius: r } = iris;
    let dark = value(light, x, y);
    // The seed: the brightest of a few pixels next to the iris.
    let seed = (r + 1..=r + 4)
        .flat_map(|d| (-2..=2).map(move |dy| (x + side * d, y + dy)))
        .filter(|(sx, sy)| bounds.contains(*sx, *sy))
        .max_by(|a, b| value(light, a.0, a.1).total_cmp(&value(light, b.0, b.1)));
    let fallback = ([f64::from(x) + f64::from(side) * 2.2 * f64::from(r), f64::from(y)], false);
    let Some(seed) = seed else { return fallback };
    let level = dark + WHITE * (value(light, seed.0, seed.1) - dark);
    let window = Bounds {
        left: if side < 0 { bounds.left } else { x },
        right: if side < 0 { x + 1 } else { bounds.right },
        top: (y - r).max(bounds.top),
        bottom: (y + r + 1).min(bounds.bottom),
    };
    let region = grow(window, seed, |px, py| value(light, px, py) >= level);
    let Some(out) = region.iter().max_by_key(|(px, _)| side * px) else { return fallback };
    // A region that reaches the end of its box is skin, not the white.
    let leaked = out.0 == bounds.left || out.0 + 1 == bounds.right;
    if leaked { fallback } else { ([f64::from(out.0), f64::from(out.1)], true) }
}

/// Five points of a brow from the left of the picture, on the middle line of a region grown from a dark seed above the
/// iris.
pub(super) fn brow(light: &Plane, bounds: Bounds, iris_x: i32) -> Feature<5> {
    let x = iris_x.clamp(bounds.left, bounds.right - 1);
    let darkest = (bounds.top..bounds.bottom)
        .min_by(|a, b| value(light, x, *a).total_cmp(&value(light, x, *b)))
        .unwrap_or(bounds.top);
    let mut all: Vec<f64> = bounds.pixels().map(|(x, y)| value(light, x, y)).collect();
    all.sort_by(f64::total_cmp);
    let median = all.get(all.len() / 2).copied().unwrap_or(0.0);
    let seed = value(light, x, darkest);
    let level = seed + DARK * (median - seed);
    let region = grow(bounds, (x, darkest), |px, py| value(light, px, py) <= level);
    let left = region.iter().map(|p| p.0).min().unwrap_or(x);
    let right = region.iter().map(|p| p.0).max().unwrap_or(x);
    let found = right - left >= BROW_WIDTH_MIN;
    let (from, to) = if found {
        (f64::from(left), f64::from(right))
    } else {
        (f64::from(bounds.left) + 4.0, f64::from(bounds.right) - 5.0)
    };
    let points = [0.0, 0.25, 0.5, 0.75, 1.0].map(|t| {
        let at = from + t * (to - from);
        let column: Vec<f64> = region
            .iter()
            .filter(|p| (f64::from(p.0) - at).abs() <= 1.0)
            .map(|p| f64::from(p.1))
            .collect();
        let middle = column.iter().sum::<f64>() / column.len().max(1) as f64;
        [at, if column.is_empty() { f64::from(darkest) } else { middle }]
    });
    Feature { points, found }
}

/// Five points of the nose's base from the left of the picture, by an open snake between two points of the bridge.
pub(super) fn nose(slope: &Gradient, b: Bounds) -> Feature<5> {
    // The middle line of the box, averaged over a few rows against noise.
    let middle = (b.top + b.bottom) / 2;
    let line: Vec<f64> = (b.left..b.right)
        .map(|x| (middle - 2..=middle + 2).map(|y| value(&slope.x, x, y).abs()).sum::<f64>())
        .collect();
    let level = BRIDGE_EDGE * line.iter().copied().fold(0.0, f64::max);
    let first = line.iter().position(|v| *v >= level);
    let last = line.iter().rposition(|v| *v >= level);
    let width = b.right - b.left;
    let (left, right, found) = match (first, last) {
        (Some(f), Some(l)) if l as i32 - f as i32 > width / 5 => {
            (b.left + f as i32, b.left + l as i32, true)
        }
        _ => (b.left + width / 4, b.right - width / 4, false),
    };
    // From one end down, around the base, and up to the other.
    let centre = f64::from(left + right) / 2.0;
    let half = (f64::from(right - left) / 2.0).max(f64::from(width) * 0.3);
    let deep = f64::from(b.bottom - 4 - middle);
    let place = |i: usize| {
        let a = i as f64 / (NOSE_POINTS - 1) as f64 * std::f64::consts::PI;
        // A superellipse: a nose is wide down to its wings.
        let (x, y) = (-a.cos(), a.sin());
        let x = x.signum() * x.abs().powf(0.6);
        let px = |v: f64| v.round() as i32;
        (px(centre + half * x), middle + px(deep * y))
    };
    let mut curve: Vec<(i32, i32)> = (0..NOSE_POINTS).map(place).collect();
    if let Some(end) = curve.first_mut() {
        *end = (left, middle);
    }
    if let Some(end) = curve.last_mut() {
        *end = (right, middle);
    }
    fit_snake(&slope.magnitude, &mut curve, false);
    // The wings are the widest points of the lower half, the middle is the lowest; the nostrils lie between.
    let lower = || curve.iter().filter(|p| f64::from(p.1) > f64::from(middle) + 0.4 * deep);
    let point =
        |p: Option<&(i32, i32)>, or: Point| p.map_or(or, |p| [f64::from(p.0), f64::from(p.1)]);
    let base = f64::from(middle) + deep;
    let wing_left = point(lower().min_by_key(|p| p.0), [centre - half, base]);
    let wing_right = point(lower().max_by_key(|p| p.0), [centre + half, base]);
    let x = (wing_left[0] + wing_right[0]) / 2.0;
    let under = |x: f64| {
        let p = lower()
            .min_by(|a, b| (f64::from(a.0) - x).abs().total_cmp(&(f64::from(b.0) - x).abs()));
        [x, p.map_or(base, |p| f64::from(p.1))]
    };
    let quarter = (wing_right[0] - wing_left[0]) / 4.0;
    let points = [wing_left, under(x - quarter), under(x), under(x + quarter), wing_right];
    Feature { points, found }
}

/// Fourteen points of the mouth by projections of the saturation: the outer outline clockwise from the left corner, the
/// middle of the upper lip's inner edge, that of the lower lip's.
pub(super) fn mouth(saturation: &Plane, centre: Point) -> Feature<14> {
    let bounds = Bounds::mouth(centre);
    let projection = columns(saturation, bounds);
    let (left, right, found) = jumps(&projection, bounds);
    let half = WINDOW / 2;
    let window =
        |x: i32| rows(saturation, Bounds { left: x - half, right: x + half + 1, ..bounds });
    let height = |row: usize| f64::from(bounds.top) + row as f64;
    let corner = |x: i32| [f64::from(x), height(peak(&window(x)))];
    // The corner windows lie inside the mouth, whose end fills half of a window centred on it.
    let (a, g) = (corner(left + half), corner(right - half));
    let (a, g) = ([f64::from(left), a[1]], [f64::from(right), g[1]]);

    // The widest valley of all windows.
    let mut widest: Option<(usize, usize, i32)> = None;
    for x in left + half..=right - half {
        if let Some((from, to)) = valley(&window(x))
            && widest.is_none_or(|(f, t, _)| to - from > t - f)
        {
            widest = Some((from, to, x));
        }
    }
    let open = widest.filter(|(from, to, _)| to - from > OPEN_PX);
    let x = open.map_or((left + right) / 2, |(_, _, x)| x);
    let profile = window(x);
    let (top, bottom) = flanks(&profile);
    let line = peak(&profile);
    let (inner_top, inner_bottom) = open.map_or((line, line), |(from, to, _)| (from, to));
    let middle = (a[0] + g[0]) / 2.0;
    // A parabola needs a point off the corners' columns.
    let xm = f64::from(x).clamp(a[0] + 0.2 * (g[0] - a[0]), g[0] - 0.2 * (g[0] - a[0]));
    let curve = |row: usize, x: f64| [x, parabola(a, [xm, height(row)], g, x)];
    let at = |i: f64| a[0] + i / 6.0 * (g[0] - a[0]);
    let upper = [1.0, 2.0, 3.0, 4.0, 5.0].map(|i| curve(top, at(i)));
    let lower = [5.0, 4.0, 3.0, 2.0, 1.0].map(|i| curve(bottom, at(i)));
    let [b, c, d, e, f] = upper;
    let [h, i, j, k, l] = lower;
    let (m, n) = (curve(inner_top, middle), curve(inner_bottom, middle));
    Feature { points: [a, b, c, d, e, f, g, h, i, j, k, l, m, n], found }
}

/// First large jump from either side; the box's inner two thirds if there is none.
fn jumps(projection: &[f64], bounds: Bounds) -> (i32, i32, bool) {
    let (low, high) = extent(projection.iter().copied());
    let level = low + JUMP * (high - low);
    let above = |v: &f64| *v > level;
    let n = projection.len();
    let (first, last) = (projection.iter().position(above), projection.iter().rposition(above));
    match (first, last) {
        (Some(f), Some(l)) if l > f + 2 * WINDOW as usize => {
            let inside = f > 0 || l + 1 < n;
            (bounds.left + f as i32, bounds.left + l as i32, inside)
        }
        _ => {
            let sixth = (bounds.right - bounds.left) / 6;
            (bounds.left + sixth, bounds.right - sixth, false)
        }
    }
}

fn peak(profile: &[f64]) -> usize {
    (0..profile.len())
        .max_by(|a, b| {
            profile.get(*a).partial_cmp(&profile.get(*b)).unwrap_or(std::cmp::Ordering::Equal)
        })
        .unwrap_or(0)
}

/// The valley between the two highest peaks of a profile, at half its depth.
fn valley(profile: &[f64]) -> Option<(usize, usize)> {
    let best = peak(profile);
    let at = |i: usize| profile.get(i).copied().unwrap_or(0.0);
    // The other peak: the highest that is separated by a descent.
    let mut other: Option<(usize, usize, f64)> = None;
    for range in [(0..best).rev().collect::<Vec<_>>(), (best + 1..profile.len()).collect()] {
        let mut floor = (best, at(best));
        for i in range {
            if at(i) < floor.1 {
                floor = (i, at(i));
            }
            let rise = at(i) - floor.1;
            if rise > 0.25 * (at(best) - floor.1) && other.is_none_or(|(_, o, _)| at(i) > at(o)) {
                other = Some((floor.0, i, floor.1));
            }
        }
    }
    let (_, second, floor) = other?;
    let level = (floor + at(second)) / 2.0;
    let (from, to) = (best.min(second), best.max(second));
    let low: Vec<usize> = (from..=to).filter(|i| at(*i) < level).collect();
    Some((*low.first()?, *low.last()?))
}

/// Outer flanks of the profile: where it first and last reaches half of its range.
fn flanks(profile: &[f64]) -> (usize, usize) {
    let (low, high) = extent(profile.iter().copied());
    let above = |v: &f64| *v > (low + high) / 2.0;
    let first = profile.iter().position(above).unwrap_or(0);
    (first, profile.iter().rposition(above).unwrap_or(first))
}

/// Projection onto the columns: their means.
fn columns(plane: &Plane, b: Bounds) -> Vec<f64> {
    let n = f64::from((b.bottom - b.top).max(1));
    let mean = |x: i32| (b.top..b.bottom).map(|y| value(plane, x, y)).sum::<f64>() / n;
    (b.left..b.right).map(mean).collect()
}

/// Projection onto the rows: their means.
fn rows(plane: &Plane, b: Bounds) -> Vec<f64> {
    let n = f64::from((b.right - b.left).max(1));
    let mean = |y: i32| (b.left..b.right).map(|x| value(plane, x, y)).sum::<f64>() / n;
    (b.top..b.bottom).map(mean).collect()
}

/// The pixels of `bounds` that are `like` the seed and connected to it by their sides.
fn grow(bounds: Bounds, seed: (i32, i32), like: impl Fn(i32, i32) -> bool) -> Vec<(i32, i32)> {
    let width = (bounds.right - bounds.left).max(0);
    let index = |x: i32, y: i32| ((y - bounds.top) * width + (x - bounds.left)) as usize;
    let mut seen = vec![false; (width * (bounds.bottom - bounds.top).max(0)) as usize];
    let mut region = Vec::new();
    let mut open = vec![seed];
    while let Some((x, y)) = open.pop() {
        if !bounds.contains(x, y) || !like(x, y) {
            continue;
        }
        match seen.get_mut(index(x, y)) {
            Some(seen) if !*seen => *seen = true,
            _ => continue,
        }
        region.push((x, y));
        open.extend([(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)]);
    }
    region
}

/// The parabola through three points with different x, at `x`; the height of `b` if they share a column.
fn parabola(a: Point, b: Point, c: Point, x: f64) -> f64 {
    let term = |p: Point, q: Point, r: Point| {
        let d = (p[0] - q[0]) * (p[0] - r[0]);
        (d.abs() > 1e-9).then(|| p[1] * (x - q[0]) * (x - r[0]) / d)
    };
    match (term(a, b, c), term(b, a, c), term(c, a, b)) {
        (Some(u), Some(v), Some(w)) => u + v + w,
        _ => b[1],
    }
}

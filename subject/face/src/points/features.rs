//! Location of eyes, brows, nose and mouth: outlines that are moved and bent for the best score, until brightness and
//! redness agree with them; and of the outline of the face.
//!
//! The outline is the best closed path in polar coordinates, found by dynamic programming, which no starting
//! curve can mislead; and twelve points of it, left and right at six heights (Yang et al. 2004, section 3).

use super::crop::{Maps, at};
use crate::plane::{Plane, Point, along, cubic, direction, distance, extent, middle, up};

/// A degree of freedom of an outline.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion<const N: usize> {
    /// Displacement of each point per unit.
    pub(crate) field: [Point; N],
    /// Standard deviation of the amount; a deviation costs `DEVIATION_COST * (amount / sd)^2`.
    pub(crate) sd: f64,
    /// Range and step of the coarse search; a step of 0 disables it.
    pub(crate) reach: f64,
    pub(crate) step: f64,
}

impl<const N: usize> Motion<N> {
    pub(crate) fn new(field: [Point; N], sd: f64, reach: f64, step: f64) -> Self {
        Self { field, sd, reach, step }
    }
}

/// Cost of one standard deviation, in the unit of scores: the logarithm of a contrast.
const DEVIATION_COST: f64 = 0.012;
/// Number of step halvings in the refinement.
const HALVINGS: u32 = 4;
/// Maximum number of steps of the coarse search to either side.
const STEPS_MAX: f64 = 16.0;

/// The best outline and its score.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SearchResult<const N: usize> {
    pub(crate) points: [Point; N],
    pub(crate) score: f64,
    /// `score` less the cost of the deviation.
    pub(crate) penalised: f64,
}

/// Moves `start` to the highest `score`: a grid over the motions that have a step, then coordinate descent with halving
/// steps.
pub(crate) fn search<const N: usize, const M: usize>(
    start: &[Point; N],
    motions: &[Motion<N>; M],
    score: impl Fn(&[Point; N]) -> f64,
) -> SearchResult<N> {
    let place = |amounts: &[f64; M]| {
        let mut points = *start;
        for (amount, motion) in amounts.iter().zip(motions) {
            if *amount != 0.0 {
                for (p, d) in points.iter_mut().zip(&motion.field) {
                    p[0] += amount * d[0];
                    p[1] += amount * d[1];
                }
            }
        }
        points
    };
    let total = |amounts: &[f64; M]| {
        let excess: f64 = amounts.iter().zip(motions).map(|(a, m)| (a / m.sd) * (a / m.sd)).sum();
        score(&place(amounts)) - DEVIATION_COST * excess
    };
    let sides = motions
        .map(|m| if m.step > 0.0 { (m.reach / m.step).floor().min(STEPS_MAX) as u32 } else { 0 });
    let mut best = [0.0; M];
    let mut best_score = total(&best);
    for place in 0..sides.iter().map(|n| 2 * n + 1).product() {
        let amounts = grid(place, &sides, motions);
        let s = total(&amounts);
        if s > best_score {
            (best, best_score) = (amounts, s);
        }
    }
    let mut share = 1.0;
    for _ in 0..HALVINGS {
        for i in (0..M).chain(0..M) {
            let Some(motion) = motions.get(i) else { continue };
            let step = share * if motion.step > 0.0 { motion.step } else { motion.sd } / 2.0;
            for sign in [-1.0, 1.0] {
                let mut tried = best;
                if let Some(amount) = tried.get_mut(i) {
                    *amount += sign * step;
                }
                let s = total(&tried);
                if s > best_score {
                    (best, best_score) = (tried, s);
                    break;
                }
            }
        }
        share /= 2.0;
    }
    let points = place(&best);
    SearchResult { score: score(&points), penalised: best_score, points }
}

/// The amounts at one grid place, the first motion fastest.
fn grid<const N: usize, const M: usize>(
    place: u32,
    sides: &[u32; M],
    motions: &[Motion<N>; M],
) -> [f64; M] {
    let mut rest = place;
    let mut amounts = [0.0; M];
    for ((amount, n), motion) in amounts.iter_mut().zip(sides).zip(motions) {
        let count = 2 * n + 1;
        *amount = (f64::from(rest % count) - f64::from(*n)) * motion.step;
        rest /= count;
    }
    amounts
}

/// Translation of all points.
pub(crate) fn shift<const N: usize>(by: Point) -> [Point; N] {
    [by; N]
}

/// Scaling about `about`, weighted by `share` in x and y.
fn stretch<const N: usize>(points: &[Point; N], about: Point, share: Point) -> [Point; N] {
    points.map(|p| [share[0] * (p[0] - about[0]), share[1] * (p[1] - about[1])])
}

/// Rotation about `about` (radians).
pub(crate) fn turn<const N: usize>(points: &[Point; N], about: Point) -> [Point; N] {
    points.map(|p| [-(p[1] - about[1]), p[0] - about[0]])
}

/// Translation of the named points alone.
pub(crate) fn only<const N: usize>(which: &[usize], by: Point) -> [Point; N] {
    std::array::from_fn(|i| if which.contains(&i) { by } else { [0.0; 2] })
}

/// Sampled places on an eyelid or a lip.
const STEPS: [f64; 7] = [0.12, 0.25, 0.38, 0.5, 0.62, 0.75, 0.88];

/// Locates the eye nearest to `start`, two eyelids as curves between two corners: left corner in the picture, upper lid
/// (2), right corner, lower lid (2, from the right). `reach` is the search range (pixels).
pub(crate) fn eye(maps: &Maps, start: &[Point; 6], reach: f64) -> SearchResult<6> {
    let middle = start.iter().fold([0.0; 2], |s, p| [s[0] + p[0] / 6.0, s[1] + p[1] / 6.0]);
    let right = direction(start[0], start[3]);
    let upwards = up(right);
    let motions = [
        Motion::new(shift(right), reach / 1.5, reach, 2.0),
        Motion::new(shift(upwards), reach / 1.5, reach, 1.5),
        Motion::new(only(&[1, 2], upwards), 1.7, 3.0, 1.5),
        Motion::new(only(&[4, 5], upwards), 1.2, 0.0, 0.0),
        Motion::new(stretch(start, middle, [1.0, 0.4]), 0.08, 0.08, 0.08),
        Motion::new(turn(start, middle), 0.07, 0.0, 0.0),
    ];
    search(start, &motions, |p| eye_score(maps, p))
}

/// Contrast of lids, corners and iris (natural logarithm).
fn eye_score(maps: &Maps, &[a, b, c, d, e, f]: &[Point; 6]) -> f64 {
    let right = direction(a, d);
    let n = up(right);
    let g = |p| at(&maps.fine, p);
    let cap = |v: f64| v.clamp(-0.4, 0.7);
    let mut lids = 0.0;
    for t in STEPS {
        let upper = cubic([a, b, c, d], t);
        let lower = cubic([a, f, e, d], t);
        // The lashes are dark just below the upper lid's edge; below the lower lid is skin.
        lids += cap(g(along(upper, n, 3.5)) - g(along(upper, n, -0.7)));
        lids += 0.6 * cap(g(along(lower, n, -3.5)) - g(along(lower, n, 0.7)));
    }
    lids /= 1.6 * STEPS.len() as f64;
    let corners = cap(g(along(a, right, -3.5)) - g(along(a, right, 2.5)))
        + cap(g(along(d, right, 3.5)) - g(along(d, right, -2.5)));
    // The iris is darker than the white or the skin to its left and right, unlike a brow.
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

/// Locates the brow nearest to `start`, a dark band above the eye: five points from the left of the picture, above the
/// upper lid `lid`.
pub(crate) fn brow(
    maps: &Maps,
    start: &[Point; 5],
    lid: [Point; 2],
    reach: f64,
) -> SearchResult<5> {
    let middle = start[2];
    let right = direction(start[0], start[4]);
    let n = up(right);
    let arch = std::array::from_fn(|i| {
        let t = i as f64 / 2.0 - 1.0;
        [n[0] * (1.0 - t * t), n[1] * (1.0 - t * t)]
    });
    let motions = [
        Motion::new(shift(right), 4.0, 0.0, 0.0),
        Motion::new(shift(n), reach / 1.5, reach, 1.5),
        Motion::new(turn(start, middle), 0.1, 0.12, 0.06),
        Motion::new(arch, 1.5, 0.0, 0.0),
        Motion::new(stretch(start, middle, [1.0, 0.3]), 0.08, 0.0, 0.0),
    ];
    search(start, &motions, |p| brow_score(maps, p) - 0.06 * crowding(p, lid))
}

/// Contrast of the band to what lies above and below it.
fn brow_score(maps: &Maps, &[a, b, c, d, e]: &[Point; 5]) -> f64 {
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

/// Minimum distance of a brow above the upper lid (pixels).
const CLEARANCE: f64 = 8.0;

/// Shortfall of that distance (pixels): an eyelid or the rim of glasses is a dark band too.
fn crowding(p: &[Point; 5], lid: [Point; 2]) -> f64 {
    let height = (lid[0][1] + lid[1][1]) / 2.0;
    let lowest = p.iter().skip(1).take(3).map(|p| p[1]).fold(f64::NEG_INFINITY, f64::max);
    (lowest - (height - CLEARANCE)).max(0.0)
}

/// Locates the base of the nose nearest to `start`: left wing, left nostril, middle, right nostril, right wing.
pub(crate) fn nose(maps: &Maps, start: &[Point; 5], reach: f64) -> SearchResult<5> {
    let right = direction(start[0], start[4]);
    let n = up(right);
    let motions = [
        Motion::new(shift(right), reach / 1.5, 0.6 * reach, 2.0),
        Motion::new(shift(n), reach / 1.5, reach, 1.5),
        Motion::new(stretch(start, start[2], [1.0, 1.0]), 0.1, 0.1, 0.1),
    ];
    search(start, &motions, |p| nose_score(maps, p))
}

fn nose_score(maps: &Maps, &[a, b, c, d, e]: &[Point; 5]) -> f64 {
    let right = direction(a, e);
    let n = up(right);
    let g = |p| at(&maps.fine, p);
    let cap = |v: f64| v.clamp(-0.3, 0.6);
    // The nostrils are dark; the skin of the lip below and the tip above are bright.
    let mut nostrils = 0.0;
    for p in [b, d] {
        let dark = g(along(p, n, 2.0));
        nostrils += cap(g(along(p, n, -3.5)) - dark) + 0.7 * cap(g(along(p, n, 8.0)) - dark);
    }
    let base = cap(g(along(c, n, 6.0)) - g(along(c, n, 0.5)));
    // The shadow of the wings: outside is cheek.
    let wings = cap(g(along(a, right, -4.0)) - g(along(a, [right[0] * 0.7, right[1] * 0.7], 1.0)))
        + cap(g(along(e, right, 4.0)) - g(along(e, right, -0.7)));
    nostrils / 3.4 + 0.3 * base + 0.3 * wings
}

/// Locates the mouth nearest to `start`, the outlines of both lips and the line or gap between them: outer outline
/// clockwise from the left corner (12), middle of the upper lip's inner edge, middle of the lower lip's.
pub(crate) fn mouth(maps: &Maps, start: &[Point; 14], reach: f64) -> SearchResult<14> {
    let right = direction(start[0], start[6]);
    let n = up(right);
    let middle = middle(start[0], start[6]);
    // Raises the corners and keeps the middle.
    let half = (distance(start[0], start[6]) / 2.0).max(1.0);
    let smile = start.map(|p| {
        let t = ((p[0] - middle[0]) * right[0] + (p[1] - middle[1]) * right[1]) / half;
        [n[0] * t * t, n[1] * t * t]
    });
    let motions = [
        Motion::new(shift(right), reach / 1.5, 0.6 * reach, 3.0),
        Motion::new(shift(n), reach / 1.5, reach, 3.0),
        Motion::new(stretch(start, middle, [1.0, 0.0]), 0.15, 0.2, 0.1),
        // The jaw opens the mouth.
        Motion::new(only(&[7, 8, 9, 10, 11, 13], n), 5.0, 9.0, 4.5),
        Motion::new(only(&[1, 2, 3, 4, 5], n), 2.0, 0.0, 0.0),
        Motion::new(only(&[7, 8, 9, 10, 11], n), 2.5, 0.0, 0.0),
        Motion::new(only(&[12], n), 1.5, 0.0, 0.0),
        Motion::new(only(&[13], n), 2.5, 0.0, 0.0),
        Motion::new(smile, 2.5, 0.0, 0.0),
    ];
    search(start, &motions, |p| mouth_score(maps, 2.0 * half, p))
}

fn mouth_score(maps: &Maps, width: f64, p: &[Point; 14]) -> f64 {
    let &[a, b, c, d, e, f, g, h, i, j, k, l, top, bottom] = p;
    let right = direction(a, g);
    let n = up(right);
    let luma = |p| at(&maps.fine, p);
    let red = |p| at(&maps.red, p);
    let cap = |v: f64| v.clamp(-0.3, 0.5);
    let outline = |t: f64, q: [Point; 7]| -> Point {
        if t < 0.5 {
            cubic([q[0], q[1], q[2], q[3]], 2.0 * t)
        } else {
            cubic([q[3], q[4], q[5], q[6]], 2.0 * t - 1.0)
        }
    };
    let (mut outer, mut inner) = (0.0, 0.0);
    for t in STEPS {
        let upper = outline(t, [a, b, c, d, e, f, g]);
        let lower = outline(t, [a, l, k, j, i, h, g]);
        outer += 2.0 * cap(red(along(upper, n, -2.5)) - red(along(upper, n, 3.0)));
        outer += cap(luma(along(upper, n, 3.0)) - luma(along(upper, n, -2.0)));
        outer += 2.0 * cap(red(along(lower, n, 2.5)) - red(along(lower, n, -3.0)));
        outer += 0.3 * cap(luma(along(lower, n, -3.0)) - luma(along(lower, n, 1.0)));
        // Both inner edges are parabolas from corner to corner. The line between the lips is dark.
        let bow = 4.0 * t * (1.0 - t);
        let chord = [a[0] + t * (g[0] - a[0]), a[1] + t * (g[1] - a[1])];
        let middle = middle(a, g);
        let edge =
            |m: Point| [chord[0] + bow * (m[0] - middle[0]), chord[1] + bow * (m[1] - middle[1])];
        let (u, v) = (edge(top), edge(bottom));
        // Open lips may part over teeth as well as over darkness; neither has the colour of lips.
        let line = cap(luma(along(u, n, 3.5)) - luma(along(u, n, -0.5)))
            + 0.6 * cap(luma(along(v, n, -3.5)) - luma(along(v, n, 0.5)));
        let parted = 1.6
            * (cap(red(along(u, n, 2.5)) - red(along(u, n, -2.5)))
                + cap(red(along(v, n, -2.5)) - red(along(v, n, 2.5))));
        let open = ((v[1] - u[1]) / 5.0).clamp(0.0, 1.0);
        inner += line.max(open * parted);
    }
    // A short line is easily dark all along, so its length counts.
    inner *= (((g[0] - a[0]).powi(2) + (g[1] - a[1]).powi(2)).sqrt() / width).clamp(0.5, 1.5);
    let gap = ((bottom[0] - top[0]) * -n[0] + (bottom[1] - top[1]) * -n[1]).min(0.0);
    let corners = cap(luma(along(a, right, -4.0)) - luma(along(a, right, 2.0)))
        + cap(luma(along(g, right, 4.0)) - luma(along(g, right, -2.0)));
    let n_steps = STEPS.len() as f64;
    outer / (2.6 * n_steps) + inner / (1.2 * n_steps) + 0.15 * corners + 0.1 * gap
}

/// A point of the outline, with its contrast.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Ray {
    pub(crate) at: Point,
    pub(crate) contrast: f64,
}

/// Number of rays around the face.
const RAYS: usize = 72;
/// Cost of a radius one standard deviation from its expectation.
const OUTLINE_DEVIATION_COST: f64 = 0.15;
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
        OUTLINE_DEVIATION_COST * off * off
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

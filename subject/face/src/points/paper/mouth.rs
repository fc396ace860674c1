//! Mouth by the projections of the saturation (Yang et al. 2004, section 3).

use super::boxes::{Bounds, columns, parabola, rows};
use crate::Plane;
use crate::points::search::Point;

/// A jump of the column projection is big when it reaches this share of the projection's whole range. The paper gives
/// none.
const JUMP: f64 = 0.35;
/// Width of the sliding window (pixels). The paper gives none.
const WINDOW: i32 = 7;
/// A valley between the lips that is wider than this (pixels) is an open mouth: the paper's 3 px.
const OPEN_PX: usize = 3;

/// Fourteen points: the outer outline from the left corner clockwise, the upper lip's inner middle, the lower lip's; and
/// whether the corners were found.
pub(super) fn find(saturation: &Plane, centre: Point) -> ([Point; 14], bool) {
    let bounds = Bounds::mouth(centre);
    let projection = columns(saturation, bounds);
    let (left, right, found) = jumps(&projection, bounds);
    let half = WINDOW / 2;
    let window =
        |x: i32| rows(saturation, Bounds { left: x - half, right: x + half + 1, ..bounds });
    let height = |row: usize| f64::from(bounds.top) + row as f64;
    let corner = |x: i32| [f64::from(x), height(peak(&window(x)))];
    // The corner windows lie inside the mouth: its end fills half of one centred on it.
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
    let (inner_top, inner_bottom) = open.map_or_else(
        || {
            let line = peak(&profile);
            (line, line)
        },
        |(from, to, _)| (from, to),
    );
    let middle = (a[0] + g[0]) / 2.0;
    // A lip's point must lie off the corners' columns for a parabola.
    let xm = f64::from(x).clamp(a[0] + 0.2 * (g[0] - a[0]), g[0] - 0.2 * (g[0] - a[0]));
    let curve = |row: usize, x: f64| [x, parabola(a, [xm, height(row)], g, x)];
    let at = |i: f64| a[0] + i / 6.0 * (g[0] - a[0]);
    let upper = [1.0, 2.0, 3.0, 4.0, 5.0].map(|i| curve(top, at(i)));
    let lower = [5.0, 4.0, 3.0, 2.0, 1.0].map(|i| curve(bottom, at(i)));
    let [b, c, d, e, f] = upper;
    let [h, i, j, k, l] = lower;
    let (m, n) = (curve(inner_top, middle), curve(inner_bottom, middle));
    ([a, b, c, d, e, f, g, h, i, j, k, l, m, n], found)
}

/// First big jump from either side; the box's inner two thirds where there is none.
fn jumps(projection: &[f64], bounds: Bounds) -> (i32, i32, bool) {
    let low = projection.iter().copied().fold(f64::INFINITY, f64::min);
    let high = projection.iter().copied().fold(f64::NEG_INFINITY, f64::max);
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
    // The other peak: the highest from which one has to go down first.
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
    let low = profile.iter().copied().fold(f64::INFINITY, f64::min);
    let high = profile.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let above = |v: &f64| *v > (low + high) / 2.0;
    let first = profile.iter().position(above).unwrap_or(0);
    (first, profile.iter().rposition(above).unwrap_or(first))
}

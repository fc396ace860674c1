//! The nose by an open snake between two points of its bridge (Yang et al. 2004, section 3).

use super::boxes::{Bounds, value};
use super::snake;
use crate::plane::Gradient;
use crate::points::search::Point;

/// The bridge's edges are the first slopes from either side that reach this share of the line's steepest. The paper gives
/// none.
const EDGE: f64 = 0.6;
/// Points of the snake.
const POINTS: usize = 24;

/// Five points of the base from the left of the picture; and whether the bridge was found.
pub(super) fn find(slope: &Gradient, b: Bounds) -> ([Point; 5], bool) {
    // The middle line of the box, made of a few rows against noise.
    let middle = (b.top + b.bottom) / 2;
    let line: Vec<f64> = (b.left..b.right)
        .map(|x| (middle - 2..=middle + 2).map(|y| value(&slope.x, x, y).abs()).sum::<f64>())
        .collect();
    let level = EDGE * line.iter().copied().fold(0.0, f64::max);
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
    let mut curve: Vec<(i32, i32)> = (0..POINTS)
        .map(|i| {
            let a = i as f64 / (POINTS - 1) as f64 * std::f64::consts::PI;
            // A superellipse: a nose is wide down to its wings.
            let (x, y) = (-a.cos(), a.sin());
            let x = x.signum() * x.abs().powf(0.6);
            let px = |v: f64| v.round() as i32;
            (px(centre + half * x), middle + px(deep * y))
        })
        .collect();
    if let Some(end) = curve.first_mut() {
        *end = (left, middle);
    }
    if let Some(end) = curve.last_mut() {
        *end = (right, middle);
    }
    snake::settle(&slope.magnitude, &mut curve, false);
    // The wings are the widest places of the lower half, the middle is the lowest; the nostrils lie between.
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
    ([wing_left, under(x - quarter), under(x), under(x + quarter), wing_right], found)
}

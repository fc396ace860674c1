//! Brows by growing from a dark seed over the iris (Yang et al. 2004, section 3).

use super::boxes::{Bounds, grow, value};
use crate::Plane;
use crate::points::search::Point;

/// Pixels of the brow are darker than this share of the way from the seed to the box's median. The paper gives none.
const DARK: f64 = 0.5;
/// Columns that a brow spans at least (pixels); less is a mole or noise.
const WIDTH_MIN: i32 = 12;

/// Five points from the left of the picture, on the region's middle line; and whether there was a region.
pub(super) fn find(light: &Plane, eye_box: Bounds, iris: Point) -> ([Point; 5], bool) {
    let bounds = eye_box.upper_half();
    let x = (iris[0].round() as i32).clamp(bounds.left, bounds.right - 1);
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
    let found = right - left >= WIDTH_MIN;
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
    (points, found)
}

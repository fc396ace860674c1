//! Twelve points of a closed outline: left and right at six heights (Yang et al. 2004, section 3).

use super::search::Point;

/// Heights of the features in the upright crop (pixels).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Heights {
    pub(crate) brows: f64,
    pub(crate) eyes: f64,
    /// The nose's base.
    pub(crate) nose: f64,
    pub(crate) mouth: f64,
}

/// Index of each of the twelve among the 53 points, and its place: where the height's row crosses the outline outermost.
///
/// The heights of head top and chin are those of the generic face: the hairline nine tenths of the way from the nose's base
/// to the brows above these, and the middle between the mouth and the outline's lowest point. A row that misses the
/// outline takes the nearest that meets it.
pub(crate) fn twelve(line: &[Point], middle_x: f64, heights: &Heights) -> Vec<(usize, Point)> {
    let top = line.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
    let bottom = line.iter().map(|p| p[1]).fold(f64::NEG_INFINITY, f64::max);
    if !(top.is_finite() && bottom > top) {
        return Vec::new();
    }
    let hairline = heights.brows - 0.9 * (heights.nose - heights.brows);
    // Below the lower lip as it is: a fifth of the way to the chin.
    let lip = heights.mouth + 0.2 * (bottom - heights.mouth);
    let rows =
        [hairline, heights.brows, heights.eyes, heights.nose, heights.mouth, (lip + bottom) / 2.0];
    // Just inside the ends, where an outline still has two sides.
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

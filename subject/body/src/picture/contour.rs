//! Lines of equal value in a grid (marching squares), as closed loops with few points.

use std::collections::HashMap;

/// How far a loop may be from the line, in cells.
const TOLERANCE: f64 = 0.18;

/// Loops around all cells above a level, in units of cells. The border of the grid has to be below.
pub(super) fn loops(values: &[f64], [width, height]: [usize; 2], level: f64) -> Vec<Vec<[f64; 2]>> {
    // Each crossing lies between a cell and its neighbour to the right (false) or below (true).
    let mut next: HashMap<(usize, bool), (usize, bool)> = HashMap::new();
    let mut starts = Vec::new();
    let value = |at: usize| values.get(at).copied().unwrap_or(0.0);
    for y in 0..height.saturating_sub(1) {
        for x in 0..width.saturating_sub(1) {
            let at = y * width + x;
            let corners = [at, at + 1, at + width + 1, at + width];
            let sides = [(at, false), (at + 1, true), (at + width, false), (at, true)];
            let above = corners.map(|corner| value(corner) > level);
            for i in 0..4 {
                // In over this side, around the corners above, and out: corner i + 1 is below, so there is an end.
                if above[i] && !above[(i + 1) % 4] {
                    let mut j = i;
                    while above[(j + 3) % 4] {
                        j = (j + 3) % 4;
                    }
                    let out = (j + 3) % 4;
                    next.insert(sides[i], sides[out]);
                    starts.push(sides[i]);
                }
            }
        }
    }
    let crossing = |(at, below): (usize, bool)| {
        let other = if below { at + width } else { at + 1 };
        let (a, b) = (value(at), value(other));
        let share = if a == b { 0.5 } else { ((level - a) / (b - a)).clamp(0.0, 1.0) };
        let (x, y) = ((at % width) as f64, (at / width) as f64);
        if below { [x, y + share] } else { [x + share, y] }
    };
    let mut loops = Vec::new();
    for start in starts {
        let mut points = Vec::new();
        let mut at = start;
        while let Some(after) = next.remove(&at) {
            points.push(crossing(at));
            at = after;
        }
        // Smaller ones are grains.
        if points.len() > 8 {
            loops.push(thinned(&points));
        }
    }
    loops
}

/// Leaves out points that are all but on the line between those that are kept.
fn thinned(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut kept = Vec::new();
    let mut from = 0;
    while let Some(&start) = points.get(from) {
        kept.push(start);
        let mut to = from + 1;
        while to + 1 < points.len() && to - from < 24 {
            let end = points[to + 1];
            let (dx, dy) = (end[0] - start[0], end[1] - start[1]);
            let length = dx.hypot(dy);
            let off = |p: &[f64; 2]| ((p[0] - start[0]) * dy - (p[1] - start[1]) * dx).abs();
            if points[from + 1..=to].iter().any(|p| off(p) > TOLERANCE * length) {
                break;
            }
            to += 1;
        }
        from = to;
    }
    kept
}

//! Rasterised shading of a surface with a depth buffer, and contour lines of a raster.

use std::collections::HashMap;

use crate::Mesh;
use crate::mesh::{Point, normal, unit};

/// Maximum number of cells along a side.
const CELLS_MAX: usize = 700;

/// A raster over part of the page.
#[derive(Debug)]
pub(super) struct Shade {
    pub(super) size: [usize; 2],
    /// Size of a cell in page units.
    pub(super) cell: f64,
    /// Page position of the first cell's corner.
    pub(super) corner: [f64; 2],
    /// Brightness row by row: 0 outside, up to 1 where the surface faces the light.
    pub(super) light: Vec<f64>,
    /// 1 where the surface covers the cell.
    pub(super) cover: Vec<f64>,
    /// Depth buffer: nearness to the viewer, in the unit of the points.
    depth: Vec<f64>,
}

/// Direction to the light: over the viewer's left shoulder.
const LIGHT: [f64; 3] = [-0.35, 0.45, 0.82];

impl Shade {
    /// Rasterises a mesh whose vertices are given in view coordinates: x and y on the page, z towards the viewer.
    pub(super) fn new(mesh: &Mesh, seen: &[Point], low: [f64; 2], high: [f64; 2]) -> Self {
        let extent = [high[0] - low[0], high[1] - low[1]];
        let cell = (extent[0].max(extent[1]) / (CELLS_MAX - 8) as f64).max(1.0);
        let size = extent.map(|length| ((length / cell) as usize + 8).min(CELLS_MAX));
        let corner = low.map(|c| c - 4.0 * cell);
        let n = size[0] * size[1];
        let (light, cover, depth) = (vec![0.0; n], vec![0.0; n], vec![f64::NEG_INFINITY; n]);
        let mut shade = Self { size, cell, corner, light, cover, depth };
        let normals = normals(mesh, seen);
        let towards = unit(LIGHT.into());
        for triangle in &mesh.triangles {
            let corners = triangle.map(|i| seen.get(i as usize).copied().unwrap_or_default());
            let bright = triangle.map(|i| {
                let normal = normals.get(i as usize).copied().unwrap_or_default();
                // The page has y down, the light has y up.
                let lit = Point::new(normal.x, -normal.y, normal.z).dot(&towards).max(0.0);
                0.12 + 0.45 * normal[2].max(0.0) + 0.43 * lit
            });
            shade.fill(corners, bright);
        }
        for _ in 0..2 {
            blur(&mut shade.light, size);
            blur(&mut shade.cover, size);
        }
        shade
    }

    fn fill(&mut self, corners: [Point; 3], bright: [f64; 3]) {
        let to_cells = |p: Point| [0, 1].map(|k| (p[k] - self.corner[k]) / self.cell - 0.5);
        let [a, b, c] = corners.map(to_cells);
        let doubled = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if doubled == 0.0 || !doubled.is_finite() {
            return;
        }
        let range = |k: usize| {
            let low = a[k].min(b[k]).min(c[k]).ceil().max(0.0) as usize;
            let high = a[k].max(b[k]).max(c[k]).floor().max(-1.0) + 1.0;
            low..(high as usize).min(self.size[k])
        };
        for y in range(1) {
            for x in range(0) {
                let p = [x as f64, y as f64];
                let part = |from: [f64; 2], to: [f64; 2]| {
                    ((to[0] - from[0]) * (p[1] - from[1]) - (to[1] - from[1]) * (p[0] - from[0]))
                        / doubled
                };
                let weights = [part(b, c), part(c, a), part(a, b)];
                if weights.iter().any(|&w| w < -1e-9) {
                    continue;
                }
                let mix = |of: [f64; 3]| of.iter().zip(weights).map(|(value, w)| value * w).sum();
                let (depth, light): (f64, f64) = (mix(corners.map(|p| p[2])), mix(bright));
                let at = y * self.size[0] + x;
                if depth > self.depth[at] {
                    (self.depth[at], self.light[at], self.cover[at]) = (depth, light, 1.0);
                }
            }
        }
    }

    /// Whether a surface point is visible, up to a tolerance in the unit of the points.
    pub(super) fn sees(&self, p: Point, tolerance: f64) -> bool {
        let cell = |k: usize| (p[k] - self.corner[k]) / self.cell;
        let (x, y) = (cell(0), cell(1));
        if x < 0.0 || y < 0.0 || x as usize >= self.size[0] || y as usize >= self.size[1] {
            return true;
        }
        self.depth[y as usize * self.size[0] + x as usize] <= p[2] + tolerance
    }
}

/// Vertex normals weighted by area, pointing to the viewer where the surface faces it.
fn normals(mesh: &Mesh, seen: &[Point]) -> Vec<Point> {
    let mut normals = vec![Point::zeros(); seen.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| seen.get(i as usize).copied().unwrap_or_default());
        // The page mirrors the view: y is down.
        let normal = normal([a, c, b]);
        for &corner in triangle {
            if let Some(sum) = normals.get_mut(corner as usize) {
                *sum += normal;
            }
        }
    }
    normals.into_iter().map(unit).collect()
}

/// Box blur of three by three cells; the border stays.
fn blur(values: &mut [f64], [width, height]: [usize; 2]) {
    let before = values.to_vec();
    for y in 1..height.saturating_sub(1) {
        for x in 1..width.saturating_sub(1) {
            let at = y * width + x;
            let sum: f64 = [at - width, at, at + width]
                .iter()
                .map(|&row| before[row - 1] + before[row] + before[row + 1])
                .sum();
            values[at] = sum / 9.0;
        }
    }
}

/// Largest deviation of a thinned contour, in cells.
const TOLERANCE: f64 = 0.18;

/// Closed contours around all cells above a level, in units of cells. The border of the raster must be below it.
pub(super) fn loops(values: &[f64], [width, height]: [usize; 2], level: f64) -> Vec<Vec<[f64; 2]>> {
    // A crossing lies between a cell and its neighbour to the right (false) or below (true).
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
                // Enter over this side, go around the corners above, leave: corner i + 1 is below, so the loop ends.
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
        // Smaller contours are noise.
        if points.len() > 8 {
            loops.push(thinned(&points));
        }
    }
    loops
}

/// Drops points that lie almost on the line between kept ones.
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

#[cfg(test)]
mod tests {
    use super::loops;

    #[test]
    fn contours_go_around_what_is_above() {
        // Two discs and a ring.
        let size = [80, 40];
        let mut values = vec![0.0; 80 * 40];
        for (x, y) in (0..80).flat_map(|x| (0..40).map(move |y| (x, y))) {
            let far = |cx: f64, cy: f64| (x as f64 - cx).hypot(y as f64 - cy);
            let ring = (4.0 - (far(55.0, 20.0) - 10.0).abs()).max(0.0);
            values[y * 80 + x] =
                (8.0 - far(15.0, 12.0)).max(7.0 - far(18.0, 31.0)).max(ring).max(0.0);
        }
        let loops = loops(&values, size, 1.0);
        assert_eq!(loops.len(), 4);
        let area = |l: &Vec<[f64; 2]>| {
            let next = l.iter().cycle().skip(1);
            l.iter().zip(next).map(|(p, q)| p[0] * q[1] - p[1] * q[0]).sum::<f64>() / 2.0
        };
        let mut areas: Vec<f64> = loops.iter().map(|l| area(l).abs()).collect();
        areas.sort_by(f64::total_cmp);
        for (found, radius) in areas.into_iter().zip([6.0, 7.0, 7.0, 13.0]) {
            let expected = std::f64::consts::PI * radius * radius;
            assert!((found / expected - 1.0).abs() < 0.04, "{found} {expected}");
        }
    }
}

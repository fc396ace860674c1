//! What is seen of a surface, cell by cell: how bright, and how near.

use crate::Mesh;
use crate::geometry::{Point, add, cross, dot, sub, unit};

/// Cells on a side of the picture at most.
const CELLS_MAX: usize = 700;

/// A grid over a part of the paper.
#[derive(Debug)]
pub(super) struct Shade {
    pub(super) size: [usize; 2],
    /// Cells of a unit of the paper.
    pub(super) cell: f64,
    /// Corner of the first cell on the paper.
    pub(super) corner: [f64; 2],
    /// Brightness, 0 outside and up to 1 where the surface faces the light; row by row.
    pub(super) light: Vec<f64>,
    /// 1 where there is a surface.
    pub(super) cover: Vec<f64>,
    /// Nearness to the viewer in the unit of the points.
    depth: Vec<f64>,
}

/// Where the light comes from: over the viewer's left shoulder.
const LIGHT: Point = [-0.35, 0.45, 0.82];

impl Shade {
    /// Of a mesh whose vertices are given as they are seen: x and y on the paper, z towards the viewer.
    pub(super) fn new(mesh: &Mesh, seen: &[Point], low: [f64; 2], high: [f64; 2]) -> Self {
        let extent = [high[0] - low[0], high[1] - low[1]];
        let cell = (extent[0].max(extent[1]) / (CELLS_MAX - 8) as f64).max(1.0);
        let size = extent.map(|length| ((length / cell) as usize + 8).min(CELLS_MAX));
        let corner = low.map(|c| c - 4.0 * cell);
        let n = size[0] * size[1];
        let (light, cover, depth) = (vec![0.0; n], vec![0.0; n], vec![f64::NEG_INFINITY; n]);
        let mut shade = Self { size, cell, corner, light, cover, depth };
        let normals = normals(mesh, seen);
        let towards = unit(LIGHT);
        for triangle in &mesh.triangles {
            let corners = triangle.map(|i| seen.get(i as usize).copied().unwrap_or_default());
            let bright = triangle.map(|i| {
                let normal = normals.get(i as usize).copied().unwrap_or_default();
                // Paper has y down, the light does not.
                let lit = dot([normal[0], -normal[1], normal[2]], towards).max(0.0);
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

    /// Whether a point of the surface is in front of all others, up to some tolerance in the unit of the points.
    pub(super) fn sees(&self, p: Point, tolerance: f64) -> bool {
        let cell = |k: usize| (p[k] - self.corner[k]) / self.cell;
        let (x, y) = (cell(0), cell(1));
        if x < 0.0 || y < 0.0 || x as usize >= self.size[0] || y as usize >= self.size[1] {
            return true;
        }
        self.depth[y as usize * self.size[0] + x as usize] <= p[2] + tolerance
    }
}

/// Of vertices, each triangle with its area for a weight; towards the viewer where it faces him.
fn normals(mesh: &Mesh, seen: &[Point]) -> Vec<Point> {
    let mut normals = vec![[0.0; 3]; seen.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| seen.get(i as usize).copied().unwrap_or_default());
        // The paper is a mirror image: y is down.
        let normal = cross(sub(c, a), sub(b, a));
        for &corner in triangle {
            if let Some(sum) = normals.get_mut(corner as usize) {
                *sum = add(*sum, normal);
            }
        }
    }
    normals.into_iter().map(unit).collect()
}

/// Means over three by three cells; the border stays.
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

//! Closing of holes.

use super::RepairError;
use super::manifold::{NONE, pair_half_edges};
use crate::mesh::{Point, distance, ends, mean};
use crate::{Mesh, Note};

/// Largest patch that is closed, as a fraction of the surface. A missing sole has 0.01, a neck 0.007, a leg cut at the
/// hip 0.02, a body cut at the waist 0.05.
const AREA_MAX: f64 = 0.03;
/// Maximum number of rings of vertices that fill a hole.
const RINGS_MAX: usize = 24;

/// Closes every hole with rings of triangles around its centroid.
pub(super) fn close(mesh: &mut Mesh, notes: &mut Vec<Note>) -> Result<(), RepairError> {
    let borders = borders(mesh);
    if borders.is_empty() {
        return Ok(());
    }
    let whole = mesh.area();
    let across = mesh.extent();
    let mut longest = (0.0, 0.0);
    let count = borders.len();
    for border in borders {
        let perimeter = perimeter(mesh, &border);
        let before = mesh.triangles.len();
        fill(mesh, &border, perimeter);
        let filled: f64 = mesh.triangles[before..].iter().map(|t| mesh.area_of(*t)).sum();
        if filled > AREA_MAX * whole {
            let (perimeter, area) = (100.0 * perimeter / across, 100.0 * filled / whole);
            return Err(RepairError::Hole { perimeter, area });
        }
        if perimeter > longest.0 {
            longest = (perimeter, filled);
        }
    }
    let text = format!(
        "closed {count} {}, the longest {:.1} % of the extent around and {:.2} % of the surface",
        if count == 1 { "hole" } else { "holes" },
        100.0 * longest.0 / across,
        100.0 * longest.1 / whole
    );
    notes.push(Note::new("holes-closed", text));
    Ok(())
}

/// The vertices of each border loop, in the direction of its triangles. In a manifold a vertex lies on at most one.
fn borders(mesh: &Mesh) -> Vec<Vec<u32>> {
    let (across, _) = pair_half_edges(mesh);
    let mut after = vec![NONE; mesh.positions.len()];
    for (side, _) in across.iter().enumerate().filter(|(_, other)| **other == NONE) {
        let [from, to] = ends(&mesh.triangles, side as u32);
        after[from as usize] = to;
    }
    let mut borders = Vec::new();
    for first in 0..after.len() {
        let mut border = Vec::new();
        let mut at = first;
        while let Some(next) = after.get_mut(at).filter(|next| **next != NONE) {
            border.push(at as u32);
            at = std::mem::replace(next, NONE) as usize;
        }
        if !border.is_empty() {
            borders.push(border);
        }
    }
    borders
}

fn points(mesh: &Mesh, border: &[u32]) -> Vec<Point> {
    border.iter().map(|&vertex| mesh.point(vertex)).collect()
}

fn perimeter(mesh: &Mesh, border: &[u32]) -> f64 {
    let points = points(mesh, border);
    let after = points.iter().cycle().skip(1);
    points.iter().zip(after).map(|(&a, &b)| distance(a, b)).sum()
}

/// Fills a border loop with as many rings as make triangles about as long as its edges; the innermost ring is one
/// vertex.
fn fill(mesh: &mut Mesh, border: &[u32], perimeter: f64) {
    if let [a, b, c] = border[..] {
        mesh.triangles.push([c, b, a]);
        return;
    }
    let points = points(mesh, border);
    let Some(middle) = mean(points.iter().copied()) else { return };
    let radius = points.iter().map(|&p| (p - middle).norm()).sum::<f64>() / points.len() as f64;
    let edge = perimeter / points.len() as f64;
    let rings = ((radius / edge).round() as usize).clamp(1, RINGS_MAX);
    let n = border.len();
    let mut outer = border.to_vec();
    for ring in 1..rings {
        let share = ring as f64 / rings as f64;
        let first = mesh.positions.len() as u32;
        let towards_middle = |p: &Point| <[f64; 3]>::from(p + (middle - p) * share);
        mesh.positions.extend(points.iter().map(towards_middle));
        let inner: Vec<u32> = (first..first + n as u32).collect();
        for i in 0..n {
            let j = (i + 1) % n;
            mesh.triangles.push([outer[j], outer[i], inner[i]]);
            mesh.triangles.push([outer[j], inner[i], inner[j]]);
        }
        outer = inner;
    }
    let centre = mesh.positions.len() as u32;
    mesh.positions.push(middle.into());
    mesh.triangles.extend((0..n).map(|i| [outer[(i + 1) % n], outer[i], centre]));
}

//! Vertices spread far over the surface.

use super::choice::farthest;
use crate::Mesh;
use crate::geodesic::{Graph, Workspace, distances};

/// Up to `count` vertices by farthest-point sampling, with the distances from each: every one is the farthest from all
/// before it, and the first is the farthest from `start`.
pub(super) fn farthest_points(
    graph: &Graph,
    start: u32,
    count: usize,
    workspace: &mut Workspace,
) -> Vec<(u32, Vec<f64>)> {
    let mut fields = Vec::new();
    let mut nearest = distances(graph, start, workspace);
    for turn in 0..count {
        let Some(vertex) = farthest(&nearest, |_| true) else { break };
        let field = distances(graph, vertex, workspace);
        if turn == 0 {
            nearest.clone_from(&field);
        } else {
            for (nearest, far) in nearest.iter_mut().zip(&field) {
                *nearest = nearest.min(*far);
            }
        }
        fields.push((vertex, field));
    }
    fields
}

/// The centroid of the surface, each triangle weighted by its area.
pub(crate) fn area_centroid(mesh: &Mesh) -> [f64; 3] {
    let mut sum = [0.0; 3];
    let mut total = 0.0;
    for corners in &mesh.triangles {
        let [a, b, c] = corners.map(|vertex| mesh.positions[vertex as usize]);
        let (u, v) = (minus(b, a), minus(c, a));
        let normal =
            [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        let area = normal.iter().map(|part| part * part).sum::<f64>().sqrt();
        for axis in 0..3 {
            sum[axis] += area * (a[axis] + b[axis] + c[axis]) / 3.0;
        }
        total += area;
    }
    if total > 0.0 { sum.map(|sum| sum / total) } else { [0.0; 3] }
}

pub(crate) fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    let arm = minus(a, b);
    arm.iter().map(|part| part * part).sum::<f64>().sqrt()
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

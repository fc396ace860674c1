//! The top of the head.

use super::choice::farthest;
use super::peaks::Peak;
use super::spread::distance;
use crate::Mesh;
use crate::geodesic::Graph;

/// The vertex of the head that is farthest, straight, from the neck.
///
/// The peak of a function of distances may as well lie in an open mouth or behind an ear, where the way along the surface
/// is long. The head is what stands out there: all that hangs together with `peak` above its saddle. Where that ends, is
/// the neck.
pub(super) fn top(mesh: &Mesh, graph: &Graph, values: &[f64], peak: Peak) -> u32 {
    let mut head = vec![false; values.len()];
    let mut edge = Vec::new();
    let mut open = vec![peak.vertex];
    head[peak.vertex as usize] = true;
    while let Some(vertex) = open.pop() {
        for link in graph.links(vertex) {
            let to = link.to as usize;
            if values[to] <= peak.saddle {
                edge.push(link.to);
            } else if !head[to] {
                head[to] = true;
                open.push(link.to);
            }
        }
    }
    edge.sort_unstable();
    edge.dedup();
    if edge.is_empty() {
        return peak.vertex;
    }
    let mut neck = [0.0; 3];
    for at in edge.iter().map(|vertex| mesh.positions[*vertex as usize]) {
        for axis in 0..3 {
            neck[axis] += at[axis] / edge.len() as f64;
        }
    }
    let far: Vec<f64> = mesh.positions.iter().map(|at| distance(*at, neck)).collect();
    farthest(&far, |vertex| head[vertex as usize]).unwrap_or(peak.vertex)
}

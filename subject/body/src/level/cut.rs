//! A surface cut at many levels at once.

use super::walk::Ground;
use super::{Ring, Spans};
use crate::Mesh;
use crate::geodesic::Adjacency;

/// The rings of a function at some levels.
#[derive(Debug, Clone)]
pub struct Rings {
    /// The levels, ascending.
    pub values: Vec<f64>,
    /// The rings, those of lower levels first.
    pub rings: Vec<Ring>,
    pub(crate) spans: Spans,
}

/// `count - 1` levels that part the range of `field` evenly, algorithm 2 of (Yu et al. 2008): its ends have no rings.
#[must_use]
pub fn even_levels(field: &[f64], count: u32) -> Vec<f64> {
    let most = field.iter().copied().filter(|value| value.is_finite()).fold(0.0, f64::max);
    (1..count).map(|level| most * f64::from(level) / f64::from(count)).collect()
}

/// Cuts the surface where `field`, one value a vertex, passes `values`, by (3) of (Yu et al. 2008).
///
/// What is connected is known from the mesh's edges, not from where points lie. `values` need not be in order. A field
/// that is shorter than the mesh has vertices gives no rings.
#[must_use]
pub fn cut(mesh: &Mesh, adjacency: &Adjacency, field: &[f64], mut values: Vec<f64>) -> Rings {
    values.retain(|value| value.is_finite());
    values.sort_unstable_by(f64::total_cmp);
    values.dedup();
    let spans = Spans::new(field, &values);
    let mut rings = Vec::new();
    let fits = field.len() == mesh.positions.len()
        && adjacency.vertex_count() == field.len()
        && adjacency.triangle_edges().len() == mesh.triangles.len();
    if !fits {
        return Rings { values, rings, spans };
    }
    let mut seen = vec![0; mesh.triangles.len()];
    let crossed = spans.crossed(mesh, values.len());
    for ((level, value), triangles) in (0_u32..).zip(&values).zip(&crossed) {
        let ground = Ground { mesh, adjacency, spans: &spans, level };
        for start in triangles {
            if seen[*start as usize] == level + 1 {
                continue;
            }
            let (edges, closed) = ground.walk(*start, &mut seen);
            let points = edges.iter().map(|edge| crossing(mesh, adjacency, field, *edge, *value));
            rings.push(Ring::new(level, points.collect(), *start, closed));
        }
    }
    Rings { values, rings, spans }
}

/// Where a level crosses an edge, (3): the same point from both of its triangles.
fn crossing(mesh: &Mesh, adjacency: &Adjacency, field: &[f64], edge: u32, value: f64) -> [f64; 3] {
    let [o, p] = adjacency.edges()[edge as usize].vertices.map(|vertex| vertex as usize);
    let part = ((value - field[o]) / (field[p] - field[o])).clamp(0.0, 1.0);
    let (from, to) = (mesh.positions[o], mesh.positions[p]);
    [0, 1, 2].map(|axis| from[axis] + (to[axis] - from[axis]) * part)
}

//! Between which levels vertices, edges and triangles lie.

use crate::Mesh;

/// How many levels are at or below each vertex.
///
/// A vertex that lies on a level counts as above it, everywhere alike: so no level ever passes through a vertex, and every
/// triangle that it enters it leaves through another side.
#[derive(Debug, Clone)]
pub(crate) struct Spans {
    ranks: Vec<u32>,
}

/// The rank of a vertex that cannot be reached: no level is near it.
const UNREACHED: u32 = u32::MAX;

impl Spans {
    /// `values` in ascending order.
    pub(crate) fn new(field: &[f64], values: &[f64]) -> Self {
        let rank = |at: &f64| match at.is_finite() {
            true => values.partition_point(|value| value <= at) as u32,
            false => UNREACHED,
        };
        Self { ranks: field.iter().map(rank).collect() }
    }

    /// The band of a vertex: how many levels are at or below it.
    pub(crate) fn rank(&self, vertex: u32) -> Option<u32> {
        self.ranks.get(vertex as usize).copied().filter(|rank| *rank != UNREACHED)
    }

    /// Whether a vertex is at or above a level.
    pub(crate) fn above(&self, vertex: u32, level: u32) -> bool {
        self.ranks[vertex as usize] > level
    }

    /// The lowest and the highest band that vertices reach into; none if one of them cannot be reached.
    pub(crate) fn bands(&self, vertices: &[u32]) -> Option<[u32; 2]> {
        let ranks = || vertices.iter().map(|vertex| self.ranks[*vertex as usize]);
        let highest = ranks().max().filter(|rank| *rank != UNREACHED)?;
        Some([ranks().min()?, highest])
    }

    /// For each level the triangles that it crosses, in ascending order.
    pub(crate) fn crossed(&self, mesh: &Mesh, level_count: usize) -> Vec<Vec<u32>> {
        let mut crossed = vec![Vec::new(); level_count];
        for (triangle, corners) in (0_u32..).zip(&mesh.triangles) {
            let Some([lowest, highest]) = self.bands(corners) else { continue };
            for level in lowest..highest {
                crossed[level as usize].push(triangle);
            }
        }
        crossed
    }
}

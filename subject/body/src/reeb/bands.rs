//! The pieces of a surface between levels.

use crate::Mesh;
use crate::geodesic::{Adjacency, NONE};
use crate::level::Spans;

/// Which triangles hang together between two neighbouring levels.
///
/// A triangle that reaches over several bands has a part in each; parts of neighbours are joined where their common edge
/// reaches into the band too.
pub(super) struct Parts {
    /// Where the parts of each triangle begin, and the band of the first; none for a triangle that cannot be reached.
    starts: Vec<Option<(u32, u32)>>,
    joined: Vec<u32>,
}

impl Parts {
    pub(super) fn new(mesh: &Mesh, adjacency: &Adjacency, spans: &Spans) -> Self {
        let mut count = 0;
        let mut starts = Vec::with_capacity(mesh.triangles.len());
        for corners in &mesh.triangles {
            let bands = spans.bands(corners);
            starts.push(bands.map(|[lowest, _]| (count, lowest)));
            count += bands.map_or(0, |[lowest, highest]| highest - lowest + 1);
        }
        let mut parts = Self { starts, joined: (0..count).collect() };
        for edge in adjacency.edges() {
            let [one, other] = edge.triangles;
            let Some([lowest, highest]) = spans.bands(&edge.vertices) else { continue };
            if one == NONE || other == NONE {
                continue;
            }
            for band in lowest..=highest {
                if let (Some(a), Some(b)) = (parts.root(one, band), parts.root(other, band)) {
                    // The lower number stands for both, so that the order of edges does not show.
                    parts.joined[a.max(b) as usize] = a.min(b);
                }
            }
        }
        parts
    }

    /// What stands for the piece that `triangle` has a part of in `band`.
    pub(super) fn root(&mut self, triangle: u32, band: u32) -> Option<u32> {
        let (start, lowest) = (*self.starts.get(triangle as usize)?)?;
        let mut part = start + band.checked_sub(lowest)?;
        while *self.joined.get(part as usize)? != part {
            let next = self.joined[self.joined[part as usize] as usize];
            self.joined[part as usize] = next;
            part = next;
        }
        Some(part)
    }
}

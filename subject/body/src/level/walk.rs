//! A level followed from triangle to triangle.

use super::Spans;
use crate::Mesh;
use crate::geodesic::{Adjacency, NONE};

/// What a walk goes over.
pub(super) struct Ground<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) adjacency: &'a Adjacency,
    pub(super) spans: &'a Spans,
    pub(super) level: u32,
}

impl Ground<'_> {
    /// The edges that the level crosses on its way about the vertices above, from `start`; and whether it came back.
    ///
    /// `seen` holds for each triangle the level, plus one, that last passed it.
    pub(super) fn walk(&self, start: u32, seen: &mut [u32]) -> (Vec<u32>, bool) {
        let Some([entry, exit]) = self.sides(start) else { return (Vec::new(), false) };
        let mut crossed = vec![entry];
        seen[start as usize] = self.level + 1;
        if self.follow(start, exit, seen, &mut crossed) {
            return (crossed, true);
        }
        // It ran into a hole: what lies before the start comes before it.
        let mut before = Vec::new();
        self.follow(start, entry, seen, &mut before);
        before.reverse();
        // The entry stands in both.
        before.pop();
        before.append(&mut crossed);
        (before, false)
    }

    /// Goes on from `triangle` over `edge`, until a hole or a triangle that was passed; whether that is where it began.
    fn follow(&self, start: u32, first: u32, seen: &mut [u32], crossed: &mut Vec<u32>) -> bool {
        let (mut triangle, mut edge) = (start, first);
        loop {
            let [one, other] = self.adjacency.edges()[edge as usize].triangles;
            let next = if one == triangle { other } else { one };
            if next == start {
                return true;
            }
            crossed.push(edge);
            if next == NONE || next == triangle || seen[next as usize] == self.level + 1 {
                return false;
            }
            seen[next as usize] = self.level + 1;
            let Some([a, b]) = self.sides(next) else { return false };
            (triangle, edge) = (next, if a == edge { b } else { a });
        }
    }

    /// The two sides of a triangle that the level crosses: first the one that climbs, going round the triangle.
    fn sides(&self, triangle: u32) -> Option<[u32; 2]> {
        let corners = self.mesh.triangles.get(triangle as usize)?;
        let edges = self.adjacency.triangle_edges().get(triangle as usize)?;
        let above = corners.map(|corner| self.spans.above(corner, self.level));
        let side = |from: bool, to: bool| {
            (0..3).find(|at| above[*at] == from && above[(at + 1) % 3] == to).map(|at| edges[at])
        };
        Some([side(false, true)?, side(true, false)?])
    }
}

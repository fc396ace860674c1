//! Edges of triangles, in an order that does not depend on where anything lies in memory.

/// One side of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Edge {
    /// The lower of its vertices, and the higher.
    pub(super) ends: [u32; 2],
    /// Three times the triangle, plus which side of it: 0 from its first corner to its second.
    pub(super) side: u32,
}

/// Every side of every triangle; those of the same edge stand together.
pub(super) fn sorted(triangles: &[[u32; 3]]) -> Vec<Edge> {
    let sides = |triangle: &[u32; 3]| {
        let [a, b, c] = *triangle;
        [(a, b), (b, c), (c, a)].map(|(from, to)| [from.min(to), from.max(to)])
    };
    // By their lower vertex, each of which has a few: far quicker than to sort them all.
    let n = triangles.as_flattened().iter().max().map_or(0, |&highest| highest as usize + 1);
    let mut starts = vec![0_u32; n + 1];
    triangles.iter().flat_map(sides).for_each(|[low, _]| starts[low as usize + 1] += 1);
    for i in 1..starts.len() {
        starts[i] += starts[i - 1];
    }
    let mut fill = starts.clone();
    let mut edges = vec![Edge { ends: [0; 2], side: 0 }; 3 * triangles.len()];
    for (side, ends) in triangles.iter().flat_map(sides).enumerate() {
        let at = &mut fill[ends[0] as usize];
        edges[*at as usize] = Edge { ends, side: side as u32 };
        *at += 1;
    }
    for range in starts.windows(2) {
        edges[range[0] as usize..range[1] as usize].sort_unstable();
    }
    edges
}

/// The sides of each edge.
pub(super) fn groups(edges: &[Edge]) -> impl Iterator<Item = &[Edge]> {
    edges.chunk_by(|a, b| a.ends == b.ends)
}

/// The vertices that a side leads from and to.
pub(super) fn ends(triangles: &[[u32; 3]], side: u32) -> [u32; 2] {
    let triangle = triangles[side as usize / 3];
    let k = side as usize % 3;
    [triangle[k], triangle[(k + 1) % 3]]
}

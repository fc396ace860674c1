//! Connectivity of a triangle mesh: half-edges, compressed sparse rows and disjoint sets.

/// A directed side of a triangle.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct HalfEdge {
    /// Its two vertices, the lower index first.
    pub(crate) ends: [u32; 2],
    /// Three times the triangle's index, plus the side: 0 from the first corner to the second.
    pub(crate) index: u32,
}

/// All half-edges, sorted by their vertices: those of one edge are adjacent. The order is deterministic.
pub(crate) fn half_edges(triangles: &[[u32; 3]]) -> Vec<HalfEdge> {
    let vertex_count = triangles.as_flattened().iter().max().map_or(0, |most| *most as usize + 1);
    let all = (0..3 * triangles.len() as u32).map(|index| {
        let [from, to] = ends(triangles, index);
        let ends = [from.min(to), from.max(to)];
        (ends[0], HalfEdge { ends, index })
    });
    // Bucketed by the lower vertex, then sorted within each small bucket: far quicker than one sort.
    let SparseRows { starts, mut values } = SparseRows::new(vertex_count, all);
    for range in starts.windows(2) {
        values[range[0] as usize..range[1] as usize].sort_unstable();
    }
    values
}

/// Groups sorted half-edges by edge.
pub(crate) fn edges(half_edges: &[HalfEdge]) -> impl Iterator<Item = &[HalfEdge]> + Clone {
    half_edges.chunk_by(|a, b| a.ends == b.ends)
}

/// The vertices from which and to which half-edge `side` leads.
pub(crate) fn ends(triangles: &[[u32; 3]], side: u32) -> [u32; 2] {
    let triangle = triangles[side as usize / 3];
    let k = side as usize % 3;
    [triangle[k], triangle[(k + 1) % 3]]
}

/// Several values per row in compressed sparse row format.
#[derive(Debug, Clone)]
pub(crate) struct SparseRows<T> {
    starts: Vec<u32>,
    values: Vec<T>,
}

impl<T: Copy + Default> SparseRows<T> {
    /// Distributes `(row, value)` pairs over `count` rows, keeping their order.
    pub(crate) fn new(count: usize, values: impl Iterator<Item = (u32, T)> + Clone) -> Self {
        let mut starts = vec![0_u32; count + 1];
        values.clone().for_each(|(row, _)| starts[row as usize + 1] += 1);
        for row in 0..count {
            starts[row + 1] += starts[row];
        }
        let mut next = starts.clone();
        let mut placed = vec![T::default(); starts[count] as usize];
        values.for_each(|(row, value)| {
            let at = &mut next[row as usize];
            placed[*at as usize] = value;
            *at += 1;
        });
        Self { starts, values: placed }
    }

    pub(crate) fn count(&self) -> usize {
        self.starts.len() - 1
    }

    /// The values of a row; empty if there is no such row.
    pub(crate) fn row(&self, index: u32) -> &[T] {
        let range = self.starts.get(index as usize..=index as usize + 1);
        let Some(&[start, end]) = range else { return &[] };
        &self.values[start as usize..end as usize]
    }
}

/// The representative of the set of `at` in a disjoint-set forest, with path halving.
pub(crate) fn find_root(parents: &mut [u32], mut at: u32) -> u32 {
    while parents[at as usize] != at {
        let next = parents[parents[at as usize] as usize];
        parents[at as usize] = next;
        at = next;
    }
    at
}

/// Merges two sets. The lower index becomes the representative, so the result does not depend on the order of merging.
pub(crate) fn union(parents: &mut [u32], one: u32, other: u32) {
    let (one, other) = (find_root(parents, one), find_root(parents, other));
    parents[one.max(other) as usize] = one.min(other);
}

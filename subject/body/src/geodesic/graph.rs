//! Graphs upon a mesh, whose shortest paths stand for geodesics.

use super::{Adjacency, NONE, unfold};
use crate::Mesh;

/// A way from one vertex to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Link {
    /// Where it leads.
    pub to: u32,
    /// Its length, in the mesh's unit.
    pub length: f64,
}

/// Vertices and the ways between them, in compressed rows: the links of a vertex lie side by side.
#[derive(Debug, Clone)]
pub struct Graph {
    starts: Vec<u32>,
    links: Vec<Link>,
}

impl Graph {
    /// Edges alone: the g of (Yu et al. 2008, section 2).
    #[must_use]
    pub fn along_edges(mesh: &Mesh, adjacency: &Adjacency) -> Self {
        let edges = adjacency.edges().iter();
        let ways = edges.map(|edge| (edge.vertices, length(mesh, edge.vertices))).collect();
        Self::new(adjacency.vertex_count(), ways)
    }

    /// Edges, and the straight way across each edge from the corner opposite to it on one side to the one on the other, as
    /// long as it is when both triangles are laid into one plane.
    #[must_use]
    pub fn with_short_cuts(mesh: &Mesh, adjacency: &Adjacency) -> Self {
        let mut ways = Vec::with_capacity(2 * adjacency.edges().len());
        for edge in adjacency.edges() {
            ways.push((edge.vertices, length(mesh, edge.vertices)));
            let [one, other] = edge.triangles;
            if one == NONE || other == NONE {
                continue;
            }
            let ends = opposite(mesh, one, edge.vertices).zip(opposite(mesh, other, edge.vertices));
            let Some((from, to)) = ends else { continue };
            let at = |vertex: u32| mesh.positions[vertex as usize];
            let [a, b] = edge.vertices;
            if let Some(length) = unfold::across([at(a), at(b)], at(from), at(to)) {
                ways.push(([from, to], length));
            }
        }
        Self::new(adjacency.vertex_count(), ways)
    }

    /// A graph of any ways, each of which leads both there and back.
    pub(crate) fn new(vertex_count: usize, ways: Vec<([u32; 2], f64)>) -> Self {
        let mut starts = vec![0_u32; vertex_count + 1];
        for end in ways.iter().flat_map(|(ends, _)| ends) {
            starts[*end as usize + 1] += 1;
        }
        for vertex in 0..vertex_count {
            starts[vertex + 1] += starts[vertex];
        }
        let mut filled = starts.clone();
        let mut links = vec![Link { to: 0, length: 0.0 }; 2 * ways.len()];
        for ([a, b], length) in ways {
            for (from, to) in [(a, b), (b, a)] {
                links[filled[from as usize] as usize] = Link { to, length };
                filled[from as usize] += 1;
            }
        }
        Self { starts, links }
    }

    /// How many vertices there are.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.starts.len() - 1
    }

    /// The ways out of `vertex`; none if there is no such vertex.
    #[must_use]
    pub fn links(&self, vertex: u32) -> &[Link] {
        let row = self.starts.get(vertex as usize..=vertex as usize + 1);
        let Some(&[start, end]) = row else { return &[] };
        &self.links[start as usize..end as usize]
    }
}

fn length(mesh: &Mesh, [a, b]: [u32; 2]) -> f64 {
    let (a, b) = (mesh.positions[a as usize], mesh.positions[b as usize]);
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

/// The corner of `triangle` that is not on the edge; none if the triangle names a vertex twice.
fn opposite(mesh: &Mesh, triangle: u32, edge: [u32; 2]) -> Option<u32> {
    mesh.triangles[triangle as usize].into_iter().find(|corner| !edge.contains(corner))
}

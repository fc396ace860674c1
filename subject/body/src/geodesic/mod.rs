//! Geodesic distances: mesh connectivity, graphs on a mesh, and shortest paths in them.
//!
//! There are two metrics. [`Graph::along_edges`] is that of (Yu et al. 2008, section 2): paths along edges, 3 to 6 %
//! too long by an amount that depends on the triangulation. [`Graph::with_short_cuts`] also crosses edges straight from
//! one triangle into the next, which removes most of that error.

#[cfg(test)]
mod tests;

use std::{cmp::Reverse, collections::BinaryHeap};

use crate::{
    Mesh, Refusal,
    mesh::{self, Point, SparseRows, distance, half_edges},
};

/// No triangle: the other side of a border edge.
pub const NONE: u32 = u32::MAX;

/// An edge and up to two of its triangles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Edge {
    /// Its vertices, the smaller index first.
    pub vertices: [u32; 2],
    /// The triangles on its sides, or [`NONE`]. Of more than two, the first two.
    pub triangles: [u32; 2],
}

/// The edges of a mesh, and the edges of each triangle.
///
/// Edges are sorted by their vertices, so the order of the triangles does not matter.
#[derive(Debug, Clone)]
pub struct Adjacency {
    vertex_count: usize,
    edges: Vec<Edge>,
    triangle_edges: Vec<[u32; 3]>,
}

impl Adjacency {
    /// Finds the edges of `mesh` in linear time.
    ///
    /// # Errors
    ///
    /// [`Refusal::BrokenMesh`]: a triangle names a missing vertex, or a position is not finite.
    pub fn new(mesh: &Mesh) -> Result<Self, Refusal> {
        check(mesh)?;
        let mut edges: Vec<Edge> = Vec::with_capacity(mesh.triangles.len() * 3 / 2);
        let mut triangle_edges = vec![[0; 3]; mesh.triangles.len()];
        let all = half_edges(&mesh.triangles);
        for half_edges in mesh::edges(&all) {
            let mut triangles = [NONE; 2];
            for (triangle, side) in triangles.iter_mut().zip(half_edges) {
                *triangle = side.index / 3;
            }
            for side in half_edges {
                triangle_edges[side.index as usize / 3][side.index as usize % 3] =
                    edges.len() as u32;
            }
            edges.push(Edge { vertices: half_edges[0].ends, triangles });
        }
        let vertex_count = mesh.positions.len();
        Ok(Self { vertex_count, edges, triangle_edges })
    }

    /// Number of vertices of the mesh.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.vertex_count
    }

    /// All edges, each once.
    #[must_use]
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// For each triangle `[a, b, c]`, the edges `[ab, bc, ca]` as indices into [`Self::edges`].
    #[must_use]
    pub fn triangle_edges(&self) -> &[[u32; 3]] {
        &self.triangle_edges
    }

    /// Number of handles of a closed surface.
    pub(crate) fn handles(&self) -> usize {
        usize::try_from((2 - self.euler_characteristic()) / 2).unwrap_or(0)
    }

    /// Used vertices - edges + triangles: 2 - 2g for a closed surface with g handles.
    #[must_use]
    pub fn euler_characteristic(&self) -> i64 {
        let mut used = vec![false; self.vertex_count];
        for edge in &self.edges {
            used[edge.vertices[0] as usize] = true;
            used[edge.vertices[1] as usize] = true;
        }
        let vertices = used.iter().filter(|used| **used).count();
        vertices as i64 - self.edges.len() as i64 + self.triangle_edges.len() as i64
    }
}

fn check(mesh: &Mesh) -> Result<(), Refusal> {
    // Indices are u32, and three sides a triangle are counted in u32.
    let countable = |count: usize| u32::try_from(count).is_ok_and(|count| count < NONE / 3);
    if !countable(mesh.positions.len()) || !countable(mesh.triangles.len()) {
        return Err(Refusal::BrokenMesh { what: "too many vertices or triangles" });
    }
    if !mesh.positions.iter().flatten().all(|value| value.is_finite()) {
        return Err(Refusal::BrokenMesh { what: "a position that is not a finite number" });
    }
    let count = mesh.positions.len() as u32;
    if !mesh.triangles.iter().flatten().all(|vertex| *vertex < count) {
        return Err(Refusal::BrokenMesh { what: "a triangle with a missing vertex" });
    }
    if mesh.triangles.is_empty() {
        return Err(Refusal::BrokenMesh { what: "no triangle" });
    }
    Ok(())
}

/// A directed link of a graph.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Link {
    /// Target vertex.
    pub to: u32,
    /// Length, in the mesh's unit.
    pub length: f64,
}

/// An undirected edge of a graph.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GraphEdge {
    pub(crate) ends: [u32; 2],
    pub(crate) length: f64,
}

impl GraphEdge {
    /// The mesh edge itself.
    fn along(mesh: &Mesh, edge: &Edge) -> Self {
        let [a, b] = edge.vertices.map(|vertex| mesh.point(vertex));
        Self { ends: edge.vertices, length: distance(a, b) }
    }
}

/// A weighted graph on the vertices of a mesh.
#[derive(Debug, Clone)]
pub struct Graph(SparseRows<Link>);

impl Graph {
    /// Mesh edges only: the distance g of (Yu et al. 2008, section 2).
    #[must_use]
    pub fn along_edges(mesh: &Mesh, adjacency: &Adjacency) -> Self {
        let edges = adjacency.edges().iter().map(|edge| GraphEdge::along(mesh, edge));
        Self::new(adjacency.vertex_count(), edges)
    }

    /// Mesh edges, and across each edge the straight segment between the two opposite corners, with both triangles
    /// unfolded into one plane.
    #[must_use]
    pub fn with_short_cuts(mesh: &Mesh, adjacency: &Adjacency) -> Self {
        let mut edges = Vec::with_capacity(2 * adjacency.edges().len());
        for edge in adjacency.edges() {
            edges.push(GraphEdge::along(mesh, edge));
            let [one, other] = edge.triangles;
            if one == NONE || other == NONE {
                continue;
            }
            let ends = opposite(mesh, one, edge.vertices).zip(opposite(mesh, other, edge.vertices));
            let Some((from, to)) = ends else { continue };
            let edge = edge.vertices.map(|vertex| mesh.point(vertex));
            if let Some(length) = across(edge, mesh.point(from), mesh.point(to)) {
                edges.push(GraphEdge { ends: [from, to], length });
            }
        }
        Self::new(adjacency.vertex_count(), edges.into_iter())
    }

    /// A graph of arbitrary edges.
    pub(crate) fn new(vertex_count: usize, edges: impl Iterator<Item = GraphEdge> + Clone) -> Self {
        let there_and_back = |GraphEdge { ends: [a, b], length }| {
            [(a, Link { to: b, length }), (b, Link { to: a, length })]
        };
        Self(SparseRows::new(vertex_count, edges.flat_map(there_and_back)))
    }

    /// Number of vertices.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.0.count()
    }

    /// The links of `vertex`; none if there is no such vertex.
    #[must_use]
    pub fn links(&self, vertex: u32) -> &[Link] {
        self.0.row(vertex)
    }
}

/// The corner of `triangle` that is not on the edge; none if the triangle is degenerate.
fn opposite(mesh: &Mesh, triangle: u32, edge: [u32; 2]) -> Option<u32> {
    mesh.triangles[triangle as usize].into_iter().find(|corner| !edge.contains(corner))
}

/// Length of the straight segment from `from` to `to` across the edge that their triangles share, unfolded into one
/// plane. None if it would leave the two triangles, since a path along edges is then as short.
///
/// In the frame of the edge each corner has an offset along it and a height above it. Unfolded, the heights point to
/// opposite sides, so they add.
fn across([a, b]: [Point; 2], from: Point, to: Point) -> Option<f64> {
    let axis = b - a;
    let edge = axis.norm();
    if edge <= 0.0 {
        return None;
    }
    let corner = |point: Point| {
        let arm = point - a;
        let along = arm.dot(&axis) / edge;
        (along, (arm.norm_squared() - along * along).max(0.0).sqrt())
    };
    let ((x_from, y_from), (x_to, y_to)) = (corner(from), corner(to));
    let height = y_from + y_to;
    if height <= 0.0 {
        return None;
    }
    let crossing = x_from + (x_to - x_from) * y_from / height;
    let inside = crossing > 0.0 && crossing < edge;
    inside.then(|| (x_to - x_from).hypot(height))
}

/// Maximum number of sweeps over all vertices before Dijkstra's method takes over, whose time is bounded. Bodies need
/// about ten.
const SWEEPS_MAX: usize = 48;
/// Mean number of visits per vertex in the sweeps, at most. Bodies need 1.3 to 1.7.
const VISITS_MAX: usize = 4;

/// State that runs reuse, so that a dozen sources cost little more than their links.
///
/// Any graph may follow any other: the workspace affects only the time of a run, never its result.
#[derive(Debug, Clone, Default)]
pub struct Workspace {
    // Distances are never negative, and the bits of such numbers are in the order of the numbers.
    heap: Heap,
    /// Every vertex once, in the order in which the first run reached them.
    order: Vec<u32>,
    /// Vertices that came nearer since their links were last followed.
    active: Vec<bool>,
}

/// Vertices by distance, the nearest first.
type Heap = BinaryHeap<Reverse<(u64, u32)>>;

/// The length of the shortest path from `source` to every vertex, in the mesh's unit; infinite if there is none.
#[must_use]
pub fn distances(graph: &Graph, source: u32, workspace: &mut Workspace) -> Vec<f64> {
    distances_from(graph, [(source, 0.0)], workspace)
}

/// The least distance from several sources, each with an initial length.
///
/// A source that is not a vertex is ignored.
#[must_use]
pub fn distances_from(
    graph: &Graph,
    sources: impl IntoIterator<Item = (u32, f64)>,
    workspace: &mut Workspace,
) -> Vec<f64> {
    let count = graph.vertex_count();
    let mut found = vec![f64::INFINITY; count];
    let Workspace { heap, order, active } = workspace;
    active.clear();
    active.resize(count, false);
    for (source, start) in sources {
        if let Some(best) = found.get_mut(source as usize).filter(|best| start < **best) {
            *best = start;
            active[source as usize] = true;
        }
    }
    let known = order.len() == count;
    if !(known && sweep(graph, order, &mut found, active)) {
        let nearer = (0_u32..).zip(&found).filter(|(vertex, _)| active[*vertex as usize]);
        heap.clear();
        heap.extend(nearer.map(|(vertex, far)| Reverse((far.to_bits(), vertex))));
        let reached = dijkstra(graph, heap, &mut found);
        order.clear();
        // An order that did not help is dropped: the next run starts without one.
        if !known {
            let unreached = (0_u32..).zip(&found).filter(|(_, far)| far.is_infinite());
            order.extend(reached.into_iter().chain(unreached.map(|(vertex, _)| vertex)));
        }
    }
    found
}

/// Dijkstra's method from the vertices in the heap. Returns the vertices in the order in which they were reached.
fn dijkstra(graph: &Graph, heap: &mut Heap, found: &mut [f64]) -> Vec<u32> {
    let mut reached = Vec::with_capacity(found.len());
    while let Some(Reverse((bits, vertex))) = heap.pop() {
        let here = f64::from_bits(bits);
        if here > found[vertex as usize] {
            continue;
        }
        reached.push(vertex);
        for link in graph.links(vertex) {
            let there = here + link.length;
            let best = &mut found[link.to as usize];
            if there < *best {
                *best = there;
                heap.push(Reverse((there.to_bits(), link.to)));
            }
        }
    }
    reached
}

/// Relaxes links in alternating sweeps over an `order` computed for another source, until nothing changes; false if
/// that takes too many sweeps.
///
/// Limbs are tubes, and along each the order for any source is this one or its reverse. Most vertices are final when
/// visited, without a heap or a branch. The distances are the least sums along paths, equal to those of Dijkstra's
/// method to the last bit.
fn sweep(graph: &Graph, order: &[u32], found: &mut [f64], active: &mut [bool]) -> bool {
    let mut left = VISITS_MAX * order.len();
    for pass in 0..SWEEPS_MAX {
        let before = left;
        for index in 0..order.len() {
            let vertex = order[if pass % 2 == 0 { index } else { order.len() - 1 - index }];
            if !std::mem::replace(&mut active[vertex as usize], false) {
                continue;
            }
            let Some(rest) = left.checked_sub(1) else {
                active[vertex as usize] = true;
                return false;
            };
            left = rest;
            let here = found[vertex as usize];
            for link in graph.links(vertex) {
                let to = link.to as usize;
                let (there, best) = (here + link.length, found[to]);
                let nearer = there < best;
                found[to] = if nearer { there } else { best };
                active[to] |= nearer;
            }
        }
        if left == before {
            return true;
        }
    }
    false
}

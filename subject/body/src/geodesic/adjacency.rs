//! Which triangles share an edge.

use crate::{Mesh, Refusal};

/// Stands for no triangle: the other side of an edge of a hole.
pub const NONE: u32 = u32::MAX;

/// An edge, with up to two of its triangles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Edge {
    /// Its ends, the smaller index first.
    pub vertices: [u32; 2],
    /// The triangles on its sides, or [`NONE`]. Of an edge with more than two, the first two.
    pub triangles: [u32; 2],
}

/// The edges of a mesh, and which triangle has which.
///
/// Edges stand in the order of their ends' indices, so that nothing depends on the order of the triangles.
#[derive(Debug, Clone)]
pub struct Adjacency {
    vertex_count: usize,
    edges: Vec<Edge>,
    triangle_edges: Vec<[u32; 3]>,
}

/// One side of a triangle: its other end, and where it stands.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Side {
    far: u32,
    triangle: u32,
    corner: u8,
}

impl Adjacency {
    /// Finds the edges of `mesh`, in time proportional to its size.
    ///
    /// # Errors
    ///
    /// [`Refusal::BrokenMesh`]: a triangle names a vertex that is not there, or a position is not a finite number.
    pub fn new(mesh: &Mesh) -> Result<Self, Refusal> {
        check(mesh)?;
        let vertex_count = mesh.positions.len();
        let mut starts = vec![0_u32; vertex_count + 1];
        for [low, _] in mesh.triangles.iter().flat_map(sides) {
            starts[low as usize + 1] += 1;
        }
        for vertex in 0..vertex_count {
            starts[vertex + 1] += starts[vertex];
        }
        let mut filled = starts.clone();
        let mut bucket = vec![Side { far: 0, triangle: 0, corner: 0 }; 3 * mesh.triangles.len()];
        for (triangle, corners) in (0_u32..).zip(&mesh.triangles) {
            for (corner, [low, far]) in (0_u8..).zip(sides(corners)) {
                bucket[filled[low as usize] as usize] = Side { far, triangle, corner };
                filled[low as usize] += 1;
            }
        }
        let mut edges: Vec<Edge> = Vec::with_capacity(mesh.triangles.len() * 3 / 2);
        let mut triangle_edges = vec![[0; 3]; mesh.triangles.len()];
        for low in 0..vertex_count {
            let sides = &mut bucket[starts[low] as usize..starts[low + 1] as usize];
            sides.sort_unstable();
            let mut before = None;
            for side in sides {
                if before != Some(side.far) {
                    edges.push(Edge { vertices: [low as u32, side.far], triangles: [NONE; 2] });
                    before = Some(side.far);
                }
                let id = edges.len() - 1;
                let room = edges[id].triangles.iter_mut().find(|triangle| **triangle == NONE);
                if let Some(room) = room {
                    *room = side.triangle;
                }
                triangle_edges[side.triangle as usize][usize::from(side.corner)] = id as u32;
            }
        }
        Ok(Self { vertex_count, edges, triangle_edges })
    }

    /// How many vertices the mesh has.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.vertex_count
    }

    /// All edges, each once.
    #[must_use]
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// For each triangle `[a, b, c]` the edges `[ab, bc, ca]`, as indices into [`Self::edges`].
    #[must_use]
    pub fn triangle_edges(&self) -> &[[u32; 3]] {
        &self.triangle_edges
    }

    /// Vertices that a triangle uses - edges + triangles: 2 for a closed surface without handles, 2 - 2g with g of them.
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

/// The sides ab, bc, ca of a triangle, each with the smaller index first.
fn sides(&[a, b, c]: &[u32; 3]) -> [[u32; 2]; 3] {
    [[a.min(b), a.max(b)], [b.min(c), b.max(c)], [c.min(a), c.max(a)]]
}

fn check(mesh: &Mesh) -> Result<(), Refusal> {
    // Indices are u32, and three sides a triangle are counted in u32.
    let countable = |count: usize| u32::try_from(count).is_ok_and(|count| count < NONE / 3);
    if !countable(mesh.positions.len()) || !countable(mesh.triangles.len()) {
        return Err(Refusal::BrokenMesh { what: "more vertices or triangles than can be counted" });
    }
    if !mesh.positions.iter().flatten().all(|value| value.is_finite()) {
        return Err(Refusal::BrokenMesh { what: "a position that is not a finite number" });
    }
    let count = mesh.positions.len() as u32;
    if !mesh.triangles.iter().flatten().all(|vertex| *vertex < count) {
        return Err(Refusal::BrokenMesh { what: "a triangle of a vertex that is not there" });
    }
    if mesh.triangles.is_empty() {
        return Err(Refusal::BrokenMesh { what: "no triangle" });
    }
    Ok(())
}

//! Distances along the surface: the connectivity of a mesh, graphs upon it, and shortest paths in them.
//!
//! Two metrics. [`Graph::along_edges`] is that of the paper (Yu et al. 2008, section 2): Dijkstra along edges, which
//! overestimates by 3 to 6 %, and by what, depends on how the surface is cut into triangles. [`Graph::with_short_cuts`]
//! may also cross an edge straight from one triangle into the next, which takes most of that error away.

mod dijkstra;
mod graph;
#[cfg(test)]
mod tests;

pub use dijkstra::{Workspace, distances, distances_from};
pub(crate) use graph::GraphEdge;
pub use graph::{Adjacency, Edge, Graph, Link, NONE};

//! Geodesic distances: mesh connectivity, graphs on a mesh, and shortest paths in them.
//!
//! There are two metrics. [`Graph::along_edges`] is that of (Yu et al. 2008, section 2): paths along edges, 3 to 6 %
//! too long by an amount that depends on the triangulation. [`Graph::with_short_cuts`] also crosses edges straight from
//! one triangle into the next, which removes most of that error.

mod dijkstra;
mod graph;
#[cfg(test)]
mod tests;

pub use dijkstra::{Workspace, distances, distances_from};
pub(crate) use graph::GraphEdge;
pub use graph::{Adjacency, Edge, Graph, Link, NONE};

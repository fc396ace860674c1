//! What a picture shows of a body's shape: level sets of the distance from the head, and how they hang together.

use super::Mesh;
use super::extremity::Extremities;
use super::geodesic::{Adjacency, Graph, Workspace, distances};
use super::level::{Rings, cut, even_levels};
use super::paper::{LEVEL_COUNT, Paper};
use super::reeb::{Reeb, Segments};

/// Level sets and Reeb graph of the distance from the head (Yu et al. 2008, section 6), and which of them are limbs.
#[derive(Debug, Clone)]
pub struct Levels {
    /// The rings.
    pub rings: Rings,
    /// How they hang together.
    pub reeb: Reeb,
    /// Trunk, arms and legs.
    pub segments: Segments,
}

impl From<Paper> for Levels {
    fn from(paper: Paper) -> Self {
        let Paper { rings, reeb, segments, .. } = paper;
        Self { rings, reeb, segments }
    }
}

impl Levels {
    /// Those of a mesh whose ends are known. Where the graph has not the five segments of a body, because limbs touch, a
    /// limb is what lies within its length of its end. Nothing if the mesh is no surface.
    #[must_use]
    pub fn new(mesh: &Mesh, extremities: &Extremities) -> Option<Self> {
        let adjacency = Adjacency::new(mesh).ok()?;
        let graph = Graph::along_edges(mesh, &adjacency);
        let mut workspace = Workspace::default();
        let field = distances(&graph, extremities.head, &mut workspace);
        let rings = cut(mesh, &adjacency, &field, even_levels(&field, LEVEL_COUNT));
        let [_, tips @ ..] = extremities.all();
        let reeb = Reeb::new(mesh, &adjacency, &rings, &tips);
        let segments = Segments::new(&reeb, &rings).unwrap_or_else(|_| {
            let fields = tips.map(|tip| distances(&graph, tip, &mut workspace));
            Segments::within_reach(mesh, &reeb, &rings, extremities, &fields)
        });
        Some(Self { rings, reeb, segments })
    }
}

//! One scan, from a clean surface to joints: the methods in the order in which they are tried.

use super::extremity::{self, Extremities, Told};
use super::geodesic::{Adjacency, Graph, Workspace};
use super::locate::{Landmarks, joints, settle};
use super::paper::{self, Paper};
use super::skeleton::Method;
use super::{Joints, Mesh, Refusal};

/// What a scan gives.
#[derive(Debug, Clone)]
pub struct Survey {
    /// The joints, in the mesh's frame and unit.
    pub joints: Joints,
    /// Head, hands and feet.
    pub extremities: Extremities,
    /// How sure the ends are told apart, from 0 to 1; 1 where nobody asked.
    pub confidence: f64,
    /// Whether limbs touch, so that ways along the surface may lead from one into another.
    pub in_contact: bool,
    /// Level sets and Reeb graph of the distance from the head (Yu et al. 2008), where the surface has those of a body.
    pub levels: Option<Paper>,
}

impl Survey {
    /// Finds the joints of a body on a closed surface of one piece.
    ///
    /// # Errors
    /// [`Refusal`], with what to do: what cannot be told with confidence is refused, and never guessed.
    pub fn new(mesh: &Mesh, method: Method) -> Result<Self, Refusal> {
        match method {
            Method::Default => Self::by_default(mesh),
            Method::Paper => Self::by_paper(mesh),
        }
    }

    fn by_default(mesh: &Mesh) -> Result<Self, Refusal> {
        let adjacency = Adjacency::new(mesh)?;
        let graph = Graph::with_short_cuts(mesh, &adjacency);
        let mut workspace = Workspace::default();
        let ends = extremity::find(mesh, &graph, &mut workspace)?;
        let (extremities, confidence) = (ends.extremities, ends.confidence());
        let settled = settle(&graph, &extremities, ends.fields, &ends.spread, &mut workspace);
        // An end that nobody reaches, ways that contradict each other, or a limb without a middle: the surface is joined where
        // a body is not.
        let landmarks =
            Landmarks::new(mesh, &settled.fields()).ok_or(Refusal::Contact { handles: 0 })?;
        let in_contact = ends.told != Told::Freely || landmarks.touching.any();
        Ok(Self { joints: joints(&landmarks), extremities, confidence, in_contact, levels: None })
    }

    fn by_paper(mesh: &Mesh) -> Result<Self, Refusal> {
        let adjacency = Adjacency::new(mesh)?;
        let graph = Graph::along_edges(mesh, &adjacency);
        let start = extremity::start(mesh, &graph).ok_or(Refusal::TooFewEnds { found: 0 })?;
        let paper = paper::joints(mesh, start, None)?;
        Ok(Self {
            joints: paper.joints.clone(),
            extremities: paper.extremities,
            confidence: 1.0,
            in_contact: false,
            levels: Some(paper),
        })
    }

    /// Level sets and Reeb graph for a picture, where the method has none of its own; `mesh` is the one that was surveyed.
    #[must_use]
    pub fn with_levels(mut self, mesh: &Mesh) -> Self {
        if self.levels.is_none() {
            self.levels = paper::joints(mesh, self.extremities.head, Some(self.extremities)).ok();
        }
        self
    }
}

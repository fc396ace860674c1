//! Why the published method gives nothing, where that is not the scan's fault.

use super::joints::ends;
use crate::extremity::Extremities;
use crate::geodesic::{Adjacency, Graph, Workspace};
use crate::geometry::distance;
use crate::{Mesh, Refusal};

/// What the ends of a body are of, in the order of [`Extremities::all`].
const OF: [&str; 5] = ["a head", "a hand", "a hand", "a foot", "a foot"];

/// The method's own reason for a `refusal` of [`joints`](super::joints()) from `start` on, of a body with its limbs free
/// whose ends are `known`.
pub(crate) fn reason(
    mesh: &Mesh,
    adjacency: &Adjacency,
    start: u32,
    refusal: Refusal,
    known: &Extremities,
) -> Refusal {
    match refusal {
        Refusal::TooFewEnds { found } => Refusal::PaperEnds { found },
        Refusal::Contact { .. } => {
            let graph = Graph::along_edges(mesh, adjacency);
            let taken = ends(&graph, start, &mut Workspace::default()).ok();
            match taken.and_then(|taken| nearest(mesh, taken.head, known)) {
                None | Some(0) => Refusal::PaperParts,
                Some(end) => Refusal::PaperHead { taken: OF.get(end).copied().unwrap_or("a limb") },
            }
        }
        other => other,
    }
}

/// Which of the ends a vertex is nearest to.
fn nearest(mesh: &Mesh, vertex: u32, ends: &Extremities) -> Option<usize> {
    let at = |vertex: u32| mesh.positions.get(vertex as usize).copied();
    let from = at(vertex)?;
    let far = |end: u32| at(end).map_or(f64::INFINITY, |to| distance(from, to));
    let ends = ends.all().map(far);
    ends.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1)).map(|(end, _)| end)
}

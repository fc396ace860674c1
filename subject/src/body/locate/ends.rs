//! The five ends, brought to where they are on every body.

use super::{FOOT, Fields, HEAD};
use crate::body::extremity::Extremities;
use crate::body::geodesic::{Graph, Workspace, distances, distances_from};

/// An end moves at most this share of the way between the feet: within a hand or a foot, never past a wrist.
const REACH: f64 = 0.15;
/// The crown is looked for nearer: from a chin the ways are about as long.
const CROWN_REACH: f64 = 0.09;

/// The five ends of a body, with the distances from each.
#[derive(Debug, Clone)]
pub struct Settled {
    /// The vertex at each end: head, hands, feet.
    pub vertices: [u32; 5],
    /// One distance a vertex for each end, in the mesh's unit; for the head from all of its top.
    pub distances: [Vec<f64>; 5],
}

impl Settled {
    /// As the landmarks take them.
    #[must_use]
    pub fn fields(&self) -> Fields<'_> {
        Fields { ends: self.vertices, distances: self.distances.each_ref().map(Vec::as_slice) }
    }
}

/// Moves each end to the vertex near it that is farthest from the four others together, and the head's to all of its top.
///
/// A thumb becomes a fingertip and a heel a toe, whichever of them the search for ends came upon. `distances_from_ends` are
/// those from [`Extremities::all`]; they are measured again only for an end that moves.
#[must_use]
pub fn settle(
    graph: &Graph,
    extremities: &Extremities,
    distances_from_ends: [Vec<f64>; 5],
    workspace: &mut Workspace,
) -> Settled {
    let mut settled = Settled { vertices: extremities.all(), distances: distances_from_ends };
    let moved = farthest(&settled.fields());
    let crown = crown(&settled.fields(), moved[HEAD]);
    for (end, to) in moved.into_iter().enumerate() {
        if end == HEAD {
            settled.distances[end] = distances_from(graph, crown.iter().copied(), workspace);
        } else if to != settled.vertices[end] {
            settled.distances[end] = distances(graph, to, workspace);
        }
        settled.vertices[end] = to;
    }
    settled
}

/// The vertices of the head's top, each with how much less far from the limbs it is than `top`. The top is flat: which of
/// its vertices is the farthest changes with the triangles, and all of it together does not.
fn crown(fields: &Fields<'_>, top: u32) -> Vec<(u32, f64)> {
    let limbs = |at: u32| (1..5).map(|end| fields.at(end, at as usize)).sum::<f64>() / 4.0;
    let reach = fields.between(FOOT[0], FOOT[1]).unwrap_or(0.0) * CROWN_REACH;
    let near = (0_u32..).zip(fields.distances[HEAD]).filter(|(_, way)| **way < reach);
    let sources = near.map(|(at, _)| (at, limbs(top) - limbs(at)));
    let mut crown: Vec<(u32, f64)> = sources.filter(|(_, start)| *start >= 0.0).collect();
    crown.push((top, 0.0));
    crown
}

fn farthest(fields: &Fields<'_>) -> [u32; 5] {
    let mut found = fields.ends;
    let Some(feet) = fields.between(FOOT[0], FOOT[1]) else { return found };
    for (end, vertex) in found.iter_mut().enumerate() {
        let reach = feet * if end == HEAD { CROWN_REACH } else { REACH };
        let others = |at: u32| {
            (0..5)
                .filter(|other| *other != end)
                .map(|other| fields.at(other, at as usize))
                .sum::<f64>()
        };
        let near = (0_u32..).zip(fields.distances[end]).filter(|(_, way)| **way < reach);
        let ways = near.map(|(at, _)| (others(at), at)).filter(|(way, _)| way.is_finite());
        // Of equals the one with the lowest index: the same on every machine.
        let best = ways.max_by(|one, other| one.0.total_cmp(&other.0).then(other.1.cmp(&one.1)));
        *vertex = best.map_or(*vertex, |(_, at)| at);
    }
    found
}

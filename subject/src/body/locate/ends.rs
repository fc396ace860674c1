//! The five ends, brought to where they are on every body.

use super::{FOOT, Fields, HEAD};
use crate::body::extremity::Extremities;
use crate::body::geodesic::{Graph, Workspace, distances, distances_from};

/// An end moves at most this share of the way between the feet: within a hand or a foot, never past a wrist.
const REACH: f64 = 0.15;

/// The top of the head is no farther than this from the vertex that stands for the head, in the same share.
const HEAD_REACH: f64 = 0.14;
/// Of the top is what is nearer to the limbs by less than this.
const CROWN: f64 = 0.03;

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
        Fields {
            ends: self.vertices,
            distances: self.distances.each_ref().map(Vec::as_slice),
            missing: [0.0; 5],
        }
    }
}

/// Moves each end to the vertex near it that is farthest from the four others together. The head's becomes
/// all of its top, which is flat: the farthest vertex of it changes with the triangles.
///
/// A thumb becomes a fingertip and a heel a toe, whichever of them the search for ends came upon. `distances_from_ends` are
/// those from [`Extremities::all`]; they are measured again only for an end that moves, and then only if where it moves
/// is not among `known`: vertices with the distances from them.
#[must_use]
pub fn settle(
    graph: &Graph,
    extremities: &Extremities,
    distances_from_ends: [Vec<f64>; 5],
    known: &[(u32, Vec<f64>)],
    workspace: &mut Workspace,
) -> Settled {
    let mut settled = Settled { vertices: extremities.all(), distances: distances_from_ends };
    let moved = farthest(&settled.fields());
    let crown = crown(&settled.fields());
    for (end, to) in moved.into_iter().enumerate() {
        if end == HEAD && !crown.is_empty() {
            settled.distances[end] = distances_from(graph, crown.iter().copied(), workspace);
        } else if to != settled.vertices[end] {
            settled.vertices[end] = to;
            let known = known.iter().find(|(vertex, _)| *vertex == to);
            settled.distances[end] = match known {
                Some((_, field)) => field.clone(),
                None => distances(graph, to, workspace),
            };
        }
    }
    settled
}

/// The vertices of the head's top, each with how much less far from the limbs it is than the farthest. The distances from
/// there go on with no step from how far the limbs are, so that it hardly matters which vertices are taken.
fn crown(fields: &Fields<'_>) -> Vec<(u32, f64)> {
    let Some(feet) = fields.between(FOOT[0], FOOT[1]) else { return Vec::new() };
    let limbs = |at: u32| (1..5).map(|end| fields.at(end, at as usize)).sum::<f64>() / 4.0;
    let near =
        || (0_u32..).zip(fields.distances[HEAD]).filter(|(_, way)| **way < HEAD_REACH * feet);
    let most = near().map(|(at, _)| limbs(at)).fold(0.0, f64::max);
    let starts = near().map(|(at, _)| (at, most - limbs(at)));
    starts.filter(|(_, start)| *start < CROWN * feet).collect()
}

fn farthest(fields: &Fields<'_>) -> [u32; 5] {
    let mut found = fields.ends;
    let Some(feet) = fields.between(FOOT[0], FOOT[1]) else { return found };
    for (end, vertex) in found.iter_mut().enumerate().filter(|(end, _)| *end != HEAD) {
        let others = |at: u32| {
            (0..5)
                .filter(|other| *other != end)
                .map(|other| fields.at(other, at as usize))
                .sum::<f64>()
        };
        let near = (0_u32..).zip(fields.distances[end]).filter(|(_, way)| **way < REACH * feet);
        let ways = near.map(|(at, _)| (others(at), at)).filter(|(way, _)| way.is_finite());
        // Of equals the one with the lowest index: the same on every machine.
        let best = ways.max_by(|one, other| one.0.total_cmp(&other.0).then(other.1.cmp(&one.1)));
        *vertex = best.map_or(*vertex, |(_, at)| at);
    }
    found
}

//! The distances from the five ends of a body, and the ends brought to where they are on every body.

use crate::extremity::{Extremities, FarPoint};
use crate::geodesic::{Graph, Workspace, distances, distances_from};

/// Where the head stands among five ends.
pub const HEAD: usize = 0;
/// Where the hands stand.
pub const HAND: [usize; 2] = [1, 2];
/// Where the feet stand.
pub const FOOT: [usize; 2] = [3, 4];

/// The ends of a body, and how far along the surface every vertex is from each: head, two hands, two feet, the first
/// hand on the side of the first foot.
#[derive(Debug, Clone, Copy)]
pub struct Fields<'a> {
    /// The vertex at each end.
    pub ends: [u32; 5],
    /// One distance a vertex, in the mesh's unit; infinite where there is no way.
    pub distances: [&'a [f64]; 5],
    /// The distances from the head's top as it was first found, where it was moved since. The neck is looked for by these.
    pub first_head: Option<&'a [f64]>,
    /// How much earlier than on a whole body the surface ends there, in the mesh's unit: 0 where nothing is missing. All
    /// distances from such an end are longer by it, as if they led to where the limb would end.
    pub missing: [f64; 5],
}

impl Fields<'_> {
    /// How far `vertex` is from an end; infinite if there is no such vertex.
    pub(super) fn at(&self, end: usize, vertex: usize) -> f64 {
        self.distances
            .get(end)
            .and_then(|field| field.get(vertex))
            .map_or(f64::INFINITY, |distance| distance + self.missing.get(end).unwrap_or(&0.0))
    }

    /// How far two ends are from each other. Nothing if there is no way, or an end that is no vertex.
    pub(super) fn between(&self, one: usize, other: usize) -> Option<f64> {
        let vertex = *self.ends.get(other)? as usize;
        let distance = self.at(one, vertex) + self.missing.get(other)?;
        Some(distance).filter(|distance| distance.is_finite())
    }

    /// How far every two of the ends are from each other.
    pub(super) fn pairwise(&self) -> impl Iterator<Item = Option<f64>> {
        (0..5).flat_map(move |one| (0..one).map(move |other| self.between(one, other)))
    }
}

/// An end moves at most this share of the way between the feet: within a hand or a foot, never past a wrist.
const REACH: f64 = 0.15;

/// The top of the head is no farther than this from the vertex that stands for the head, in the same share.
const HEAD_REACH: f64 = 0.14;
/// Where the highest of that lies in its outer part, the top is looked for again around it, at most so many times.
const HEAD_STEPS: usize = 3;
/// The outer part begins at this share of the reach.
const HEAD_EDGE: f64 = 0.5;
/// Of the top is what is nearer to the limbs by less than this.
const CROWN: f64 = 0.03;

/// The five ends of a body, with the distances from each.
#[derive(Debug, Clone)]
pub struct RefinedEnds {
    /// The vertex at each end: head, hands, feet.
    pub vertices: [u32; 5],
    /// One distance a vertex for each end, in the mesh's unit; for the head from all of its top.
    pub distances: [Vec<f64>; 5],
    /// Those from the head's top as it was first found, where it was moved since.
    pub first_head: Option<Vec<f64>>,
}

impl RefinedEnds {
    /// As the landmarks take them.
    #[must_use]
    pub fn fields(&self) -> Fields<'_> {
        Fields {
            ends: self.vertices,
            distances: self.distances.each_ref().map(Vec::as_slice),
            first_head: self.first_head.as_deref(),
            missing: [0.0; 5],
        }
    }
}

/// Moves each end to the vertex near it that is farthest from the four others together. The head's becomes
/// all of its top, which is flat: the farthest vertex of it changes with the triangles.
///
/// A thumb becomes a fingertip and a heel a toe, whichever of them the search for ends came upon. `distances_from_ends` are
/// those from [`Extremities::all`]; they are measured again only for an end that moves, and then only if where it moves
/// is not among `known`.
#[must_use]
pub fn refine_ends(
    graph: &Graph,
    extremities: &Extremities,
    distances_from_ends: [Vec<f64>; 5],
    known: &[FarPoint],
    workspace: &mut Workspace,
) -> RefinedEnds {
    let vertices = extremities.all();
    let mut refined = RefinedEnds { vertices, distances: distances_from_ends, first_head: None };
    let moved = farthest(&refined.fields());
    let around = top_of_head(graph, &refined.fields(), workspace);
    let crown_of = |around: &[f64]| crown(&refined.fields(), around);
    let first = crown_of(&refined.distances[HEAD]);
    let crown = around.as_deref().map_or_else(|| first.clone(), crown_of);
    if around.is_some() && !first.is_empty() {
        refined.first_head = Some(distances_from(graph, first, workspace));
    }
    for (end, to) in moved.into_iter().enumerate() {
        if end == HEAD && !crown.is_empty() {
            refined.distances[end] = distances_from(graph, crown.iter().copied(), workspace);
        } else if to != refined.vertices[end] {
            refined.vertices[end] = to;
            let known = known.iter().find(|far| far.vertex == to);
            refined.distances[end] = match known {
                Some(far) => far.distances.clone(),
                None => distances(graph, to, workspace),
            };
        }
    }
    refined
}

/// The mean distance of a vertex from the ends of the limbs.
fn from_limbs(fields: &Fields<'_>, at: u32) -> f64 {
    (1..5).map(|end| fields.at(end, at as usize)).sum::<f64>() / 4.0
}

/// The distances from the vertex of the head that is farthest from the limbs, where it is not near the one that stands for
/// the head: a forehead, or a temple.
fn top_of_head(graph: &Graph, fields: &Fields<'_>, workspace: &mut Workspace) -> Option<Vec<f64>> {
    let reach = HEAD_REACH * fields.between(FOOT[0], FOOT[1])?;
    let mut moved: Option<Vec<f64>> = None;
    for _ in 0..HEAD_STEPS {
        let around = moved.as_deref().unwrap_or(fields.distances[HEAD]);
        let near = (0_u32..).zip(around).filter(|(_, way)| **way < reach);
        let ways = near.map(|(at, way)| (from_limbs(fields, at), at, *way));
        let best = ways.max_by(|one, other| one.0.total_cmp(&other.0).then(other.1.cmp(&one.1)));
        // Only a top at the edge of what was looked at may go on behind it.
        let Some((_, top, _)) = best.filter(|(_, _, way)| *way > HEAD_EDGE * reach) else { break };
        moved = Some(distances(graph, top, workspace));
    }
    moved
}

/// The vertices of the head's top, each with how much less far from the limbs it is than the farthest. The distances from
/// there go on with no step from how far the limbs are, so that it hardly matters which vertices are taken.
fn crown(fields: &Fields<'_>, around: &[f64]) -> Vec<(u32, f64)> {
    let Some(feet) = fields.between(FOOT[0], FOOT[1]) else { return Vec::new() };
    let near = || (0_u32..).zip(around).filter(|(_, way)| **way < HEAD_REACH * feet);
    let most = near().map(|(at, _)| from_limbs(fields, at)).fold(0.0, f64::max);
    let starts = near().map(|(at, _)| (at, most - from_limbs(fields, at)));
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

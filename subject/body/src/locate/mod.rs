//! The default method: joint centres from the shape of a body's surface and the geodesic distances along it.
//!
//! (Yu et al. 2008) cut the body by one distance field, from the head. This method uses five, one from each extremity:
//! near its own end a limb is cut straight across, in any pose.
//!
//! 1. [`refine_ends`] moves the extremities to places that exist on every body.
//! 2. The level-set curves of each field give marks along every limb: the end of the hand, the widening into the trunk,
//!    the bend of the centre line.
//! 3. [`Landmarks`] are the centres of curves at fixed places between the marks.
//! 4. A joint is a weighted mean of landmarks. The weights add up to one, so the joint moves, turns and grows with the
//!    body; `benches/subject/learn.py` learned them.
//! 5. Bones of the two sides are given one length, and the upper ones are drawn towards the average body's.
//! 6. The feet determine left and right.

mod joints;
mod landmark;
mod limb;
mod missing;
mod model;
mod scale;
mod section;
#[cfg(test)]
mod tests;

use crate::extremity::{Extremities, FarPoint};
use crate::geodesic::{Graph, Workspace, distances, distances_from};

pub use joints::joints;
pub use landmark::{ARM_LANDMARKS, HEAD_LANDMARKS, Half, LEG_LANDMARKS, Landmarks};
pub use missing::Neck;
pub use scale::Touching;
pub use section::Sections;

/// Index of the head among the five extremities.
pub const HEAD: usize = 0;
/// Indices of the hands.
pub const HAND: [usize; 2] = [1, 2];
/// Indices of the feet.
pub const FOOT: [usize; 2] = [3, 4];

/// The extremities of a body and the geodesic distances from each: head, two hands, two feet, the first hand on the
/// side of the first foot.
#[derive(Debug, Clone, Copy)]
pub struct Fields<'a> {
    /// Vertices of the extremities.
    pub ends: [u32; 5],
    /// One distance per vertex, in the mesh's unit; infinite if it is unreachable.
    pub distances: [&'a [f64]; 5],
    /// Distances from the top of the head as first found, if it was moved since. The neck is measured by these.
    pub first_head: Option<&'a [f64]>,
    /// Missing length of each limb, in the mesh's unit; 0 if the limb is whole. It is added to all distances from that
    /// end, as if they led to where the limb would end.
    pub missing: [f64; 5],
}

impl Fields<'_> {
    /// Distance of `vertex` from an extremity; infinite if there is no such vertex.
    fn at(&self, end: usize, vertex: usize) -> f64 {
        self.distances
            .get(end)
            .and_then(|field| field.get(vertex))
            .map_or(f64::INFINITY, |distance| distance + self.missing.get(end).unwrap_or(&0.0))
    }

    /// Distance between two extremities; none if there is no path or no such vertex.
    fn between(&self, one: usize, other: usize) -> Option<f64> {
        let vertex = *self.ends.get(other)? as usize;
        let distance = self.at(one, vertex) + self.missing.get(other)?;
        Some(distance).filter(|distance| distance.is_finite())
    }

    /// Distances between all ten pairs of extremities.
    fn pairwise(&self) -> impl Iterator<Item = Option<f64>> {
        (0..5).flat_map(move |one| (0..one).map(move |other| self.between(one, other)))
    }
}

/// Largest move of an extremity, as a fraction of the distance between the feet: within a hand or a foot, never past a
/// wrist.
const REACH: f64 = 0.15;

/// Radius of the search for the top of the head, as the same fraction.
const HEAD_REACH: f64 = 0.14;
/// Number of further searches, if the highest point lies in the outer part of the radius.
const HEAD_STEPS: usize = 3;
/// Start of the outer part, as a fraction of the radius.
const HEAD_EDGE: f64 = 0.5;
/// Vertices belong to the top of the head if they are nearer to the limbs by less than this fraction.
const CROWN: f64 = 0.03;

/// The refined extremities, with the distances from each.
#[derive(Debug, Clone)]
pub struct RefinedEnds {
    /// Vertices of head, hands and feet.
    pub vertices: [u32; 5],
    /// One distance per vertex for each extremity, in the mesh's unit; for the head, from all of its top.
    pub distances: [Vec<f64>; 5],
    /// Distances from the top of the head as first found, if it was moved since.
    pub first_head: Option<Vec<f64>>,
}

impl RefinedEnds {
    /// The fields in the form that [`Landmarks`] take.
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

/// Moves each extremity to the vertex nearby that is farthest from the four others together. The head becomes the whole
/// of its flat top, because the farthest vertex of it depends on the triangulation.
///
/// So a thumb becomes a fingertip and a heel a toe. `distances_from_ends` are those from [`Extremities::all`]. They are
/// computed again only for an extremity that moves to a vertex that is not among `known`.
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

/// Mean distance of a vertex from the ends of the limbs.
fn from_limbs(fields: &Fields<'_>, at: u32) -> f64 {
    (1..5).map(|end| fields.at(end, at as usize)).sum::<f64>() / 4.0
}

/// Distances from the vertex of the head farthest from the limbs, if the present one is far from it: on the forehead or
/// a temple.
fn top_of_head(graph: &Graph, fields: &Fields<'_>, workspace: &mut Workspace) -> Option<Vec<f64>> {
    let reach = HEAD_REACH * fields.between(FOOT[0], FOOT[1])?;
    let mut moved: Option<Vec<f64>> = None;
    for _ in 0..HEAD_STEPS {
        let around = moved.as_deref().unwrap_or(fields.distances[HEAD]);
        let near = (0_u32..).zip(around).filter(|(_, d)| **d < reach);
        let ranked = near.map(|(at, d)| (from_limbs(fields, at), at, *d));
        let best = ranked.max_by(|one, other| one.0.total_cmp(&other.0).then(other.1.cmp(&one.1)));
        // Only a top near the edge of the searched region may continue beyond it.
        let Some((_, top, _)) = best.filter(|(_, _, d)| *d > HEAD_EDGE * reach) else { break };
        moved = Some(distances(graph, top, workspace));
    }
    moved
}

/// The vertices of the top of the head, each with its deficit of distance from the limbs. With these offsets the
/// distances continue without a step, so the exact choice of vertices hardly matters.
fn crown(fields: &Fields<'_>, around: &[f64]) -> Vec<(u32, f64)> {
    let Some(feet) = fields.between(FOOT[0], FOOT[1]) else { return Vec::new() };
    let near = || (0_u32..).zip(around).filter(|(_, d)| **d < HEAD_REACH * feet);
    let most = near().map(|(at, _)| from_limbs(fields, at)).fold(0.0, f64::max);
    let starts = near().map(|(at, _)| (at, most - from_limbs(fields, at)));
    starts.filter(|(_, start)| *start < CROWN * feet).collect()
}

fn farthest(fields: &Fields<'_>) -> [u32; 5] {
    let mut found = fields.ends;
    let Some(feet) = fields.between(FOOT[0], FOOT[1]) else { return found };
    for (end, vertex) in found.iter_mut().enumerate().filter(|(end, _)| *end != HEAD) {
        let rest = (0..5).filter(|other| *other != end);
        let total = |at: u32| rest.clone().map(|other| fields.at(other, at as usize)).sum::<f64>();
        let near = (0_u32..).zip(fields.distances[end]).filter(|(_, d)| **d < REACH * feet);
        let ranked = near.map(|(at, _)| (total(at), at)).filter(|(d, _)| d.is_finite());
        // Ties go to the lowest index, so that every machine finds the same.
        let best = ranked.max_by(|one, other| one.0.total_cmp(&other.0).then(other.1.cmp(&one.1)));
        *vertex = best.map_or(*vertex, |(_, at)| at);
    }
    found
}

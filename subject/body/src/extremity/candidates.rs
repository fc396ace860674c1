//! What stands out of a surface, or of a volume, far enough and apart.

use super::peaks::{Peak, peaks};
use super::spread::farthest_points;
use crate::geodesic::{Graph, Workspace, distances};

/// So many far-spread vertices make the function whose maxima are the ends. Five would do for a body; two more keep one
/// that fell on a knee from bending it.
const SPREAD_COUNT: usize = 7;

/// An end stands out by at least this part of the longest way. On bodies, hands that have grown to hips do by 0.034.
const PERSISTENCE_MIN: f64 = 0.015;

/// Two maxima that are nearer than this part of the longest way are on one end: fingers, chin and crown, heel and toes.
const APART_MIN: f64 = 0.15;

/// So many ends are looked at, the most persistent first; each costs the distances from it.
const CANDIDATE_COUNT_MAX: usize = 8;

/// A candidate: where it stands out, and how far it is from everything.
pub(crate) struct Candidate {
    pub(crate) peak: Peak,
    pub(crate) field: Vec<f64>,
}

/// What stands out.
pub(crate) struct StandingOut {
    /// The most persistent first.
    pub(crate) candidates: Vec<Candidate>,
    /// The far-spread vertices, with the distances from each.
    pub(crate) spread: Vec<(u32, Vec<f64>)>,
    /// The mean distance to them.
    pub(crate) mean: Vec<f64>,
    /// The longest way that was seen.
    pub(crate) longest: f64,
}

/// Finds what stands out of the piece of `graph` that `start` is in.
pub(crate) fn standing_out(graph: &Graph, start: u32, workspace: &mut Workspace) -> StandingOut {
    let spread = farthest_points(graph, start, SPREAD_COUNT, workspace);
    let fields = || spread.iter().map(|(_, field)| field);
    let finite = fields().flatten().copied().filter(|far| far.is_finite());
    let longest = finite.fold(0.0, f64::max);
    let count = spread.len().max(1) as f64;
    let mean: Vec<f64> = (0..graph.vertex_count())
        .map(|at| fields().map(|field| field[at]).sum::<f64>() / count)
        .collect();
    let mut candidates: Vec<Candidate> = Vec::new();
    for peak in peaks(graph, &mean) {
        if candidates.len() == CANDIDATE_COUNT_MAX || peak.persistence < PERSISTENCE_MIN * longest {
            break;
        }
        let near = |other: &Candidate| other.field[peak.vertex as usize] < APART_MIN * longest;
        if !candidates.iter().any(near) {
            candidates.push(Candidate { peak, field: distances(graph, peak.vertex, workspace) });
        }
    }
    StandingOut { candidates, spread, mean, longest }
}

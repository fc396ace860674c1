//! From a surface to its named ends.

use super::peaks::{Peak, peaks};
use super::roles::{MISFIT_MAX, Misfit, misfit};
use super::spread::farthest_points;
use super::{Extremities, cap};
use crate::body::geodesic::{Graph, Workspace, distances};
use crate::body::{Mesh, Refusal};

/// So many far-spread vertices make the function whose maxima are the ends. Five would do for a body; two more keep one
/// that fell on a knee from bending it.
const SPREAD_COUNT: usize = 7;

/// An end stands out by at least this part of the longest way. On bodies, hands that have grown to hips do by 0.034.
const PERSISTENCE_MIN: f64 = 0.015;

/// Two maxima that are nearer than this part of the longest way are on one end: fingers, chin and crown, heel and toes.
const APART_MIN: f64 = 0.15;

/// Two namings whose ends differ by less than this part of the longest way say the same. From the crown into an open
/// mouth it is some 0.17, from a hand to its elbow 0.25.
const OTHER_MIN: f64 = 0.22;

/// So many ends are looked at, the most persistent first; each costs the distances from it.
const CANDIDATE_COUNT_MAX: usize = 8;

/// The second best naming must be worse than the best by so much.
const MARGIN_MIN: f64 = 0.5;

/// The named ends of a body, and what was measured on the way.
#[derive(Debug, Clone)]
pub struct Ends {
    /// Which vertices they are.
    pub extremities: Extremities,
    /// The distances along the surface from each of [`Extremities::all`] to every vertex, in the mesh's unit.
    pub fields: [Vec<f64>; 5],
    /// By how much each of [`Extremities::all`] stands out, as a part of the longest way.
    pub persistence: [f64; 5],
    /// How far the ways between them are from those of a body.
    pub misfit: Misfit,
    /// By how much the misfit of the second best naming is greater; infinite if there is none.
    pub margin: f64,
}

impl Ends {
    /// How sure the naming is, from 0 to 1: falls with the misfit, and with how well a second naming fits.
    #[must_use]
    pub fn confidence(&self) -> f64 {
        let fit = (1.0 - self.misfit.rms / MISFIT_MAX).clamp(0.0, 1.0).sqrt();
        fit * (1.0 - (-self.margin / MARGIN_MIN).exp())
    }
}

/// A candidate: where it stands out, and how far it is from everything.
struct Candidate {
    peak: Peak,
    field: Vec<f64>,
}

/// Finds head, hands and feet.
///
/// # Errors
///
/// - [`Refusal::InPieces`]: the surface does not hang together.
/// - [`Refusal::TooFewEnds`]: fewer than five ends stand out.
/// - [`Refusal::NotABody`]: no naming of the ends gives a body.
/// - [`Refusal::Ambiguous`]: two namings do about as well.
pub fn find(mesh: &Mesh, graph: &Graph, workspace: &mut Workspace) -> Result<Ends, Refusal> {
    let spread = farthest_points(mesh, graph, SPREAD_COUNT, workspace);
    let Some(first) = spread.fields.first() else { return Err(Refusal::TooFewEnds { found: 0 }) };
    let vertices =
        (0..graph.vertex_count() as u32).filter(|at| !graph.links(*at).is_empty()).count();
    let reached = first.iter().filter(|far| far.is_finite()).count();
    if reached < vertices {
        return Err(Refusal::InPieces { reached, vertices });
    }
    let longest = spread.fields.iter().flatten().copied().filter(|far| far.is_finite());
    let longest = longest.fold(0.0, f64::max);
    let count = spread.fields.len() as f64;
    let mean: Vec<f64> = (0..mesh.positions.len())
        .map(|at| spread.fields.iter().map(|field| field[at]).sum::<f64>() / count)
        .collect();
    let candidates = candidates(graph, &mean, longest, workspace);
    if candidates.len() < 5 {
        return Err(Refusal::TooFewEnds { found: candidates.len() });
    }
    let (best, margin) = name(&candidates, OTHER_MIN * longest);
    let Some((misfit, ends)) = best else { return Err(Refusal::TooFewEnds { found: 0 }) };
    if misfit.rms > MISFIT_MAX {
        return Err(Refusal::NotABody { misfit: misfit.rms, limit: MISFIT_MAX });
    }
    if margin < MARGIN_MIN {
        return Err(Refusal::Ambiguous { margin });
    }
    let head = cap::top(mesh, graph, &mean, candidates[ends[0]].peak);
    let [_, a, b, c, d] = ends.map(|end| candidates[end].peak.vertex);
    let mut fields = ends.map(|end| candidates[end].field.clone());
    fields[0] = distances(graph, head, workspace);
    Ok(Ends {
        extremities: Extremities { head, hands: [a, b], feet: [c, d] },
        fields,
        persistence: ends.map(|end| candidates[end].peak.persistence / longest),
        misfit,
        margin,
    })
}

/// What stands out far enough, and apart.
fn candidates(
    graph: &Graph,
    mean: &[f64],
    longest: f64,
    workspace: &mut Workspace,
) -> Vec<Candidate> {
    let mut found: Vec<Candidate> = Vec::new();
    for peak in peaks(graph, mean) {
        if found.len() == CANDIDATE_COUNT_MAX || peak.persistence < PERSISTENCE_MIN * longest {
            break;
        }
        let near = |other: &Candidate| other.field[peak.vertex as usize] < APART_MIN * longest;
        if !found.iter().any(near) {
            found.push(Candidate { peak, field: distances(graph, peak.vertex, workspace) });
        }
    }
    found
}

type Naming = (Misfit, [usize; 5]);

/// The naming (head, hands, feet) that is nearest to a body, and by how much the next is farther that puts an end more
/// than `other_min` elsewhere.
fn name(candidates: &[Candidate], other_min: f64) -> (Option<Naming>, f64) {
    let way = |from: usize, to: usize| {
        candidates[from].field[candidates[to].peak.vertex as usize].max(f64::MIN_POSITIVE)
    };
    let namings = namings(candidates.len(), &way);
    let best = namings.iter().copied().min_by(|(one, _), (other, _)| one.rms.total_cmp(&other.rms));
    let Some((fit, ends)) = best else { return (None, 0.0) };
    let apart = |one: usize, other: usize| one != other && way(one, other) > other_min;
    let differs = |other: &[usize; 5]| {
        let pair = |at: usize, to: [usize; 2]| {
            let straight = apart(ends[at], other[to[0]]) || apart(ends[at + 1], other[to[1]]);
            let swapped = apart(ends[at], other[to[1]]) || apart(ends[at + 1], other[to[0]]);
            straight && swapped
        };
        apart(ends[0], other[0]) || pair(1, [1, 2]) || pair(3, [3, 4])
    };
    let others = namings.iter().filter(|(_, other)| differs(other));
    let second = others.map(|(other, _)| other.rms).fold(f64::INFINITY, f64::min);
    (best, second - fit.rms)
}

/// Every way to name five of `count` ends, with what it costs.
fn namings(count: usize, way: &impl Fn(usize, usize) -> f64) -> Vec<Naming> {
    let mut found = Vec::new();
    for head in 0..count {
        for [a, b] in pairs(count).filter(|hands| !hands.contains(&head)) {
            let free = |end: &usize| ![head, a, b].contains(end);
            for [c, d] in pairs(count).filter(|feet| feet.iter().all(free)) {
                // A foot is nearer to the hand on its own side.
                let crossed = way(a, c) + way(b, d) > way(a, d) + way(b, c);
                let ends = if crossed { [head, a, b, d, c] } else { [head, a, b, c, d] };
                found.push((misfit(ends.map(|from| ends.map(|to| way(from, to)))), ends));
            }
        }
    }
    found
}

/// Every two of `count`, the lower first.
fn pairs(count: usize) -> impl Iterator<Item = [usize; 2]> {
    (0..count).flat_map(move |one| (one + 1..count).map(move |other| [one, other]))
}

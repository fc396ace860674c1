//! Protrusions of a surface or a volume: the maxima of the mean distance to a few widely spread vertices, with enough
//! persistence and distance from each other.

use super::FarPoint;
use crate::geodesic::{Graph, Workspace, distances};
use crate::mesh::find_root;

/// Number of widely spread vertices. Five would do for a body; two more limit the effect of one that fell on a knee.
const SPREAD_COUNT: usize = 7;

/// Minimum persistence of a protrusion, as a fraction of the longest distance. On bodies, hands fused with the hips
/// have 0.034.
const PERSISTENCE_MIN: f64 = 0.015;

/// Maxima closer than this fraction of the longest distance belong to one protrusion: fingers, chin and crown, heel and
/// toes.
const APART_MIN: f64 = 0.15;

/// Maximum number of candidates, the most persistent first; each costs a run of distances.
const CANDIDATE_COUNT_MAX: usize = 8;

/// A candidate extremity: its maximum, and the distances from it.
pub(crate) struct Candidate {
    pub(crate) peak: Peak,
    pub(crate) field: Vec<f64>,
}

/// The protrusions of a surface.
pub(crate) struct Protrusions {
    /// The most persistent first.
    pub(crate) candidates: Vec<Candidate>,
    /// The widely spread vertices.
    pub(crate) spread: Vec<FarPoint>,
    /// The mean distance to them.
    pub(crate) mean: Vec<f64>,
    /// The longest distance that occurred.
    pub(crate) longest: f64,
}

/// Finds the protrusions of the connected component of `start`.
pub(crate) fn protrusions(graph: &Graph, start: u32, workspace: &mut Workspace) -> Protrusions {
    let spread = farthest_points(graph, start, workspace);
    let fields = || spread.iter().map(|far| &far.distances);
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
    Protrusions { candidates, spread, mean, longest }
}

/// A maximum of a function on the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// Vertex of the maximum.
    pub vertex: u32,
    /// Drop of the function before a higher maximum can be reached; for the highest, to its least value.
    pub persistence: f64,
    /// Value of the saddle to a higher maximum.
    pub saddle: f64,
}

const UNSEEN: u32 = u32::MAX;

/// The maxima of `values` on `graph` by persistence, largest first (Edelsbrunner et al. 2002).
///
/// Vertices are added from the highest down and united with higher neighbours. Where two components meet, the lower
/// maximum ends.
pub(super) fn peaks(graph: &Graph, values: &[f64]) -> Vec<Peak> {
    let finite = values.iter().copied().filter(|value| value.is_finite());
    let most = finite.fold(0.0, f64::max);
    // Ties are broken by vertex index: a symmetric body has many.
    let mut order: Vec<(i64, u32)> = (0_u32..)
        .zip(values)
        .filter(|(_, value)| value.is_finite())
        .map(|(vertex, value)| (-(rounded(*value, most) as i64), vertex))
        .collect();
    order.sort_unstable();
    let value = |vertex: u32| values[vertex as usize];
    let mut hills = vec![UNSEEN; values.len()];
    // The component whose maximum came first is the higher one.
    let mut rank = vec![0_u32; values.len()];
    let mut found = Vec::new();
    let mut around = Vec::new();
    for (at, (_, vertex)) in (0_u32..).zip(&order) {
        rank[*vertex as usize] = at;
        hills[*vertex as usize] = *vertex;
        around.clear();
        for link in graph.links(*vertex) {
            if hills[link.to as usize] == UNSEEN {
                continue;
            }
            let top = find_root(&mut hills, link.to);
            if top != *vertex && !around.contains(&top) {
                around.push(top);
            }
        }
        around.sort_unstable_by_key(|top| rank[*top as usize]);
        let Some((highest, lower)) = around.split_first() else { continue };
        hills[*vertex as usize] = *highest;
        for top in lower {
            hills[*top as usize] = *highest;
            let (height, saddle) = (value(*top), value(*vertex));
            found.push(Peak { vertex: *top, persistence: height - saddle, saddle });
        }
    }
    if let Some(((_, top), (_, bottom))) = order.first().zip(order.last()) {
        let saddle = value(*bottom);
        found.push(Peak { vertex: *top, persistence: value(*top) - saddle, saddle });
    }
    let key = |peak: &Peak| (-(rounded(peak.persistence, most) as i64), peak.vertex);
    found.sort_unstable_by_key(key);
    found
}

/// Up to [`SPREAD_COUNT`] vertices by farthest-point sampling, the first of them farthest from `start`.
fn farthest_points(graph: &Graph, start: u32, workspace: &mut Workspace) -> Vec<FarPoint> {
    let mut found = Vec::new();
    let mut nearest = distances(graph, start, workspace);
    for turn in 0..SPREAD_COUNT {
        let Some(vertex) = farthest(&nearest, |_| true) else { break };
        let field = distances(graph, vertex, workspace);
        if turn == 0 {
            nearest.clone_from(&field);
        } else {
            for (nearest, far) in nearest.iter_mut().zip(&field) {
                *nearest = nearest.min(*far);
            }
        }
        found.push(FarPoint { vertex, distances: field });
    }
    found
}

/// Lengths that differ by less than this fraction of the longer count as equal.
///
/// Rotating or moving a mesh changes a sum of some hundred lengths by about 1e-13 of it, which would break the ties of
/// a symmetric body.
const SAME: f64 = 1e-9;

/// The allowed vertex with the largest finite value; of equals, the first.
pub(super) fn farthest(field: &[f64], allowed: impl Fn(u32) -> bool) -> Option<u32> {
    let vertices = || (0_u32..).zip(field).filter(|(at, value)| value.is_finite() && allowed(*at));
    let most = vertices().map(|(_, value)| *value).fold(f64::NEG_INFINITY, f64::max);
    vertices().find(|(_, value)| **value >= most - SAME * most.abs()).map(|(vertex, _)| vertex)
}

/// `length` rounded, so that values that differ in their last digits are equal, nearly always.
fn rounded(length: f64, unit: f64) -> f64 {
    (length / (SAME * unit)).round()
}

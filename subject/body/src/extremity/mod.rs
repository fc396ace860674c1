//! Finds the extremities of a body and identifies them as head, hands and feet.
//!
//! Extremities are the maxima of the mean geodesic distance to a few widely spread vertices, in any pose; how far each
//! protrudes is its persistence. Head, hands and feet are assigned by the ten geodesic distances between five of them,
//! whose ratios hardly differ from person to person.

mod inside;
mod naming;
#[cfg(test)]
mod tests;

use crate::{
    Mesh, Refusal,
    geodesic::{Graph, Workspace, distances},
    mesh::{Point, distance, find_root},
};
use naming::{MARGIN_MIN, misfit, misfit_cut, misfit_in_contact, name};
pub use naming::{MISFIT_IN_CONTACT_MAX, MISFIT_MAX, Misfit};

/// The extremities of a body, as vertices of the mesh.
///
/// `hands[0]` and `feet[0]` are on one side of the body, `hands[1]` and `feet[1]` on the other. Geodesic distances
/// cannot determine which side is left.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Extremities {
    /// Top of the head.
    pub head: u32,
    /// Tips of the hands.
    pub hands: [u32; 2],
    /// Tips of the feet: heel or toes, whichever is farther.
    pub feet: [u32; 2],
}

impl Extremities {
    /// Head, hands, feet: the order of distance fields.
    #[must_use]
    pub fn all(&self) -> [u32; 5] {
        let ([a, b], [c, d]) = (self.hands, self.feet);
        [self.head, a, b, c, d]
    }
}

/// How the extremities were identified, from the most to the least certain.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum NamingMode {
    /// By distances along the surface of a body whose limbs are free.
    FreeLimbs,
    /// By distances along the surface of a body from which part of a limb is missing.
    CutLimb,
    /// By distances along the surface, some of which are too short because they cross from a hand into what it touches.
    InContact,
    /// By distances through the interior, with a layer removed so that touching limbs separate.
    Interior,
}

/// A vertex far from others.
#[derive(Debug, Clone)]
pub struct FarPoint {
    /// The vertex.
    pub vertex: u32,
    /// Geodesic distances from it to every vertex, in the mesh's unit.
    pub distances: Vec<f64>,
}

/// The identified extremities, and what was measured on the way.
#[derive(Debug, Clone)]
pub struct Ends {
    /// The vertices.
    pub extremities: Extremities,
    /// Geodesic distances from each of [`Extremities::all`] to every vertex, in the mesh's unit.
    pub fields: [Vec<f64>; 5],
    /// Widely spread vertices. Fingertips and toes are often among them, so their distances need not be computed again.
    pub spread: Vec<FarPoint>,
    /// Persistence of each of [`Extremities::all`], as a fraction of the longest distance.
    pub persistence: [f64; 5],
    /// How they were identified.
    pub mode: NamingMode,
    /// Deviation of their distances from those of a body.
    pub misfit: Misfit,
    /// Margin to the misfit of the second best assignment; infinite if there is none.
    pub margin: f64,
}

impl Ends {
    /// Confidence in the assignment, 0 to 1: falls with the misfit, and with the fit of the second best assignment.
    #[must_use]
    pub fn confidence(&self) -> f64 {
        let fit = (1.0 - self.misfit.rms / self.misfit.limit).clamp(0.0, 1.0).sqrt();
        fit * (1.0 - (-self.margin / MARGIN_MIN).exp())
    }
}

/// Largest misfit of whole bodies with free limbs; 0.86 was measured.
const FITS_WELL: f64 = 1.0;

/// Finds head, hands and feet: on a whole body, on one with part of a limb missing, on one whose limbs touch, and last
/// through the interior.
///
/// Distance fields always follow the surface. With [`NamingMode::InContact`] and [`NamingMode::Interior`] they may
/// therefore cross a contact.
///
/// # Errors
///
/// - [`Refusal::InPieces`]: the surface is not connected.
/// - [`Refusal::TooFewEnds`]: fewer than five extremities protrude.
/// - [`Refusal::TooManyEnds`]: more than five protrude as far as limbs.
/// - [`Refusal::NotABody`]: no assignment of the extremities gives a body.
/// - [`Refusal::Ambiguous`]: two assignments fit about equally well.
pub fn find(mesh: &Mesh, graph: &Graph, workspace: &mut Workspace) -> Result<Ends, Refusal> {
    let start = start(mesh, graph).ok_or(Refusal::TooFewEnds { found: 0 })?;
    let protrusions = protrusions(graph, start, workspace);
    check_connected(graph, &protrusions.mean)?;
    let whole = name(&protrusions, misfit);
    if let Err(refusal @ Refusal::TooManyEnds { .. }) = whole {
        return Err(refusal);
    }
    // A whole body fits well. If this one does not, a body with part of a limb missing may, and then identifies its
    // extremities better.
    let fits_well = whole.as_ref().is_ok_and(|naming| naming.misfit.rms <= FITS_WELL);
    let cut = if fits_well { None } else { name(&protrusions, misfit_cut).ok() };
    let (naming, mode) = match (cut, whole) {
        (Some(cut), _) => (cut, NamingMode::CutLimb),
        (None, Ok(whole)) => (whole, NamingMode::FreeLimbs),
        (None, Err(refusal)) => match name(&protrusions, misfit_in_contact) {
            Ok(touching) => (touching, NamingMode::InContact),
            // The surface's own reason is more useful to the user than that of a thinned interior.
            Err(_) => return inside::find(mesh, graph, workspace).ok_or(refusal),
        },
    };
    let ends = naming.ends.map(|end| &protrusions.candidates[end]);
    let head = top_of_head(mesh, graph, &protrusions.mean, ends[0].peak);
    let [_, a, b, c, d] = ends.map(|end| end.peak.vertex);
    let mut fields = ends.map(|end| end.field.clone());
    fields[0] = distances(graph, head, workspace);
    Ok(Ends {
        extremities: Extremities { head, hands: [a, b], feet: [c, d] },
        fields,
        persistence: ends.map(|end| end.peak.persistence / protrusions.longest),
        spread: protrusions.spread,
        mode,
        misfit: naming.misfit,
        margin: naming.margin,
    })
}

/// The vertex farthest, in a straight line, from the centroid of the surface: it depends on the shape alone, not on
/// position or vertex order.
pub(crate) fn start(mesh: &Mesh, graph: &Graph) -> Option<u32> {
    let far = distances_from_place(mesh, mesh.area_centroid());
    // Unused vertices are not part of the surface.
    farthest(&far, |vertex| !graph.links(vertex).is_empty())
}

/// Rejects a surface that is not connected.
fn check_connected(graph: &Graph, field: &[f64]) -> Result<(), Refusal> {
    let on_surface = (0..graph.vertex_count() as u32).filter(|at| !graph.links(*at).is_empty());
    let vertices = on_surface.count();
    let reached = field.iter().filter(|far| far.is_finite()).count();
    if reached < vertices { Err(Refusal::InPieces { reached, vertices }) } else { Ok(()) }
}

/// The vertex of the head farthest, in a straight line, from the neck.
///
/// The maximum of a distance function may lie in an open mouth or behind an ear, where paths along the surface are
/// long. The head is the region above the saddle of `peak` that contains it; its border is the neck.
fn top_of_head(mesh: &Mesh, graph: &Graph, values: &[f64], peak: Peak) -> u32 {
    let mut head = vec![false; values.len()];
    let mut edge = Vec::new();
    let mut open = vec![peak.vertex];
    head[peak.vertex as usize] = true;
    while let Some(vertex) = open.pop() {
        for link in graph.links(vertex) {
            let to = link.to as usize;
            if values[to] <= peak.saddle {
                edge.push(link.to);
            } else if !head[to] {
                head[to] = true;
                open.push(link.to);
            }
        }
    }
    edge.sort_unstable();
    edge.dedup();
    if edge.is_empty() {
        return peak.vertex;
    }
    let neck = edge.iter().map(|vertex| mesh.point(*vertex) / edge.len() as f64).sum();
    let far = distances_from_place(mesh, neck);
    farthest(&far, |vertex| head[vertex as usize]).unwrap_or(peak.vertex)
}

/// Straight distances of all vertices from a point.
fn distances_from_place(mesh: &Mesh, place: Point) -> Vec<f64> {
    mesh.positions.iter().map(|at| distance(*at, place)).collect()
}

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
fn peaks(graph: &Graph, values: &[f64]) -> Vec<Peak> {
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
fn farthest(field: &[f64], allowed: impl Fn(u32) -> bool) -> Option<u32> {
    let vertices = || (0_u32..).zip(field).filter(|(at, value)| value.is_finite() && allowed(*at));
    let most = vertices().map(|(_, value)| *value).fold(f64::NEG_INFINITY, f64::max);
    vertices().find(|(_, value)| **value >= most - SAME * most.abs()).map(|(vertex, _)| vertex)
}

/// `length` rounded, so that values that differ in their last digits are equal, nearly always.
fn rounded(length: f64, unit: f64) -> f64 {
    (length / (SAME * unit)).round()
}

//! Identification of the extremities of a surface.

use super::naming::{misfit, misfit_cut, misfit_in_contact, name};
use super::peaks::{Peak, farthest, protrusions};
use super::{Ends, Extremities, NamingMode, inside};
use crate::geodesic::{Graph, Workspace, distances};
use crate::mesh::{Point, distance};
use crate::{Mesh, Refusal};

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
    // Unused vertices are no part of the surface.
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

//! From a surface to its named ends.

use super::candidates::{StandingOut, standing_out};
use super::choice::farthest;
use super::naming::{MARGIN_MIN, Naming, name};
use super::roles::{Misfit, misfit, misfit_cut, misfit_in_contact};
use super::spread::{area_centroid, distance};
use super::{Extremities, cap, inside};
use crate::geodesic::{Graph, Workspace, distances};
use crate::{Mesh, Refusal};

/// Whole bodies whose limbs are free have no greater misfit: 0.86 was seen.
const FITS_WELL: f64 = 1.0;

/// How ends were told, from the surest to the least sure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Told {
    /// By ways along the surface of a body whose limbs are free.
    Freely,
    /// The same of a body of which a part of a limb is missing.
    Cut,
    /// By ways along the surface, some of which are too short for a body: they lead from a hand into what it touches.
    InContact,
    /// By ways through the inside, with a layer taken off so that limbs that touch come apart.
    Inside,
}

/// The named ends of a body, and what was measured on the way.
#[derive(Debug, Clone)]
pub struct Ends {
    /// Which vertices they are.
    pub extremities: Extremities,
    /// The distances along the surface from each of [`Extremities::all`] to every vertex, in the mesh's unit.
    pub fields: [Vec<f64>; 5],
    /// Vertices that lie far from each other, with the distances from each: fingertips and toes are often among them, and
    /// what is measured once need not be again.
    pub spread: Vec<(u32, Vec<f64>)>,
    /// By how much each of [`Extremities::all`] stands out, as a part of the longest way.
    pub persistence: [f64; 5],
    /// How they were told.
    pub told: Told,
    /// How far the ways between them are from those of a body.
    pub misfit: Misfit,
    /// By how much the misfit of the second best naming is greater; infinite if there is none.
    pub margin: f64,
}

impl Ends {
    /// How sure the naming is, from 0 to 1: falls with the misfit, and with how well a second naming fits.
    #[must_use]
    pub fn confidence(&self) -> f64 {
        let fit = (1.0 - self.misfit.rms / self.misfit.limit).clamp(0.0, 1.0).sqrt();
        fit * (1.0 - (-self.margin / MARGIN_MIN).exp())
    }
}

/// Finds head, hands and feet; where limbs touch, by what contact leaves, and then through the inside.
///
/// The fields are along the surface in every case, so that with [`Told::InContact`] and [`Told::Inside`] they may lead
/// through contact.
///
/// # Errors
///
/// - [`Refusal::InPieces`]: the surface does not hang together.
/// - [`Refusal::TooFewEnds`]: fewer than five ends stand out.
/// - [`Refusal::TooManyEnds`]: more than five do, as far as limbs.
/// - [`Refusal::NotABody`]: no naming of the ends gives a body.
/// - [`Refusal::Ambiguous`]: two namings do about as well.
pub fn find(mesh: &Mesh, graph: &Graph, workspace: &mut Workspace) -> Result<Ends, Refusal> {
    let start = start(mesh, graph).ok_or(Refusal::TooFewEnds { found: 0 })?;
    let standing = standing_out(graph, start, workspace);
    whole(graph, &standing.mean)?;
    let named = name(&standing, misfit);
    if let Err(refusal @ Refusal::TooManyEnds { .. }) = named {
        return Err(refusal);
    }
    // A whole body fits well. Where none does, a body without a part of a limb may, and tells its ends better.
    let fits_well = named.as_ref().is_ok_and(|((misfit, _), _)| misfit.rms <= FITS_WELL);
    if !fits_well && let Ok(cut) = name(&standing, misfit_cut) {
        return Ok(on_surface(mesh, graph, standing, cut, Told::Cut, workspace));
    }
    let refusal = match named {
        Ok(named) => return Ok(on_surface(mesh, graph, standing, named, Told::Freely, workspace)),
        Err(refusal) => refusal,
    };
    if let Ok(named) = name(&standing, misfit_in_contact) {
        return Ok(on_surface(mesh, graph, standing, named, Told::InContact, workspace));
    }
    // What the surface says of the ends is nearer to what the subject can mend than what a thinned inside says.
    inside::find(mesh, graph, workspace).ok_or(refusal)
}

fn on_surface(
    mesh: &Mesh,
    graph: &Graph,
    standing: StandingOut,
    ((misfit, ends), margin): (Naming, f64),
    told: Told,
    workspace: &mut Workspace,
) -> Ends {
    let candidates = &standing.candidates;
    let head = cap::top(mesh, graph, &standing.mean, candidates[ends[0]].peak);
    let [_, a, b, c, d] = ends.map(|end| candidates[end].peak.vertex);
    let mut fields = ends.map(|end| candidates[end].field.clone());
    fields[0] = distances(graph, head, workspace);
    Ends {
        extremities: Extremities { head, hands: [a, b], feet: [c, d] },
        fields,
        spread: standing.spread,
        persistence: ends.map(|end| candidates[end].peak.persistence / standing.longest),
        told,
        misfit,
        margin,
    }
}

/// The vertex that is farthest, straight, from the centroid of the area: it depends on the shape alone, not on where it
/// stands or which vertex comes first.
pub(crate) fn start(mesh: &Mesh, graph: &Graph) -> Option<u32> {
    let centre = area_centroid(mesh);
    let far: Vec<f64> = mesh.positions.iter().map(|at| distance(*at, centre)).collect();
    // A vertex that no triangle uses is no part of the surface.
    farthest(&far, |vertex| !graph.links(vertex).is_empty())
}

/// Refuses a surface that does not hang together.
fn whole(graph: &Graph, field: &[f64]) -> Result<(), Refusal> {
    let on_surface = (0..graph.vertex_count() as u32).filter(|at| !graph.links(*at).is_empty());
    let vertices = on_surface.count();
    let reached = field.iter().filter(|far| far.is_finite()).count();
    if reached < vertices { Err(Refusal::InPieces { reached, vertices }) } else { Ok(()) }
}

//! From a scan as it was read to one clean surface: closed, manifold, facing outside, of a bounded size.
//!
//! Every vertex that stays is where the scan had it, unless there are too many ([`FACES_KEPT_MAX`]). What is missing is
//! closed, what is too much is left out, both are told; and where nothing sensible is left, there is a reason.

mod closing;
mod connect;
mod decimate;
mod edges;
mod error;
mod fans;
mod pieces;
mod spikes;
#[cfg(test)]
mod tests;
mod weld;

pub use error::RepairError;

use super::geometry::{Point, cross, dot, norm, sub};
use super::read::Scan;
use super::unit::{self, extent};
use super::{Mesh, Note, Unit};

/// Faces above which a surface is made coarser: joints move less than what a scanner's noise moves them (Yu et al. 2008
/// have 5000), and time and memory of the methods stay bounded.
pub const FACES_KEPT_MAX: usize = 60_000;
/// Volume of a solid in cubes of its extent, below which it is a sheet. The slimmest bodies with arms spread have 0.01.
const SOLIDITY_MIN: f64 = 1e-3;

/// A surface that the methods take.
#[derive(Debug, Clone, PartialEq)]
pub struct Repaired {
    /// One piece, closed, every edge of two triangles, facing outside; in the scan's own frame and unit.
    pub mesh: Mesh,
    /// That unit: its factor to millimetres is [`Unit::mm`].
    pub unit: Unit,
    /// Whether the unit was inferred from the size, and neither stated nor told by the file.
    pub unit_inferred: bool,
    /// Handles, such as between an arm and a trunk that touch.
    pub genus: usize,
    /// What was found and done, of the file, too.
    pub notes: Vec<Note>,
}

impl Repaired {
    /// Whether the unit that was inferred may be another, by how tall the subject is in the mesh's own unit
    /// ([`Survey::body_scale`](super::Survey::body_scale)), or else by how large the mesh is.
    #[must_use]
    pub fn unit_ambiguity(&self, stature: Option<f64>) -> Option<Note> {
        let stature = || stature.unwrap_or_else(|| extent(&self.mesh));
        if self.unit_inferred { unit::ambiguity(self.unit, stature()) } else { None }
    }
}

/// Repairs a scan. `unit` is what its user states; otherwise it is what the file tells, or inferred.
///
/// # Errors
/// [`RepairError`] where no single closed body is left, or its unit cannot be told.
pub fn repair(scan: Scan, unit: Option<Unit>) -> Result<Repaired, RepairError> {
    let Scan { mut mesh, unit: told, mut notes, .. } = scan;
    weld::same_positions(&mut mesh, &mut notes);
    spikes::cut_off(&mut mesh, &mut notes);
    if mesh.triangles.len() > FACES_KEPT_MAX || !connect::is_clean(&mesh) {
        mend(&mut mesh, &mut notes)?;
    }
    let volume = volume(&mesh);
    if volume.abs() < SOLIDITY_MIN * extent(&mesh).powi(3) {
        return Err(RepairError::Flat);
    }
    if volume < 0.0 {
        mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        notes.push(Note::new("inside-out", "all faces looked inside: turned"));
    }
    let genus = genus(&mesh);
    if genus > 0 {
        let handles = if genus == 1 { "a handle".into() } else { format!("{genus} handles") };
        let text = format!("the surface has {handles}, as where limbs touch the body");
        notes.push(Note::new("handles", text));
    }
    let (unit, unit_inferred) = choose_unit(&mesh, unit.or(told), &mut notes)?;
    Ok(Repaired { mesh, unit, unit_inferred, genus, notes })
}

fn mend(mesh: &mut Mesh, notes: &mut Vec<Note>) -> Result<(), RepairError> {
    weld::needless_triangles(mesh, notes);
    weld::cracks(mesh, notes);
    // Before what takes longer with every piece, and once more when the surface has been cut where it was tangled.
    pieces::largest(mesh, notes)?;
    decimate::to(mesh, FACES_KEPT_MAX, notes)?;
    connect::manifold(mesh, notes);
    pieces::largest(mesh, notes)?;
    closing::holes(mesh, notes)?;
    if connect::is_clean(mesh) { Ok(()) } else { Err(RepairError::Tangled) }
}

fn choose_unit(
    mesh: &Mesh,
    stated: Option<Unit>,
    notes: &mut Vec<Note>,
) -> Result<(Unit, bool), RepairError> {
    if let Some(unit) = stated {
        if !unit.fits(mesh) {
            let mm = extent(mesh) * unit.mm();
            let text = format!("in {unit} the mesh is {mm:.0} mm across, which is no body's size");
            notes.push(Note::new("odd-size", text));
        }
        return Ok((unit, false));
    }
    let unit = Unit::infer(mesh)?;
    let text = format!("the file tells no unit: taken as {unit}, in which it has a body's size");
    notes.push(Note::new("unit-inferred", text));
    Ok((unit, true))
}

/// Of a closed surface; negative where it looks inside.
fn volume(mesh: &Mesh) -> f64 {
    let origin = mesh.positions.first().copied().unwrap_or_default();
    let six_times = |triangle: &[u32; 3]| {
        let [a, b, c] = corners(mesh, triangle).map(|p| sub(p, origin));
        dot(a, cross(b, c))
    };
    mesh.triangles.iter().map(six_times).sum::<f64>() / 6.0
}

/// By Euler's formula, of one closed piece.
fn genus(mesh: &Mesh) -> usize {
    // V - E + F = 2 - 2 genus, and E = 3 F / 2.
    (mesh.triangles.len() / 2 + 2).saturating_sub(mesh.positions.len()) / 2
}

/// Positions of a triangle's corners. Indices are checked where a scan is read.
fn corners(mesh: &Mesh, triangle: &[u32; 3]) -> [Point; 3] {
    triangle.map(|corner| mesh.positions.get(corner as usize).copied().unwrap_or_default())
}

fn area(mesh: &Mesh, triangle: &[u32; 3]) -> f64 {
    let [a, b, c] = corners(mesh, triangle);
    norm(cross(sub(b, a), sub(c, a))) / 2.0
}

/// Leaves out vertices that no triangle has.
fn drop_unused(mesh: &mut Mesh) {
    let mut moved = vec![u32::MAX; mesh.positions.len()];
    mesh.triangles.as_flattened().iter().for_each(|&corner| moved[corner as usize] = 0);
    let mut used = moved.clone().into_iter();
    mesh.positions.retain(|_| used.next() == Some(0));
    for (index, at) in moved.iter_mut().filter(|at| **at == 0).enumerate() {
        *at = index as u32;
    }
    mesh.triangles.as_flattened_mut().iter_mut().for_each(|c| *c = moved[*c as usize]);
}

//! From a scan as it was read to one clean surface: closed, manifold, facing outside, of a bounded size.
//!
//! Every vertex that stays is where the scan had it, unless there are too many ([`FACES_KEPT_MAX`]). What is missing is
//! closed, what is too much is left out, both are told; and where nothing sensible is left, there is a reason.

mod clean;
mod decimate;
mod holes;
mod manifold;

use super::read::Scan;
use super::{Mesh, Note, Unit, UnitError, unit};

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
        let stature = || stature.unwrap_or_else(|| self.mesh.extent());
        if self.unit_inferred { unit::ambiguity(self.unit, stature()) } else { None }
    }
}

/// A scan that was not repaired, by what to do about it.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RepairError {
    /// Every triangle was needless.
    #[error("no triangle has an area: export the scan again")]
    NoSurface,
    /// No piece is most of the surface.
    #[error(
        "{pieces} pieces that do not hang together, the largest with {share:.0} % of the surface: join them, or export the subject alone"
    )]
    Pieces {
        /// How many.
        pieces: usize,
        /// The area of the largest, in per cent of all.
        share: f64,
    },
    /// A hole is so large that it is not known what was there.
    #[error(
        "a hole with a perimeter of {perimeter:.0} % of the body's extent, and {area:.0} % of the surface: part of the \
         body is missing, scan it again"
    )]
    Hole {
        /// Its length in per cent of the largest extent.
        perimeter: f64,
        /// The area of what would close it, in per cent of the surface.
        area: f64,
    },
    /// The surface runs into itself in a way that no cut undoes.
    #[error("the surface is tangled beyond repair: make it manifold in the scanner's program")]
    Tangled,
    /// A sheet, and not a solid.
    #[error("the surface encloses nothing: export a closed mesh")]
    Flat,
    /// Of no body's size.
    #[error(transparent)]
    Unit(#[from] UnitError),
}

/// Repairs a scan. `unit` is what its user states; otherwise it is what the file tells, or inferred.
///
/// # Errors
/// [`RepairError`] where no single closed body is left, or its unit cannot be told.
pub fn repair(scan: Scan, unit: Option<Unit>) -> Result<Repaired, RepairError> {
    let Scan { mut mesh, unit: declared, mut notes, .. } = scan;
    clean::merge_duplicate_vertices(&mut mesh, &mut notes);
    clean::remove_spikes(&mut mesh, &mut notes);
    if mesh.triangles.len() > FACES_KEPT_MAX || !manifold::is_clean(&mesh) {
        repair_surface(&mut mesh, &mut notes)?;
    }
    let volume = mesh.volume();
    if volume.abs() < SOLIDITY_MIN * mesh.extent().powi(3) {
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
    let (unit, unit_inferred) = choose_unit(&mesh, unit.or(declared), &mut notes)?;
    Ok(Repaired { mesh, unit, unit_inferred, genus, notes })
}

fn repair_surface(mesh: &mut Mesh, notes: &mut Vec<Note>) -> Result<(), RepairError> {
    clean::remove_degenerate_triangles(mesh, notes);
    clean::close_cracks(mesh, notes);
    // Before what takes longer with every piece, and once more when the surface has been cut where it was tangled.
    clean::keep_largest(mesh, notes)?;
    decimate::decimate(mesh, FACES_KEPT_MAX, notes)?;
    manifold::make_manifold(mesh, notes);
    clean::keep_largest(mesh, notes)?;
    holes::close(mesh, notes)?;
    if manifold::is_clean(mesh) { Ok(()) } else { Err(RepairError::Tangled) }
}

fn choose_unit(
    mesh: &Mesh,
    stated: Option<Unit>,
    notes: &mut Vec<Note>,
) -> Result<(Unit, bool), RepairError> {
    if let Some(unit) = stated {
        if !unit.fits(mesh) {
            let mm = mesh.extent() * unit.mm();
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

/// By Euler's formula, of one closed piece.
fn genus(mesh: &Mesh) -> usize {
    // V - E + F = 2 - 2 genus, and E = 3 F / 2.
    (mesh.triangles.len() / 2 + 2).saturating_sub(mesh.positions.len()) / 2
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

//! Repair of a scan into one clean surface: closed, manifold, facing outwards, of bounded size.
//!
//! Vertices that remain keep their positions, unless there are too many ([`FACES_KEPT_MAX`]). Holes are closed and
//! stray pieces removed, each with a note; if no sensible surface is left, [`RepairError`] says why.

mod clean;
mod decimate;
mod holes;
mod manifold;

use super::read::Scan;
use super::{Mesh, Note, Unit, UnitError, unit};

/// Faces above which a surface is decimated. Joints move less than by a scanner's noise (Yu et al. 2008 use 5000
/// faces), and time and memory stay bounded.
pub const FACES_KEPT_MAX: usize = 60_000;
/// Minimum volume of a solid, as a fraction of its extent cubed; below it the surface is a sheet. The slimmest bodies
/// with arms spread have 0.01.
const SOLIDITY_MIN: f64 = 1e-3;

/// A repaired scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Repaired {
    /// Connected, closed, every edge shared by two triangles, facing outwards; in the scan's frame and unit.
    pub mesh: Mesh,
    /// The unit of `mesh`.
    pub unit: Unit,
    /// Whether the unit was inferred from the size, rather than stated by the user or the file.
    pub unit_inferred: bool,
    /// Number of handles, such as between an arm and a trunk that touch.
    pub genus: usize,
    /// What was found and done, notes on the file included.
    pub notes: Vec<Note>,
}

impl Repaired {
    /// A note if the inferred unit may be another. `stature` is in the mesh's unit
    /// ([`ScanAnalysis::body_scale`](super::ScanAnalysis::body_scale)); without it, the extent of the mesh counts.
    #[must_use]
    pub fn unit_ambiguity(&self, stature: Option<f64>) -> Option<Note> {
        let stature = || stature.unwrap_or_else(|| self.mesh.extent());
        if self.unit_inferred { unit::ambiguity(self.unit, stature()) } else { None }
    }
}

/// Why a scan could not be repaired.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RepairError {
    /// Every triangle was degenerate or a duplicate.
    #[error("no triangle has an area: export the scan again")]
    NoSurface,
    /// No piece holds most of the surface.
    #[error(
        "{pieces} disconnected pieces, the largest with {share:.0} % of the surface: join them, or export the subject alone"
    )]
    Pieces {
        /// Number of pieces.
        pieces: usize,
        /// Area of the largest, in per cent of the whole.
        share: f64,
    },
    /// A hole is too large to guess what was there.
    #[error(
        "a hole with a perimeter of {perimeter:.0} % of the body's extent, and {area:.0} % of the surface: part of the \
         body is missing, scan it again"
    )]
    Hole {
        /// Its perimeter, in per cent of the extent.
        perimeter: f64,
        /// Area of the patch that would close it, in per cent of the surface.
        area: f64,
    },
    /// The surface intersects itself in a way that no cut resolves.
    #[error("the surface is too tangled to repair: make it manifold in the scanner's software")]
    Tangled,
    /// A sheet, not a solid.
    #[error("the surface encloses no volume: export a closed mesh")]
    Flat,
    /// The size fits no unit.
    #[error(transparent)]
    Unit(#[from] UnitError),
}

/// Repairs a scan. `unit` is the unit that the user states; without it the file's unit counts, or the inferred one.
///
/// # Errors
/// [`RepairError`] if no single closed body is left, or its unit is unknown.
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
        notes.push(Note::new("inside-out", "flipped all faces, which pointed inwards"));
    }
    let genus = genus(&mesh);
    if genus > 0 {
        let handles = if genus == 1 { "a handle".into() } else { format!("{genus} handles") };
        let text = format!("the surface has {handles}: limbs may touch the body");
        notes.push(Note::new("handles", text));
    }
    let (unit, unit_inferred) = choose_unit(&mesh, unit.or(declared), &mut notes)?;
    Ok(Repaired { mesh, unit, unit_inferred, genus, notes })
}

fn repair_surface(mesh: &mut Mesh, notes: &mut Vec<Note>) -> Result<(), RepairError> {
    clean::remove_degenerate_triangles(mesh, notes);
    clean::close_cracks(mesh, notes);
    // Stray pieces go before the steps whose cost grows with them, and once more after tangles were cut.
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
            let text = format!("in {unit} the mesh is {mm:.0} mm across, not the size of a body");
            notes.push(Note::new("odd-size", text));
        }
        return Ok((unit, false));
    }
    let unit = Unit::infer(mesh)?;
    let text =
        format!("the file states no unit: assumed {unit}, in which it has the size of a body");
    notes.push(Note::new("unit-inferred", text));
    Ok((unit, true))
}

/// Genus of one closed piece, by Euler's formula.
fn genus(mesh: &Mesh) -> usize {
    // V - E + F = 2 - 2 genus, and E = 3 F / 2.
    (mesh.triangles.len() / 2 + 2).saturating_sub(mesh.positions.len()) / 2
}

/// Removes vertices that no triangle uses.
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

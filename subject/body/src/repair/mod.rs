//! Repair of a scan into one clean surface: closed, manifold, facing outwards, of bounded size.
//!
//! Vertices that remain keep their positions, unless there are too many ([`FACES_KEPT_MAX`]). What is not
//! part of the body's surface is removed (duplicate vertices and triangles, cracks, spikes and stray pieces) and holes
//! are closed, each with a note; if no sensible surface is left, [`RepairError`] says why.

mod manifold;

use std::collections::HashMap;

use self::manifold::{pair_half_edges, pieces};
use crate::{
    Mesh, Note, Unit, UnitError,
    mesh::{self, HalfEdge, Point, SparseRows, distance, edges, half_edges},
    read::Scan,
};

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
        if self.unit_inferred { mesh::ambiguity(self.unit, stature()) } else { None }
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
    merge_duplicate_vertices(&mut mesh, &mut notes);
    remove_spikes(&mut mesh, &mut notes);
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
    remove_degenerate_triangles(mesh, notes);
    close_cracks(mesh, notes);
    // Stray pieces go before the steps whose cost grows with them, and once more after tangles were cut.
    keep_largest(mesh, notes)?;
    decimate(mesh, FACES_KEPT_MAX, notes)?;
    manifold::make_manifold(mesh, notes);
    keep_largest(mesh, notes)?;
    manifold::close_holes(mesh, notes)?;
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

/// Border vertices closer than this fraction of the extent are merged: 0.02 mm on a body. Programs that write each part
/// by itself round in the seventh digit.
const CRACK: f64 = 1e-5;

/// Merges vertices at identical positions into the first of them, but only on edges that do not have exactly two
/// triangles: files that write each triangle's corners, or both sides of a seam, separately.
///
/// All other vertices are connected already, even those that share a position: lips and eyelids that touch, or points
/// that rounding brought together. Merging those would fuse surfaces that are separate.
fn merge_duplicate_vertices(mesh: &mut Mesh, notes: &mut Vec<Note>) {
    let n = mesh.positions.len();
    let mut loose = vec![false; n];
    let all = half_edges(&mesh.triangles);
    for edge in edges(&all).filter(|edge| edge.len() != 2) {
        edge[0].ends.iter().for_each(|&end| loose[end as usize] = true);
    }
    // Compares x first, since the rest is seldom needed. Adding zero unifies both zeros.
    let key = |index: &u32| mesh.positions[*index as usize].map(|c| (c + 0.0).to_bits());
    let x = |index: u32| (mesh.positions[index as usize][0] + 0.0).to_bits();
    let loose = (0..n as u32).filter(|index| loose[*index as usize]);
    let mut order: Vec<(u64, u32)> = loose.map(|index| (x(index), index)).collect();
    order.sort_unstable_by(|a, b| {
        a.0.cmp(&b.0).then_with(|| (key(&a.1), a.1).cmp(&(key(&b.1), b.1)))
    });
    let order: Vec<u32> = order.into_iter().map(|(_, index)| index).collect();
    let mut first: Vec<u32> = (0..n as u32).collect();
    let mut merged = 0;
    for same in order.chunk_by(|a, b| key(a) == key(b)) {
        for &index in &same[1..] {
            first[index as usize] = same[0];
            merged += 1;
        }
    }
    if merged > 0 {
        mesh.triangles.as_flattened_mut().iter_mut().for_each(|c| *c = first[*c as usize]);
        let text = format!("merged duplicate vertices: {merged}");
        notes.push(Note::new("vertices-merged", text));
    }
}

/// A surface is two-sided if more than this fraction of its triangles has a twin that faces the other way.
const TWO_SIDED: f64 = 0.5;

/// Removes degenerate triangles and duplicates of the same orientation, then unused vertices. Two triangles of opposite
/// orientation are the two sides of something thin and stay, unless the whole surface is two-sided.
fn remove_degenerate_triangles(mesh: &mut Mesh, notes: &mut Vec<Note>) {
    let all = mesh.triangles.len();
    mesh.triangles.retain(|&[a, b, c]| a != b && b != c && c != a);
    let degenerate = all - mesh.triangles.len();
    let key = |triangle: &[u32; 3]| {
        let mut key = *triangle;
        key.sort_unstable();
        key
    };
    // The orientation of a triangle relative to the sorted order of its vertices.
    let is_reversed = |&[a, b, c]: &[u32; 3]| (a < b) ^ (b < c) ^ (c < a);
    let mut order: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
    order.sort_unstable_by_key(|&index| (key(&mesh.triangles[index as usize]), index));
    let mut duplicate = vec![false; mesh.triangles.len()];
    let same =
        |a: &u32, b: &u32| key(&mesh.triangles[*a as usize]) == key(&mesh.triangles[*b as usize]);
    let mut twins = Vec::new();
    for group in order.chunk_by(same).filter(|group| group.len() > 1) {
        let orientation = |index: &u32| is_reversed(&mesh.triangles[*index as usize]);
        let twin = group.iter().position(|index| orientation(index) != orientation(&group[0]));
        for (at, &index) in group.iter().enumerate().skip(1) {
            duplicate[index as usize] = Some(at) != twin;
        }
        twins.extend(twin.map(|at| group[at]));
    }
    if 2.0 * twins.len() as f64 > TWO_SIDED * mesh.triangles.len() as f64 {
        twins.iter().for_each(|&index| duplicate[index as usize] = true);
    }
    let before = mesh.triangles.len();
    mesh.keep_triangles(|triangle| !duplicate[triangle]);
    let duplicates = before - mesh.triangles.len();
    drop_unused(mesh);
    if degenerate + duplicates > 0 {
        let text = format!("left out {degenerate} degenerate and {duplicates} duplicate triangles");
        notes.push(Note::new("needless-triangles", text));
    }
}

/// Merges border vertices that nearly coincide.
fn close_cracks(mesh: &mut Mesh, notes: &mut Vec<Note>) {
    let all = half_edges(&mesh.triangles);
    let mut border: Vec<u32> =
        edges(&all).filter(|edge| edge.len() == 1).flat_map(|edge| edge[0].ends).collect();
    border.sort_unstable();
    border.dedup();
    if border.is_empty() {
        return;
    }
    let near = CRACK * mesh.extent();
    // One vertex per cell is kept for comparison; others in the cell are close to it.
    let cell = |p: [f64; 3]| p.map(|c| (c / near).floor() as i64);
    let mut kept: HashMap<[i64; 3], u32> = HashMap::new();
    let mut moved = HashMap::new();
    for &vertex in &border {
        let p = mesh.positions[vertex as usize];
        let at = cell(p);
        let around = (0..27).map(|k| [at[0] + k % 3 - 1, at[1] + k / 3 % 3 - 1, at[2] + k / 9 - 1]);
        let close = around
            .filter_map(|at| kept.get(&at).copied())
            .find(|&other| distance(p, mesh.positions[other as usize]) <= near);
        match close {
            Some(other) => drop(moved.insert(vertex, other)),
            None => drop(kept.insert(at, vertex)),
        }
    }
    if moved.is_empty() {
        return;
    }
    let corners = mesh.triangles.as_flattened_mut().iter_mut();
    corners.for_each(|corner| *corner = moved.get(corner).copied().unwrap_or(*corner));
    let text = format!("merged border vertices that nearly coincide: {}", moved.len());
    notes.push(Note::new("cracks-closed", text));
    remove_degenerate_triangles(mesh, notes);
}

/// An edge of a spike is longer than this fraction of the extent: a fifth of a metre on a body.
const SPIKE_EXTENTS: f64 = 0.1;
/// It is also longer than this many median edges, which excludes coarse surfaces.
const SPIKE_MEDIANS: f64 = 12.0;
/// A larger fraction of such triangles is the way the surface was made, not spikes.
const SHARE_MAX: f64 = 0.01;

/// Removes triangles that reach far out; they leave holes.
fn remove_spikes(mesh: &mut Mesh, notes: &mut Vec<Note>) {
    let longest: Vec<f64> = mesh.triangles.iter().map(|t| longest_edge(mesh, t)).collect();
    let middle = longest.len() / 2;
    if middle == 0 {
        return;
    }
    let median = *longest.clone().select_nth_unstable_by(middle, f64::total_cmp).1;
    let limit = (SPIKE_MEDIANS * median).max(SPIKE_EXTENTS * mesh.extent());
    let n = longest.iter().filter(|&&edge| edge > limit).count();
    if n == 0 || n as f64 > SHARE_MAX * longest.len() as f64 {
        return;
    }
    mesh.keep_triangles(|triangle| longest[triangle] <= limit);
    drop_unused(mesh);
    notes.push(Note::new("spikes-cut", format!("removed triangles that reached far out: {n}")));
}

fn longest_edge(mesh: &Mesh, triangle: &[u32; 3]) -> f64 {
    let [a, b, c] = mesh.corners(*triangle);
    distance(a, b).max(distance(b, c)).max(distance(c, a))
}

/// Minimum area of the largest piece, as a fraction of the whole; below it the subject is ambiguous.
const SHARE_MIN: f64 = 0.6;

/// Keeps the piece with the largest area.
fn keep_largest(mesh: &mut Mesh, notes: &mut Vec<Note>) -> Result<(), RepairError> {
    let (across, _) = pair_half_edges(mesh);
    let pieces = pieces(&across);
    // A piece is identified by its first triangle.
    let count = (0_u32..).zip(&pieces).filter(|(triangle, piece)| triangle == *piece).count();
    let mut areas = vec![0.0; pieces.len()];
    for (piece, triangle) in pieces.iter().zip(&mesh.triangles) {
        areas[*piece as usize] += mesh.area_of(*triangle);
    }
    let all: f64 = areas.iter().sum();
    let best = areas.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
    let Some((best, &kept)) = best.filter(|_| all > 0.0) else {
        return Err(RepairError::NoSurface);
    };
    if count == 1 {
        return Ok(());
    }
    if kept < SHARE_MIN * all {
        return Err(RepairError::Pieces { pieces: count, share: 100.0 * kept / all });
    }
    areas[best] = 0.0;
    let second = areas.iter().copied().fold(0.0, f64::max);
    let text = format!(
        "left out other pieces: {}, {:.2} % of the surface, the largest {:.2} %",
        count - 1,
        100.0 * (all - kept) / all,
        100.0 * second / all
    );
    notes.push(Note::new("pieces-left-out", text));
    mesh.keep_triangles(|triangle| pieces[triangle] == best as u32);
    drop_unused(mesh);
    Ok(())
}

/// Number of radii that are tried, each a fifth larger.
const ROUNDS: usize = 20;
/// First radius, in side lengths of a square with the mean area per vertex.
const FIRST_RADIUS: f64 = 0.7;

/// Decimates the surface to at most `n_faces` faces.
///
/// Each cluster grows from the first unassigned vertex along edges within the radius, so sheets that merely come close,
/// such as an arm beside the trunk, stay apart. There is no grid: a rotated mesh gives the same clusters.
///
/// # Errors
/// [`RepairError::Tangled`] if no radius gives so few faces: the surface is more knot than sheet.
fn decimate(mesh: &mut Mesh, n_faces: usize, notes: &mut Vec<Note>) -> Result<(), RepairError> {
    let before = mesh.triangles.len();
    if before <= n_faces {
        return Ok(());
    }
    let mut radius = FIRST_RADIUS * (mesh.area() / (n_faces as f64 / 2.0)).sqrt();
    for _ in 0..ROUNDS {
        if mesh.triangles.len() <= n_faces {
            break;
        }
        coarsen(mesh, radius);
        radius *= 1.2;
    }
    if mesh.triangles.len() > n_faces {
        return Err(RepairError::Tangled);
    }
    let text = format!("decimated {before} faces to {}", mesh.triangles.len());
    notes.push(Note::new("decimated", text));
    Ok(())
}

fn coarsen(mesh: &mut Mesh, radius: f64) {
    let all = half_edges(&mesh.triangles);
    let there_and_back = |edge: &[HalfEdge]| {
        let [a, b] = edge[0].ends;
        [(a, b), (b, a)]
    };
    let neighbours = SparseRows::new(mesh.positions.len(), edges(&all).flat_map(there_and_back));
    let mut ball = vec![u32::MAX; mesh.positions.len()];
    let mut middles: Vec<[f64; 3]> = Vec::new();
    let mut reached = Vec::new();
    for seed in 0..mesh.positions.len() {
        if ball[seed] != u32::MAX {
            continue;
        }
        let (index, centre) = (middles.len() as u32, mesh.point(seed as u32));
        ball[seed] = index;
        reached.clear();
        reached.push(seed as u32);
        let (mut sum, mut next) = (Point::zeros(), 0);
        while let Some(&vertex) = reached.get(next) {
            next += 1;
            sum += mesh.point(vertex);
            for &other in neighbours.row(vertex) {
                if ball[other as usize] == u32::MAX && distance(mesh.point(other), centre) <= radius
                {
                    ball[other as usize] = index;
                    reached.push(other);
                }
            }
        }
        middles.push((sum * (1.0 / next as f64)).into());
    }
    mesh.triangles.as_flattened_mut().iter_mut().for_each(|c| *c = ball[*c as usize]);
    mesh.positions = middles;
    // Most triangles lie within one cluster and are degenerate now.
    remove_degenerate_triangles(mesh, &mut Vec::new());
}

#[cfg(test)]
mod tests {
    use super::{super::tests::sphere, decimate};

    #[test]
    fn a_turned_surface_is_made_coarser_in_the_same_way() {
        let mut mesh = sphere(40);
        let mut turned = mesh.clone();
        turned.positions.iter_mut().for_each(|p| *p = [p[1], p[2], p[0]]);
        for mesh in [&mut mesh, &mut turned] {
            decimate(mesh, 1200, &mut Vec::new()).unwrap();
        }
        assert_eq!(mesh.triangles, turned.triangles);
        assert!(mesh.triangles.len() <= 1200);
    }
}

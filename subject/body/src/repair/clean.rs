//! Removal of what is not part of the body's surface: duplicate vertices and triangles, cracks, spikes and stray
//! pieces.

use std::collections::HashMap;

use super::manifold::{pair_half_edges, pieces};
use super::{RepairError, drop_unused};
use crate::mesh::{distance, edges, half_edges};
use crate::{Mesh, Note};

/// Border vertices closer than this fraction of the extent are merged: 0.02 mm on a body. Programs that write each part
/// by itself round in the seventh digit.
const CRACK: f64 = 1e-5;

/// Merges vertices at identical positions into the first of them, but only on edges that do not have exactly two
/// triangles: files that write each triangle's corners, or both sides of a seam, separately.
///
/// All other vertices are connected already, even those that share a position: lips and eyelids that touch, or points
/// that rounding brought together. Merging those would fuse surfaces that are separate.
pub(super) fn merge_duplicate_vertices(mesh: &mut Mesh, notes: &mut Vec<Note>) {
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
pub(super) fn remove_degenerate_triangles(mesh: &mut Mesh, notes: &mut Vec<Note>) {
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
pub(super) fn close_cracks(mesh: &mut Mesh, notes: &mut Vec<Note>) {
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
pub(super) fn remove_spikes(mesh: &mut Mesh, notes: &mut Vec<Note>) {
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
pub(super) fn keep_largest(mesh: &mut Mesh, notes: &mut Vec<Note>) -> Result<(), RepairError> {
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

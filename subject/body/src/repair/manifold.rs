//! Makes the surface manifold and closed: at most two triangles per edge, facing the same way, and then no holes.

use std::collections::HashMap;

use super::{RepairError, drop_unused};
use crate::{
    Mesh, Note,
    mesh::{
        self, HalfEdge, Point, distance, edges, ends, find_root, half_edges, mean, union, unit,
    },
};

/// No half-edge.
const NONE: u32 = u32::MAX;
/// Maximum number of triangles at an edge that are paired; beyond that the edge is cut.
const FAN_MAX: usize = 16;

/// Maximum number of rounds of cutting; scans need one or two.
const ROUNDS: usize = 16;

/// Cuts edges with more than two triangles, orients triangles like their neighbours, and gives sheets that touch only
/// in a vertex a vertex each. Triangles that stay tangled, because sheets are connected all around them, are removed;
/// they leave holes.
pub(super) fn make_manifold(mesh: &mut Mesh, notes: &mut Vec<Note>) {
    let before = mesh.positions.len();
    let (mut tangled, mut turned, mut taken) = (0, 0, 0);
    for round in 0..ROUNDS {
        let (mut across, found) = pair_half_edges(mesh);
        let n = orient(&mut mesh.triangles, &mut across);
        if round == 0 {
            (tangled, turned) = (found, n);
        }
        split_vertices(mesh, &across);
        let n = remove_tangled(mesh);
        taken += n;
        if n == 0 {
            break;
        }
    }
    let split = mesh.positions.len().saturating_sub(before);
    drop_unused(mesh);
    let mut note = |n: usize, code: &'static str, text: &str| {
        if n > 0 {
            notes.push(Note::new(code, format!("{text}: {n}")));
        }
    };
    note(tangled, "edges-cut", "cut edges with more than two triangles");
    note(turned, "triangles-turned", "flipped triangles that faced away from their neighbours");
    note(split, "vertices-split", "split vertices where sheets only touched");
    note(taken, "triangles-taken-out", "removed tangled triangles");
}

/// Removes the triangles of edges that still have more than two of them, or two of opposite orientation.
fn remove_tangled(mesh: &mut Mesh) -> usize {
    let all = half_edges(&mesh.triangles);
    let mut out = vec![false; mesh.triangles.len()];
    for edge in edges(&all) {
        if !fits(mesh, edge) {
            edge.iter().for_each(|side| out[side.index as usize / 3] = true);
        }
    }
    let before = mesh.triangles.len();
    mesh.keep_triangles(|triangle| !out[triangle]);
    before - mesh.triangles.len()
}

/// The opposite half-edge of each half-edge, or [`NONE`], and the number of edges with more than two triangles.
///
/// Among more than two triangles, those pair up that face the same way and bend least: a sheet continues straight on.
pub(super) fn pair_half_edges(mesh: &Mesh) -> (Vec<u32>, usize) {
    let all = half_edges(&mesh.triangles);
    let mut across = vec![NONE; all.len()];
    let mut tangled = 0;
    for edge in edges(&all) {
        if let [a, b] = edge {
            (across[a.index as usize], across[b.index as usize]) = (b.index, a.index);
        } else if edge.len() > 2 {
            tangled += 1;
            let mut left: Vec<u32> = edge.iter().map(|side| side.index).collect();
            while (2..=FAN_MAX).contains(&left.len()) {
                let Some((i, j)) = flattest(mesh, &left) else { break };
                let (b, a) = (left.remove(j), left.remove(i));
                (across[a as usize], across[b as usize]) = (b, a);
            }
        }
    }
    (across, tangled)
}

/// The two half-edges of the flattest pair of triangles.
fn flattest(mesh: &Mesh, half_edges: &[u32]) -> Option<(usize, usize)> {
    let pairs = (0..half_edges.len()).flat_map(|i| (i + 1..half_edges.len()).map(move |j| (i, j)));
    let mut best = None;
    for (i, j) in pairs {
        let (normal_i, normal_j) = (normal(mesh, half_edges[i]), normal(mesh, half_edges[j]));
        let [from_i, _] = ends(&mesh.triangles, half_edges[i]);
        let [from_j, _] = ends(&mesh.triangles, half_edges[j]);
        // Triangles that traverse the edge in the same direction face opposite ways. Where sheets touch, triangles of
        // two sheets can be as flat as those of one, so equal orientation counts first.
        let same_way = from_i != from_j;
        let agreement = normal_i.dot(&normal_j) * if same_way { 1.0 } else { -1.0 };
        if best.is_none_or(|(_, most)| (same_way, agreement) > most) {
            best = Some(((i, j), (same_way, agreement)));
        }
    }
    best.map(|(pair, _)| pair)
}

fn normal(mesh: &Mesh, side: u32) -> Point {
    unit(mesh::normal(mesh.corners(mesh.triangles[side as usize / 3])))
}

/// Orients each piece consistently, as most of its triangles were, and returns the number flipped. Where that is
/// impossible, as on a Möbius strip, the edge is cut.
fn orient(triangles: &mut [[u32; 3]], across: &mut [u32]) -> usize {
    let mut flipped = vec![None; triangles.len()];
    let mut next = Vec::new();
    let mut turned = 0;
    let same_way =
        |triangles: &[[u32; 3]], a: u32, b: u32| ends(triangles, a)[0] == ends(triangles, b)[0];
    for first in 0..triangles.len() {
        if flipped[first].is_some() {
            continue;
        }
        flipped[first] = Some(false);
        let mut piece = vec![first];
        next.push(first);
        while let Some(at) = next.pop() {
            for k in 0..3 {
                let (side, other) = (3 * at + k, across[3 * at + k]);
                if other == NONE {
                    continue;
                }
                let neighbour = other as usize / 3;
                let is_flipped = flipped[at] != Some(same_way(triangles, side as u32, other));
                match flipped[neighbour] {
                    None => {
                        flipped[neighbour] = Some(is_flipped);
                        piece.push(neighbour);
                        next.push(neighbour);
                    }
                    Some(is) if is != is_flipped => {
                        (across[side], across[other as usize]) = (NONE, NONE);
                    }
                    Some(_) => {}
                }
            }
        }
        // The majority decides.
        let n_flipped = piece.iter().filter(|&&at| flipped[at] == Some(true)).count();
        let other_way = 2 * n_flipped > piece.len();
        for at in piece {
            if (flipped[at] == Some(true)) != other_way {
                flip(triangles, across, at);
                turned += 1;
            }
        }
    }
    turned
}

/// Swaps the last two corners, which exchanges the first and the last half-edge.
fn flip(triangles: &mut [[u32; 3]], across: &mut [u32], at: usize) {
    triangles[at].swap(1, 2);
    across.swap(3 * at, 3 * at + 2);
    for k in [0, 2] {
        let other = across[3 * at + k];
        if other != NONE {
            across[other as usize] = (3 * at + k) as u32;
        }
    }
}

/// Whether the surface is connected, with two triangles of equal orientation at every edge and one fan at every vertex.
pub(super) fn is_clean(mesh: &Mesh) -> bool {
    let all = half_edges(&mesh.triangles);
    if all.is_empty() || !edges(&all).all(|edge| edge.len() == 2 && fits(mesh, edge)) {
        return false;
    }
    let (across, _) = pair_half_edges(mesh);
    let fans = fans(&across).into_iter().enumerate().filter(|(at, fan)| *at as u32 == *fan);
    let is_one_piece = pieces(&across).iter().all(|piece| *piece == 0);
    is_one_piece && fans.count() == mesh.positions.len()
}

/// Whether an edge is a border, or joins two triangles of equal orientation.
fn fits(mesh: &Mesh, edge: &[HalfEdge]) -> bool {
    match edge {
        [_] => true,
        [a, b] => {
            let from = |side| ends(&mesh.triangles, side)[0];
            from(a.index) != from(b.index)
        }
        _ => false,
    }
}

/// For each triangle, the first triangle of its edge-connected piece.
pub(super) fn pieces(across: &[u32]) -> Vec<u32> {
    let mut first: Vec<u32> = (0..across.len() as u32 / 3).collect();
    for (side, &other) in (0_u32..).zip(across).filter(|(_, other)| **other != NONE) {
        union(&mut first, side / 3, other / 3);
    }
    (0..first.len() as u32).map(|triangle| find_root(&mut first, triangle)).collect()
}

/// For each corner, the first corner of its edge-connected fan.
fn fans(across: &[u32]) -> Vec<u32> {
    let mut leader: Vec<u32> = (0..across.len() as u32).collect();
    for (side, &other) in across.iter().enumerate() {
        if other == NONE || other < side as u32 {
            continue;
        }
        // A half-edge begins at the corner of its own number and ends at the next corner of the triangle.
        let ends = |side: u32| [side, side - side % 3 + (side + 1) % 3];
        let ([a, b], [c, d]) = (ends(side as u32), ends(other));
        for (one, two) in [(a, d), (b, c)] {
            union(&mut leader, one, two);
        }
    }
    (0..leader.len() as u32).map(|corner| find_root(&mut leader, corner)).collect()
}

/// Gives every edge-connected fan of triangles a vertex of its own.
fn split_vertices(mesh: &mut Mesh, across: &[u32]) {
    // The first fan keeps the vertex, the others get copies.
    let mut owner = vec![NONE; mesh.positions.len()];
    let mut copies = HashMap::new();
    for (corner, fan) in fans(across).into_iter().enumerate() {
        let vertex = mesh.triangles[corner / 3][corner % 3];
        if owner[vertex as usize] == NONE {
            owner[vertex as usize] = fan;
        }
        if owner[vertex as usize] != fan {
            let position = mesh.positions[vertex as usize];
            let copy = *copies.entry(fan).or_insert_with(|| {
                mesh.positions.push(position);
                mesh.positions.len() as u32 - 1
            });
            mesh.triangles[corner / 3][corner % 3] = copy;
        }
    }
}

/// Largest patch that is closed, as a fraction of the surface. A missing sole has 0.01, a neck 0.007, a leg cut at the
/// hip 0.02, a body cut at the waist 0.05.
const AREA_MAX: f64 = 0.03;
/// Maximum number of rings of vertices that fill a hole.
const RINGS_MAX: usize = 24;

/// Closes every hole with rings of triangles around its centroid.
pub(super) fn close_holes(mesh: &mut Mesh, notes: &mut Vec<Note>) -> Result<(), RepairError> {
    let borders = borders(mesh);
    if borders.is_empty() {
        return Ok(());
    }
    let whole = mesh.area();
    let across = mesh.extent();
    let mut longest = (0.0, 0.0);
    let count = borders.len();
    for border in borders {
        let perimeter = perimeter(mesh, &border);
        let before = mesh.triangles.len();
        fill(mesh, &border, perimeter);
        let filled: f64 = mesh.triangles[before..].iter().map(|t| mesh.area_of(*t)).sum();
        if filled > AREA_MAX * whole {
            let (perimeter, area) = (100.0 * perimeter / across, 100.0 * filled / whole);
            return Err(RepairError::Hole { perimeter, area });
        }
        if perimeter > longest.0 {
            longest = (perimeter, filled);
        }
    }
    let text = format!(
        "closed {count} {}, the longest {:.1} % of the extent around and {:.2} % of the surface",
        if count == 1 { "hole" } else { "holes" },
        100.0 * longest.0 / across,
        100.0 * longest.1 / whole
    );
    notes.push(Note::new("holes-closed", text));
    Ok(())
}

/// The vertices of each border loop, in the direction of its triangles. In a manifold a vertex lies on at most one.
fn borders(mesh: &Mesh) -> Vec<Vec<u32>> {
    let (across, _) = pair_half_edges(mesh);
    let mut after = vec![NONE; mesh.positions.len()];
    for (side, _) in across.iter().enumerate().filter(|(_, other)| **other == NONE) {
        let [from, to] = ends(&mesh.triangles, side as u32);
        after[from as usize] = to;
    }
    let mut borders = Vec::new();
    for first in 0..after.len() {
        let mut border = Vec::new();
        let mut at = first;
        while let Some(next) = after.get_mut(at).filter(|next| **next != NONE) {
            border.push(at as u32);
            at = std::mem::replace(next, NONE) as usize;
        }
        if !border.is_empty() {
            borders.push(border);
        }
    }
    borders
}

fn points(mesh: &Mesh, border: &[u32]) -> Vec<Point> {
    border.iter().map(|&vertex| mesh.point(vertex)).collect()
}

fn perimeter(mesh: &Mesh, border: &[u32]) -> f64 {
    let points = points(mesh, border);
    let after = points.iter().cycle().skip(1);
    points.iter().zip(after).map(|(&a, &b)| distance(a, b)).sum()
}

/// Fills a border loop with as many rings as make triangles about as long as its edges; the innermost ring is one
/// vertex.
fn fill(mesh: &mut Mesh, border: &[u32], perimeter: f64) {
    if let [a, b, c] = border[..] {
        mesh.triangles.push([c, b, a]);
        return;
    }
    let points = points(mesh, border);
    let Some(middle) = mean(points.iter().copied()) else { return };
    let radius = points.iter().map(|&p| (p - middle).norm()).sum::<f64>() / points.len() as f64;
    let edge = perimeter / points.len() as f64;
    let rings = ((radius / edge).round() as usize).clamp(1, RINGS_MAX);
    let n = border.len();
    let mut outer = border.to_vec();
    for ring in 1..rings {
        let share = ring as f64 / rings as f64;
        let first = mesh.positions.len() as u32;
        let towards_middle = |p: &Point| <[f64; 3]>::from(p + (middle - p) * share);
        mesh.positions.extend(points.iter().map(towards_middle));
        let inner: Vec<u32> = (first..first + n as u32).collect();
        for i in 0..n {
            let j = (i + 1) % n;
            mesh.triangles.push([outer[j], outer[i], inner[i]]);
            mesh.triangles.push([outer[j], inner[i], inner[j]]);
        }
        outer = inner;
    }
    let centre = mesh.positions.len() as u32;
    mesh.positions.push(middle.into());
    mesh.triangles.extend((0..n).map(|i| [outer[(i + 1) % n], outer[i], centre]));
}

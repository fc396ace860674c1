//! Single vertices far from where they belong.

use super::{corners, drop_unused};
use crate::geometry::distance;
use crate::unit::extent;
use crate::{Mesh, Note};

/// An edge of a spike is longer than this share of the extent: a fifth of a metre, on a body.
const EXTENTS: f64 = 0.1;
/// And longer than so many of the middle edges, which coarse surfaces have none of.
const MEDIANS: f64 = 12.0;
/// More of the triangles are no spikes but the way the surface was made.
const SHARE_MAX: f64 = 0.01;

/// Takes out triangles that reach far out: what they leave are holes.
pub(super) fn cut_off(mesh: &mut Mesh, notes: &mut Vec<Note>) {
    let mut longest: Vec<f64> = mesh.triangles.iter().map(|t| longest_edge(mesh, t)).collect();
    let middle = longest.len() / 2;
    if middle == 0 {
        return;
    }
    let median = *longest.select_nth_unstable_by(middle, f64::total_cmp).1;
    let limit = (MEDIANS * median).max(EXTENTS * extent(mesh));
    let n = longest.iter().filter(|&&edge| edge > limit).count();
    if n == 0 || n as f64 > SHARE_MAX * longest.len() as f64 {
        return;
    }
    let Mesh { positions, triangles } = std::mem::take(mesh);
    *mesh = Mesh { positions, triangles: Vec::new() };
    mesh.triangles = triangles.into_iter().filter(|t| longest_edge(mesh, t) <= limit).collect();
    drop_unused(mesh);
    notes.push(Note::new("spikes-cut", format!("{n} triangles reached far out: taken out")));
}

fn longest_edge(mesh: &Mesh, triangle: &[u32; 3]) -> f64 {
    let [a, b, c] = corners(mesh, triangle);
    distance(a, b).max(distance(b, c)).max(distance(c, a))
}

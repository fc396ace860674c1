//! From the inside of a body to its named ends.

use super::depth::Inside;
use super::frame::{area, in_principal_frame};
use super::grid::Grid;
use crate::Mesh;
use crate::extremity::Extremities;
use crate::extremity::candidates::standing_out;
use crate::extremity::find::{Ends, Told};
use crate::extremity::naming::name;
use crate::extremity::roles::{Misfit, misfit};
use crate::extremity::spread::distance;
use crate::geodesic::{Graph, Workspace, distances};

/// The edge of a cube, as a part of the square root of the surface's area: some 12 mm of an adult.
const STEP: f64 = 1.0 / 110.0;
/// The layers that are taken off, in cubes: none, one, and two by steps that diagonals make; a wrist is some five thick.
const LAYERS: [f64; 4] = [0.0, 1.0, 1.8, 2.2];

/// Finds head, hands and feet of a body whose limbs touch; none if no layer taken off leaves a body.
///
/// The ends are vertices of the surface, next to where the thinned inside ends.
pub(in super::super) fn find(
    mesh: &Mesh,
    graph: &Graph,
    workspace: &mut Workspace,
) -> Option<Ends> {
    let positions = in_principal_frame(mesh);
    let step = STEP * area(mesh).sqrt();
    let grid = Grid::new(&positions, &mesh.triangles, step)?;
    let inside = Inside::new(&grid, workspace);
    let mut best: Option<Thinned> = None;
    for layer in LAYERS {
        let thinned = inside.deeper_than(layer);
        let Some(start) = largest_piece(&thinned) else { break };
        let standing = standing_out(&thinned, start, workspace);
        let Ok(((misfit, ends), margin)) = name(&standing, misfit) else { continue };
        if best.as_ref().is_none_or(|best| misfit.rms < best.misfit.rms) {
            let peak = |end: usize| &standing.candidates[end].peak;
            let cubes = ends.map(|end| peak(end).vertex);
            let persistence = ends.map(|end| peak(end).persistence / standing.longest);
            best = Some(Thinned { cubes, persistence, misfit, margin });
        }
    }
    let Thinned { cubes, persistence, misfit, margin } = best?;
    let ends = cubes.map(|cube| {
        let centre = grid.centre(inside.cells[cube as usize]);
        nearest(&positions, graph, centre)
    });
    let [head, a, b, c, d] = ends;
    Some(Ends {
        extremities: Extremities { head, hands: [a, b], feet: [c, d] },
        fields: ends.map(|end| distances(graph, end, workspace)),
        spread: Vec::new(),
        persistence,
        told: Told::Inside,
        misfit,
        margin,
    })
}

/// What one thickness of layer gives.
struct Thinned {
    cubes: [u32; 5],
    persistence: [f64; 5],
    misfit: Misfit,
    margin: f64,
}

/// A vertex of the piece with the most vertices; none if nothing is linked.
fn largest_piece(graph: &Graph) -> Option<u32> {
    let mut seen = vec![false; graph.vertex_count()];
    let mut best = (1, None);
    for start in 0..graph.vertex_count() as u32 {
        if seen[start as usize] {
            continue;
        }
        seen[start as usize] = true;
        let (mut count, mut open) = (0, vec![start]);
        while let Some(vertex) = open.pop() {
            count += 1;
            for link in graph.links(vertex) {
                if !std::mem::replace(&mut seen[link.to as usize], true) {
                    open.push(link.to);
                }
            }
        }
        if count > best.0 {
            best = (count, Some(start));
        }
    }
    best.1
}

/// The vertex of the surface that is nearest to a place inside.
fn nearest(positions: &[[f64; 3]], graph: &Graph, place: [f64; 3]) -> u32 {
    let mut best = (f64::INFINITY, 0);
    for (vertex, at) in (0_u32..).zip(positions) {
        let far = distance(*at, place);
        if far < best.0 && !graph.links(vertex).is_empty() {
            best = (far, vertex);
        }
    }
    best.1
}

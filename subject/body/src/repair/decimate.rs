//! Fewer faces: vertices that lie together, and hang together, become one.

use super::{RepairError, area, edges, weld};
use crate::geometry::{Point, add, distance, scale};
use crate::{Mesh, Note};

/// Balls that are tried, each a fifth larger.
const ROUNDS: usize = 20;
/// Radius of the first balls, in the edge of a square of which there are as many as vertices.
const FIRST: f64 = 0.7;

/// Makes the surface coarser until it has at most so many faces.
///
/// Each ball begins at the first vertex that is in none, and takes what it reaches over edges within its radius, so that
/// sheets that merely come close, such as an arm beside a trunk, stay apart. No grid is laid: a turned mesh gives the
/// same balls.
///
/// # Errors
/// [`RepairError::Tangled`] where no ball makes so few: the surface is more knot than sheet.
pub(super) fn to(
    mesh: &mut Mesh,
    n_faces: usize,
    notes: &mut Vec<Note>,
) -> Result<(), RepairError> {
    let before = mesh.triangles.len();
    if before <= n_faces {
        return Ok(());
    }
    let whole: f64 = mesh.triangles.iter().map(|triangle| area(mesh, triangle)).sum();
    let mut radius = FIRST * (whole / (n_faces as f64 / 2.0)).sqrt();
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
    let text = format!("{before} faces are more than {n_faces}: made {}", mesh.triangles.len());
    notes.push(Note::new("decimated", text));
    Ok(())
}

fn coarsen(mesh: &mut Mesh, radius: f64) {
    let around = Around::new(mesh);
    let mut ball = vec![u32::MAX; mesh.positions.len()];
    let mut middles: Vec<Point> = Vec::new();
    let mut reached = Vec::new();
    for seed in 0..mesh.positions.len() {
        if ball[seed] != u32::MAX {
            continue;
        }
        let (index, centre) = (middles.len() as u32, mesh.positions[seed]);
        ball[seed] = index;
        reached.clear();
        reached.push(seed as u32);
        let (mut sum, mut next) = ([0.0; 3], 0);
        while let Some(&vertex) = reached.get(next) {
            next += 1;
            sum = add(sum, mesh.positions[vertex as usize]);
            for &other in around.of(vertex) {
                let p = mesh.positions[other as usize];
                if ball[other as usize] == u32::MAX && distance(p, centre) <= radius {
                    ball[other as usize] = index;
                    reached.push(other);
                }
            }
        }
        middles.push(scale(sum, 1.0 / next as f64));
    }
    mesh.triangles.as_flattened_mut().iter_mut().for_each(|c| *c = ball[*c as usize]);
    mesh.positions = middles;
    // Most triangles lie within a ball, and are none now.
    weld::needless_triangles(mesh, &mut Vec::new());
}

/// The vertices around each.
struct Around {
    starts: Vec<u32>,
    neighbours: Vec<u32>,
}

impl Around {
    fn new(mesh: &Mesh) -> Self {
        let edges = edges::sorted(&mesh.triangles);
        let mut starts = vec![0_u32; mesh.positions.len() + 1];
        for sides in edges::groups(&edges) {
            sides[0].ends.iter().for_each(|&end| starts[end as usize + 1] += 1);
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut fill = starts.clone();
        let mut neighbours = vec![0; starts.last().copied().unwrap_or(0) as usize];
        for sides in edges::groups(&edges) {
            let [a, b] = sides[0].ends;
            for (from, to) in [(a, b), (b, a)] {
                neighbours[fill[from as usize] as usize] = to;
                fill[from as usize] += 1;
            }
        }
        Self { starts, neighbours }
    }

    fn of(&self, vertex: u32) -> &[u32] {
        let at = vertex as usize;
        &self.neighbours[self.starts[at] as usize..self.starts[at + 1] as usize]
    }
}

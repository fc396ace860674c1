//! Decimation: connected vertices that lie close together become one.

use super::RepairError;
use super::clean::remove_degenerate_triangles;
use crate::mesh::{HalfEdge, Point, SparseRows, distance, edges, half_edges};
use crate::{Mesh, Note};

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
pub(super) fn decimate(
    mesh: &mut Mesh,
    n_faces: usize,
    notes: &mut Vec<Note>,
) -> Result<(), RepairError> {
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
    use super::decimate;
    use crate::tests::sphere;

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

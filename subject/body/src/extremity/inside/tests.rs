//! Tests of the interior: filling, depth and separation.

use super::{Grid, Inside, in_principal_frame};
use crate::Mesh;
use crate::geodesic::{Workspace, distances};
use crate::mesh::Point;
use crate::tests::{cubes, sphere};

/// Number of pieces after the outer layer of this thickness is removed.
fn pieces(inside: &Inside, layer: f64) -> usize {
    let graph = inside.deeper_than(layer);
    let mut seen = vec![false; graph.vertex_count()];
    let mut count = 0;
    for start in 0..graph.vertex_count() as u32 {
        if !seen[start as usize] && !graph.links(start).is_empty() {
            count += 1;
            let field = distances(&graph, start, &mut Workspace::default());
            seen.iter_mut().zip(&field).for_each(|(seen, far)| *seen |= far.is_finite());
        }
    }
    count
}

fn grid(mesh: &Mesh, step: f64) -> Option<Grid> {
    let positions: Vec<Point> = mesh.positions.iter().map(|at| Point::from(*at)).collect();
    Grid::new(&positions, &mesh.triangles, step)
}

fn filled(mesh: &Mesh, step: f64) -> Grid {
    grid(mesh, step).unwrap()
}

#[test]
fn a_sphere_is_filled_to_its_volume() {
    let grid = filled(&sphere(40), 0.05);
    let volume = grid.inside.iter().filter(|inside| **inside).count() as f64 * 0.05_f64.powi(3);
    let ball = 4.0 / 3.0 * std::f64::consts::PI;
    assert!((volume / ball - 1.0).abs() < 0.02, "{volume} of {ball}");
    for cell in (0..grid.inside.len()).filter(|cell| grid.inside[*cell]) {
        assert!(grid.centre(cell).iter().map(|part| part * part).sum::<f64>() < 1.0);
    }
}

#[test]
fn a_torn_surface_does_not_leak() {
    let mut mesh = sphere(20);
    mesh.triangles.truncate(mesh.triangles.len() - 30);
    let grid = filled(&mesh, 0.1);
    let outside =
        |cell: &usize| grid.centre(*cell).iter().map(|part| part * part).sum::<f64>() > 1.01;
    assert_eq!((0..grid.inside.len()).filter(|cell| grid.inside[*cell]).filter(outside).count(), 0);
}

#[test]
fn thick_parts_separate_where_they_touch() {
    // Two pillars, 4 wide and 12 high, fused over a strip of 2 by 1.
    let mut places = Vec::new();
    for z in 0..12 {
        for x in (0..4).chain(5..9) {
            places.extend((0..4).map(|y| [x, y, z]));
        }
    }
    places.extend([[4, 1, 6], [4, 2, 6]]);
    let mesh = cubes(&places);
    let inside = Inside::new(&filled(&mesh, 0.37), &mut Workspace::default());
    assert_eq!((pieces(&inside, 0.0), pieces(&inside, 2.0)), (1, 2));
}

#[test]
fn a_needle_is_refused_without_a_large_allocation() {
    let mesh = Mesh {
        positions: vec![[0.0; 3], [1e9, 0.0, 0.0], [0.0, 1.0, 1.0]],
        triangles: vec![[0, 1, 2]],
    };
    assert!(grid(&mesh, 1e-3).is_none());
}

#[test]
fn the_frame_rotates_with_the_body() {
    let mesh = cubes(&[
        [0, 0, 0],
        [1, 0, 0],
        [2, 0, 0],
        [3, 0, 0],
        [0, 1, 0],
        [1, 1, 0],
        [0, 0, 1],
        [0, 0, 2],
    ]);
    let (sin, cos) = 0.7_f64.sin_cos();
    let mut turned = mesh.clone();
    for at in &mut turned.positions {
        let [x, y, z] = *at;
        *at = [cos * x - sin * z + 5.0, y - 7.0, sin * x + cos * z];
    }
    assert!((mesh.area() - turned.area()).abs() < 1e-9);
    let apart = in_principal_frame(&mesh).into_iter().zip(in_principal_frame(&turned));
    let apart =
        apart.flat_map(|(one, other)| [0, 1, 2].map(|axis| (one[axis] - other[axis]).abs()));
    // Mirrored axes would differ by a whole unit; the frame is right-handed or left-handed for both alike.
    assert!(apart.fold(0.0, f64::max) < 1e-9);
}

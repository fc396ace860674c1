//! Level curves of tubes, and of torn and branching surfaces.

use std::f64::consts::PI;

use super::*;
use crate::Mesh;
use crate::geodesic::Adjacency;

/// A tube about z of elliptic section, 1 by `flat`, 2 long, open at both ends.
fn tube(around: u32, rows: u32, flat: f64) -> Mesh {
    let point = |row: u32, column: u32| {
        let angle = 2.0 * PI * f64::from(column) / f64::from(around);
        [angle.cos(), flat * angle.sin(), 2.0 * f64::from(row) / f64::from(rows - 1)]
    };
    let positions = (0..rows).flat_map(|row| (0..around).map(move |column| point(row, column)));
    let at = |row: u32, column: u32| row * around + column % around;
    let cells = (0..rows - 1).flat_map(|row| (0..around).map(move |column| (row, column)));
    let triangles = cells.flat_map(|(row, column)| {
        let [a, b] = [at(row, column), at(row, column + 1)];
        let [c, d] = [at(row + 1, column), at(row + 1, column + 1)];
        [[a, b, d], [a, d, c]]
    });
    Mesh { positions: positions.collect(), triangles: triangles.collect() }
}

fn heights(mesh: &Mesh) -> Vec<f64> {
    mesh.positions.iter().map(|at| at[2]).collect()
}

fn rings(mesh: &Mesh, values: Vec<f64>) -> Rings {
    cut(mesh, &Adjacency::new(mesh).unwrap(), &heights(mesh), values)
}

#[test]
fn a_round_tube_gives_circles_and_a_flat_one_less() {
    // At 0.5 rows and at 1.0 alike, though 1.0 is where vertices lie.
    for value in [0.35, 1.0] {
        let found = rings(&tube(64, 11, 1.0), vec![value]);
        assert_eq!(found.rings.len(), 1);
        let ring = &found.rings[0];
        assert!(ring.closed && (ring.circularity() - 1.0).abs() < 0.005, "{}", ring.circularity());
        assert!((ring.perimeter - 2.0 * PI).abs() < 0.01);
        assert!((ring.vector_area[2].abs() - PI).abs() < 0.01);
        assert!((ring.centroid[2] - value).abs() < 1e-12 && ring.centroid[0].abs() < 1e-9);
        assert!((ring.mean_point()[2] - value).abs() < 1e-12);
    }
    // Ramanujan's perimeter of an ellipse of 1 by 0.4 is 4.6026.
    let flat = rings(&tube(64, 11, 0.4), vec![0.35]).rings[0].circularity();
    let expected = 4.0 * PI * 0.4 * PI / 4.6026_f64.powi(2);
    assert!((flat - expected).abs() < 0.005, "{flat} of {expected}");
}

#[test]
fn rings_have_the_same_orientation() {
    let found = rings(&tube(24, 11, 1.0), even_levels(&heights(&tube(24, 11, 1.0)), 20));
    assert_eq!((found.values.len(), found.rings.len()), (19, 19));
    assert!(
        found
            .rings
            .iter()
            .all(|ring| ring.vector_area[2].signum() == found.rings[0].vector_area[2].signum())
    );
}

#[test]
fn a_ring_that_meets_a_hole_is_one_open_curve() {
    let mut mesh = tube(24, 11, 1.0);
    let whole = rings(&mesh, vec![0.9]).rings[0].clone();
    // Three cells' triangles at that height, so that the level is cut once.
    let torn = |corners: &[u32; 3]| {
        corners.iter().all(|at| {
            (4 * 24 + 5..4 * 24 + 9).contains(at) || (5 * 24 + 5..5 * 24 + 9).contains(at)
        })
    };
    mesh.triangles.retain(|corners| !torn(corners));
    let found = rings(&mesh, vec![0.9]);
    assert_eq!(found.rings.len(), 1);
    let ring = &found.rings[0];
    assert!(!ring.closed && ring.points.len() < whole.points.len());
    assert!((ring.perimeter - whole.perimeter).abs() < 0.05 * whole.perimeter);
    let apart = ring
        .points
        .windows(2)
        .map(|pair| (0..3).map(|axis| (pair[0][axis] - pair[1][axis]).powi(2)).sum::<f64>().sqrt());
    assert!(apart.fold(0.0, f64::max) < 0.3, "points in order");
}

#[test]
fn two_tubes_give_two_rings_a_level() {
    let mut mesh = tube(16, 6, 1.0);
    let count = mesh.positions.len() as u32;
    let more: Vec<_> = mesh.positions.iter().map(|[x, y, z]| [x + 3.0, *y, *z]).collect();
    mesh.positions.extend(more);
    let more: Vec<_> = mesh.triangles.iter().map(|corners| corners.map(|at| at + count)).collect();
    mesh.triangles.extend(more);
    let levels: Vec<u32> =
        rings(&mesh, vec![1.5, 0.5]).rings.iter().map(|ring| ring.level).collect();
    assert_eq!(levels, [0, 0, 1, 1]);
}

#[test]
fn an_unusable_field_gives_no_rings() {
    let mesh = tube(16, 6, 1.0);
    let adjacency = Adjacency::new(&mesh).unwrap();
    assert!(cut(&mesh, &adjacency, &[0.0, 1.0], vec![0.5]).rings.is_empty());
    let unreached = vec![f64::INFINITY; mesh.positions.len()];
    assert!(cut(&mesh, &adjacency, &unreached, vec![0.5]).rings.is_empty());
}

//! The method of Yu et al. 2008 on whole bodies.

use std::f64::consts::PI;

use mocapd_body::skeleton::Method;
use mocapd_body::{Mesh, Refusal, ScanAnalysis};
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};

/// A sphere of radius 1, in rows of latitude.
fn sphere(rows: u32) -> Mesh {
    let around = 2 * rows;
    let turn = |step: u32| PI * f64::from(step) / f64::from(rows);
    let mut mesh = Mesh { positions: vec![[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], triangles: vec![] };
    for row in 1..rows {
        let (level, down) = turn(row).sin_cos();
        let at = |column| [level * turn(column).cos(), level * turn(column).sin(), down];
        mesh.positions.extend((0..around).map(at));
    }
    let at = |row: u32, column: u32| 2 + (row - 1) * around + column % around;
    for column in 0..around {
        mesh.triangles.push([0, at(1, column), at(1, column + 1)]);
        mesh.triangles.push([1, at(rows - 1, column + 1), at(rows - 1, column)]);
        for row in 1..rows - 1 {
            let [a, b] = [at(row, column), at(row, column + 1)];
            let [c, d] = [at(row + 1, column), at(row + 1, column + 1)];
            mesh.triangles.extend([[a, c, d], [a, d, b]]);
        }
    }
    mesh
}

/// The reason why a body is refused.
fn refused(mesh: &Mesh) -> Option<Refusal> {
    ScanAnalysis::new(mesh, Method::Paper).err()
}

#[test]
fn failures_of_the_method_are_not_blamed_on_the_scan() {
    let mut of_method = 0;
    for (seed, pose) in [(1, Pose::T), (2, Pose::A), (3, Pose::Walk), (4, Pose::T), (5, Pose::A)] {
        let (mesh, _) = body(seed, pose, BodyOptions { n_faces: 4000, turned: false });
        let found = ScanAnalysis::new(&mesh, Method::Default);
        let Some(refusal) = refused(&mesh) else { continue };
        if found.is_ok_and(|found| !found.in_contact) {
            assert!(refusal.code().starts_with("paper-"), "{seed}: {refusal}");
            of_method += 1;
        }
    }
    assert!(of_method > 0, "all were found: nothing was tried");
    // No method accepts a ball as a body.
    let ball = refused(&sphere(20)).unwrap();
    assert!(!ball.code().starts_with("paper-"), "{ball}");
}

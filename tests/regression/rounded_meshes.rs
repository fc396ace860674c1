//! A closed body stays a body when its vertices are rounded, or lie in one place.

use mocapd_body::{
    Mesh, ScanAnalysis,
    read::{Format, Scan},
    repair::{RepairError, Repaired, repair},
    skeleton::Method,
};
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};

fn repaired(mesh: Mesh) -> Result<Repaired, RepairError> {
    repair(Scan { mesh, format: Format::Obj, unit: None, notes: Vec::new() }, None)
}

fn rounded(mesh: &Mesh, decimals: i32) -> Mesh {
    let unit = 10_f64.powi(decimals);
    let mut mesh = mesh.clone();
    mesh.positions.as_flattened_mut().iter_mut().for_each(|c| *c = (*c * unit).round() / unit);
    mesh
}

#[test]
fn rounding_the_vertices_refuses_no_body() {
    let poses = [(1, Pose::A, 5000), (2, Pose::Squat, 40_000), (3, Pose::Walk, 20_000)];
    for (seed, pose, n_faces) in poses {
        let (mesh, _) = body(seed, pose, BodyOptions { n_faces, turned: true });
        for decimals in [2, 3, 4, 5] {
            let rounded = rounded(&mesh, decimals);
            let found = repaired(rounded.clone()).unwrap();
            assert_eq!(found.genus, 0, "{pose:?} in {decimals} decimals");
            // Connected parts stay connected.
            assert!(found.mesh == rounded, "{pose:?} in {decimals} decimals");
            if decimals > 2 {
                ScanAnalysis::new(&found.mesh, Method::Default).unwrap();
            }
        }
    }
}

#[test]
fn lips_that_touch_stay_apart() {
    let (mut mesh, _) = body(4, Pose::Down, BodyOptions { n_faces: 6000, turned: false });
    // Two triangles with coinciding corners but no shared vertex: an upper lip on a lower one.
    let upper = mesh.triangles[100];
    let far = |corners: &[u32; 3]| corners.iter().all(|corner| !upper.contains(corner));
    let way = |corners: &[u32; 3]| {
        let [a, b] = [upper[0], corners[0]].map(|corner| mesh.positions[corner as usize]);
        (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>()
    };
    let apart = mesh.triangles.iter().filter(|corners| far(corners));
    let lower = *apart.min_by(|one, other| way(one).total_cmp(&way(other))).unwrap();
    for (one, other) in upper.into_iter().zip([lower[0], lower[2], lower[1]]) {
        mesh.positions[one as usize] = mesh.positions[other as usize];
    }
    let found = repaired(mesh.clone()).unwrap();
    assert_eq!(found.genus, 0);
    assert!(found.mesh == mesh, "{:?}", found.notes);
    assert!(found.notes.iter().all(|note| note.code == "unit-inferred"), "{:?}", found.notes);
}

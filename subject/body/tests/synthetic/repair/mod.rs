//! Clean bodies, and the kinds of damage that scans have.

mod damage;
mod refused;

use std::collections::HashMap;

use mocapd_body::Mesh;
use mocapd_body::read::{Format, Scan};
use mocapd_body::repair::{RepairError, Repaired, repair};
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};

fn clean() -> Mesh {
    body(1, Pose::A, BodyOptions { n_faces: 3000, turned: true }).0
}

fn repaired(mesh: Mesh) -> Result<Repaired, RepairError> {
    repair(Scan { mesh, format: Format::Obj, unit: None, notes: Vec::new() }, None)
}

fn volume(mesh: &Mesh) -> f64 {
    let determinant = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    mesh.triangles.iter().map(determinant).sum::<f64>() / 6.0
}

/// Asserts that the surface is closed, connected and oriented outward; returns V - E + F.
fn euler(mesh: &Mesh) -> i64 {
    let mut edges: HashMap<(u32, u32), u32> = HashMap::new();
    for (index, &[a, b, c]) in mesh.triangles.iter().enumerate() {
        for edge in [(a, b), (b, c), (c, a)] {
            assert_eq!(edges.insert(edge, index as u32), None, "an edge twice in one direction");
        }
    }
    assert!(edges.keys().all(|&(a, b)| edges.contains_key(&(b, a))), "a hole");
    let (mut reached, mut next) = (vec![false; mesh.triangles.len()], vec![0]);
    while let Some(at) = next.pop() {
        if !std::mem::replace(&mut reached[at as usize], true) {
            let [a, b, c] = mesh.triangles[at as usize];
            next.extend([(b, a), (c, b), (a, c)].map(|edge| edges[&edge]));
        }
    }
    assert!(reached.iter().all(|&r| r), "several pieces");
    assert!(volume(mesh) > 0.0);
    mesh.positions.len() as i64 - edges.len() as i64 / 2 + mesh.triangles.len() as i64
}

fn codes(repaired: &Repaired) -> Vec<&'static str> {
    repaired.notes.iter().map(|note| note.code).collect()
}

#[test]
fn a_clean_surface_is_unchanged() {
    let mesh = clean();
    let found = repaired(mesh.clone()).unwrap();
    assert_eq!(found.mesh, mesh);
    assert_eq!(found.genus, 0);
    assert_eq!(codes(&found), ["unit-inferred"]);
}

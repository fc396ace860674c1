//! Surfaces that are refused, with the reason.

use super::{clean, repaired};
use mocapd_body::read::{Format, Scan};
use mocapd_body::repair::{RepairError, repair};
use mocapd_body::{Mesh, Unit};
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};

/// The part below a plane.
fn below(mesh: &Mesh, axis: usize, height: f64) -> Mesh {
    let mut half = mesh.clone();
    let low = |triangle: &[u32; 3]| {
        triangle.iter().all(|&corner| mesh.positions[corner as usize][axis] < height)
    };
    half.triangles.retain(low);
    half
}

fn upright() -> Mesh {
    body(1, Pose::Down, BodyOptions { n_faces: 3000, turned: false }).0
}

#[test]
fn half_a_body_is_refused() {
    // Only the front, as from one camera. The cut at the waist detaches the hands.
    for half in [below(&upright(), 2, 0.01), below(&upright(), 1, 0.9)] {
        let error = repaired(half).unwrap_err();
        assert!(matches!(error, RepairError::Hole { .. }), "{error}");
    }
    // A body without soles is accepted.
    let mut mesh = upright();
    mesh.positions.iter_mut().for_each(|p| p[1] = -p[1]);
    mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(0, 1));
    let lowest = mesh.positions.iter().map(|p| p[1]).fold(f64::NEG_INFINITY, f64::max);
    assert!(repaired(below(&mesh, 1, lowest - 0.02)).is_ok());
}

#[test]
fn two_bodies_are_refused() {
    let mesh = clean();
    let mut both = mesh.clone();
    both.positions.extend(mesh.positions.iter().map(|p| [p[0] + 3.0, p[1], p[2]]));
    let n = mesh.positions.len() as u32;
    both.triangles.extend(mesh.triangles.iter().map(|t| t.map(|corner| corner + n)));
    let error = repaired(both).unwrap_err();
    assert!(matches!(error, RepairError::Pieces { pieces: 2, .. }), "{error}");
}

#[test]
fn surfaces_without_volume_are_refused() {
    assert_eq!(repaired(Mesh::default()), Err(RepairError::NoSurface));
    let point = Mesh { positions: vec![[1.0; 3]; 9], triangles: vec![[0, 1, 2], [4, 5, 6]] };
    assert_eq!(repaired(point), Err(RepairError::NoSurface));
    let mut flat = clean();
    flat.positions.iter_mut().for_each(|p| p[2] = 0.0);
    let error = repaired(flat).unwrap_err();
    assert!(matches!(error, RepairError::Flat | RepairError::Tangled), "{error}");
    // A sheet of paper: its boundary surrounds it.
    let mut sheet = Mesh::default();
    for i in 0..30_u32 {
        for j in 0..30_u32 {
            sheet.positions.push([f64::from(i) * 0.05, f64::from(j) * 0.05, 0.0]);
            if i > 0 && j > 0 {
                let at = 30 * i + j;
                sheet.triangles.extend([[at - 31, at - 1, at], [at - 31, at, at - 30]]);
            }
        }
    }
    assert!(matches!(repaired(sheet), Err(RepairError::Hole { .. })));
}

#[test]
fn a_size_that_fits_no_body_is_refused() {
    let mut large = clean();
    large.positions.as_flattened_mut().iter_mut().for_each(|c| *c *= 12.0);
    let error = repaired(large.clone()).unwrap_err();
    assert!(matches!(error, RepairError::Unit(_)), "{error}");
    // A stated unit is used in spite of an unlikely size, with a note.
    let scan = Scan { mesh: large, format: Format::Obj, unit: None, notes: Vec::new() };
    let found = repair(scan, Some(Unit::Centimetre)).unwrap();
    assert!(!found.unit_inferred && found.notes.iter().any(|note| note.code == "odd-size"));
}

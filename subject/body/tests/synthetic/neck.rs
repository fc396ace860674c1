//! Missing heads.

use mocapd_body::read::{Format, Scan};
use mocapd_body::repair::repair;
use mocapd_body::skeleton::Method;
use mocapd_body::{Joint, Mesh, ScanAnalysis, Unit};
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};

const UPRIGHT: BodyOptions = BodyOptions { n_faces: 5000, turned: false };

/// The part of a body below a height, closed.
fn below(mesh: Mesh, height: f64) -> Mesh {
    let Mesh { positions, mut triangles } = mesh;
    triangles.retain(|corners| corners.iter().all(|at| positions[*at as usize][1] < height));
    let mesh = Mesh { positions, triangles };
    let scan = Scan { mesh, format: Format::Obj, unit: None, notes: Vec::new() };
    repair(scan, Some(Unit::Metre)).unwrap().mesh
}

fn head_is_left_out(analysis: &ScanAnalysis) -> bool {
    analysis.notes.iter().any(|note| note.code == "head-left-out")
}

#[test]
fn whole_bodies_have_a_head_in_every_pose() {
    for (seed, pose) in (11..).zip(Pose::ALL) {
        let (mesh, _) = body(seed, pose, UPRIGHT);
        let analysis = ScanAnalysis::new(&mesh, Method::Default).unwrap();
        assert!(!head_is_left_out(&analysis), "{pose:?}");
        assert!(analysis.joints.estimates.contains_key(&Joint::Head), "{pose:?}");
    }
}

#[test]
fn a_cut_off_head_is_left_out_or_the_scan_refused() {
    let mut left_out = Vec::new();
    for (seed, pose) in (21..).zip([Pose::A, Pose::Down, Pose::Walk, Pose::A, Pose::T]) {
        let (mesh, truth) = body(seed, pose, UPRIGHT);
        let stature = truth.estimates[&Joint::Head].position[1];
        for height in [0.865, 0.88, 0.895] {
            let cut = below(mesh.clone(), height * stature);
            // A short neck's stump does not protrude, which leaves four extremities.
            let Ok(analysis) = ScanAnalysis::new(&cut, Method::Default) else { continue };
            assert!(head_is_left_out(&analysis), "{pose:?} {height}");
            let joints = &analysis.joints.estimates;
            assert!(!joints.contains_key(&Joint::Head) && !joints.contains_key(&Joint::Throat));
            assert!(joints.keys().filter(|joint| matches!(joint, Joint::Knee(_))).count() == 2);
            left_out.push((pose, height));
        }
    }
    assert!(left_out.len() >= 5, "{left_out:?}");
}

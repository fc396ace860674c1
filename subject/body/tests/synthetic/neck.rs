//! A head that is not there.

use mocapd_body::read::{Format, Scan};
use mocapd_body::repair::repair;
use mocapd_body::skeleton::Method;
use mocapd_body::{Joint, Mesh, Survey, Unit};
use mocapd_testkit::synthetic_body::{Options, Pose, body};

const UPRIGHT: Options = Options { n_faces: 5000, turned: false };

/// What is below a height, closed again.
fn below(mesh: Mesh, height: f64) -> Mesh {
    let Mesh { positions, mut triangles } = mesh;
    triangles.retain(|corners| corners.iter().all(|at| positions[*at as usize][1] < height));
    let mesh = Mesh { positions, triangles };
    let scan = Scan { mesh, format: Format::Obj, unit: None, notes: Vec::new() };
    repair(scan, Some(Unit::Metre)).unwrap().mesh
}

fn is_left_out(analysis: &Survey) -> bool {
    analysis.notes.iter().any(|note| note.code == "head-left-out")
}

#[test]
fn whole_bodies_have_a_head_in_every_pose() {
    for (seed, pose) in (11..).zip(Pose::ALL) {
        let (mesh, _) = body(seed, pose, UPRIGHT);
        let analysis = Survey::new(&mesh, Method::Default).unwrap();
        assert!(!is_left_out(&analysis), "{pose:?}");
        assert!(analysis.joints.estimates.contains_key(&Joint::Head), "{pose:?}");
    }
}

#[test]
fn a_head_that_is_cut_off_above_the_throat_is_left_out_or_the_scan_refused() {
    let mut left_out = Vec::new();
    for (seed, pose) in (21..).zip([Pose::A, Pose::Down, Pose::Walk, Pose::A, Pose::T]) {
        let (mesh, truth) = body(seed, pose, UPRIGHT);
        let stature = truth.estimates[&Joint::Head].position[1];
        for height in [0.865, 0.88, 0.895] {
            let cut = below(mesh.clone(), height * stature);
            // What is left of a short neck is no end of the body, and then there are four.
            let Ok(analysis) = Survey::new(&cut, Method::Default) else { continue };
            assert!(is_left_out(&analysis), "{pose:?} {height}");
            let told = &analysis.joints.estimates;
            assert!(!told.contains_key(&Joint::Head) && !told.contains_key(&Joint::Throat));
            assert!(told.keys().filter(|joint| matches!(joint, Joint::Knee(_))).count() == 2);
            left_out.push((pose, height));
        }
    }
    assert!(left_out.len() >= 5, "{left_out:?}");
}

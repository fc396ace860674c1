//! Touching limbs, missing heads, and joints that are not plausible.

use mocapd_body::read::{Format, Scan};
use mocapd_body::repair::repair;
use mocapd_body::skeleton::Method;
use mocapd_body::{Joint, Joints, Mesh, Plausibility, ScanAnalysis, Side, Unit};
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};

#[test]
fn free_limbs_are_certain_on_every_body_and_in_every_pose() {
    for seed in 0..3 {
        for pose in Pose::ALL {
            let (mesh, _) = body(seed, pose, BodyOptions::default());
            let analysis = ScanAnalysis::new(&mesh, Method::Default).unwrap();
            assert!(!analysis.in_contact, "{seed} {pose:?}");
        }
    }
}

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

/// Moves some joints towards another one, by a share of the distance.
fn moved(joints: &Joints, which: fn(Side) -> Joint, to: Joint, part: f64) -> Joints {
    let mut moved = joints.clone();
    let end = joints.estimates[&to].position;
    for side in [Side::Left, Side::Right] {
        let at = &mut moved.estimates.get_mut(&which(side)).unwrap().position;
        *at = [0, 1, 2].map(|axis| at[axis] + part * (end[axis] - at[axis]));
    }
    moved
}

#[test]
fn joints_of_bodies_are_plausible_and_displaced_ones_are_not() {
    for (seed, pose) in (1..).zip(Pose::ALL) {
        let (_, joints) = body(seed, pose, BodyOptions { n_faces: 500, turned: true });
        assert_eq!(Plausibility::of(&joints), Plausibility::Whole, "{pose:?}");
        let in_the_belly = moved(&joints, Joint::Shoulder, Joint::Pelvis, 0.8);
        assert_eq!(Plausibility::of(&in_the_belly), Plausibility::WithoutArms, "{pose:?}");
        let legs = moved(&joints, Joint::Hip, Joint::Ankle(Side::Left), 0.9);
        let legs = moved(&legs, Joint::Knee, Joint::Ankle(Side::Left), 0.9);
        assert_eq!(Plausibility::of(&legs), Plausibility::Nothing, "{pose:?}");
    }
    assert_eq!(Plausibility::of(&Joints::default()), Plausibility::Whole);
}

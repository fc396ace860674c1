//! Head, hands and feet of generated bodies.

use mocapd_body::extremity::{Ends, NamingMode, find};
use mocapd_body::geodesic::{Adjacency, Graph, Workspace};
use mocapd_body::{Joint, Joints, Mesh, Refusal, Side};
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};

fn ends(mesh: &Mesh) -> Result<Ends, Refusal> {
    let graph = Graph::with_short_cuts(mesh, &Adjacency::new(mesh)?);
    find(mesh, &graph, &mut Workspace::default())
}

fn at(joints: &Joints, joint: Joint) -> [f64; 3] {
    joints.estimates[&joint].position
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

/// Whether two extremities are each within `most` of a joint of their kind, on two sides.
fn pair(mesh: &Mesh, joints: &Joints, ends: [u32; 2], joint: fn(Side) -> Joint, most: f64) -> bool {
    let [a, b] = ends.map(|end| mesh.positions[end as usize]);
    let [left, right] = [Side::Left, Side::Right].map(|side| at(joints, joint(side)));
    let near = |one, other| apart(one, left) < most && apart(other, right) < most;
    near(a, b) || near(b, a)
}

#[test]
fn head_hands_and_feet_are_found_in_every_pose() {
    for (seed, pose) in (1..).zip(Pose::ALL) {
        let (mesh, joints) = body(seed, pose, BodyOptions { n_faces: 4000, turned: true });
        let side = Side::Left;
        let [hip, knee, ankle] = [Joint::Hip(side), Joint::Knee(side), Joint::Ankle(side)]
            .map(|joint| at(&joints, joint));
        let leg = apart(hip, knee) + apart(knee, ankle);
        let found = ends(&mesh).unwrap_or_else(|refusal| panic!("{pose:?}: {refusal}"));
        let named = found.extremities;
        assert_eq!(found.mode, NamingMode::FreeLimbs, "{pose:?}");
        assert!(found.confidence() > 0.5, "{pose:?}: {}", found.confidence());
        // A leg is half of the stature: a hand or a foot is less than a third of its length.
        assert!(pair(&mesh, &joints, named.hands, Joint::Wrist, 0.34 * leg), "{pose:?}");
        assert!(pair(&mesh, &joints, named.feet, Joint::Ankle, 0.34 * leg), "{pose:?}");
        let head = mesh.positions[named.head as usize];
        assert!(apart(head, at(&joints, Joint::Head)) < 0.2 * leg, "{pose:?}");
        for (end, field) in named.all().iter().zip(&found.fields) {
            assert!(field[*end as usize].abs() < 1e-12, "each field begins at its end");
        }
    }
}

#[test]
fn the_ends_are_invariant_to_rotation_translation_and_scale() {
    let (mesh, _) = body(7, Pose::Walk, BodyOptions { n_faces: 4000, turned: false });
    let whole = ends(&mesh).unwrap();
    let (sin, cos) = 1.1_f64.sin_cos();
    for scale in [1.0, 1000.0] {
        let mut turned = mesh.clone();
        for at in &mut turned.positions {
            let [x, y, z] = *at;
            let once = [cos * x - sin * y, sin * x + cos * y, z];
            let twice = [once[0], cos * once[1] - sin * once[2], sin * once[1] + cos * once[2]];
            *at = twice.map(|part| scale * (part + 3.0));
        }
        let found = ends(&turned).unwrap();
        assert_eq!(found.extremities, whole.extremities);
        assert!((found.misfit.rms - whole.misfit.rms).abs() < 1e-6);
    }
}

/// What remains, the kind of cut, and its position.
type Cut = (&'static str, fn([f64; 3], f64) -> [f64; 3], f64);

#[test]
fn a_missing_arm_is_detected() {
    let (mut mesh, joints) = body(5, Pose::A, BodyOptions { n_faces: 6000, turned: false });
    let elbow = at(&joints, Joint::Elbow(Side::Left))[0];
    mesh.positions.iter_mut().for_each(|at| at[0] = at[0].min(elbow));
    assert_eq!(ends(&mesh).unwrap().mode, NamingMode::CutLimb);
}

#[test]
fn a_part_of_a_body_is_refused() {
    // The missing part is pressed into the cutting plane, so that the surface stays closed.
    let (mesh, joints) = body(5, Pose::A, BodyOptions { n_faces: 6000, turned: false });
    let waist = at(&joints, Joint::Pelvis)[1] + 0.15;
    let knee = at(&joints, Joint::Knee(Side::Left))[1];
    let cuts: [Cut; 3] = [
        ("upper half", |[x, y, z], at| [x, y.max(at), z], waist),
        ("lower half", |[x, y, z], at| [x, y.min(at), z], waist),
        ("without shanks", |[x, y, z], at| [x, y.max(at), z], knee),
    ];
    for (what, cut, place) in cuts {
        let positions = mesh.positions.iter().map(|at| cut(*at, place)).collect();
        let part = Mesh { positions, triangles: mesh.triangles.clone() };
        let refusal = ends(&part).map(|found| found.misfit).expect_err(what);
        assert!(
            matches!(refusal.code(), "too-few-ends" | "not-a-body" | "ambiguous"),
            "{what}: {refusal}"
        );
    }
}

//! Other tests rely on these bodies, so they have to be exact.

use std::collections::HashMap;

use mocapd_body::{Joint, Joints, Mesh, Side};

use super::{BodyOptions, Point, Pose, body};

fn each() -> impl Iterator<Item = (u64, Pose, Mesh, Joints)> {
    let seeds = 0..4;
    seeds.flat_map(|seed| {
        Pose::ALL.into_iter().map(move |pose| {
            let n_faces = if seed % 2 == 0 { 5000 } else { 9000 };
            let (mesh, joints) = body(seed, pose, BodyOptions { n_faces, turned: seed > 1 });
            (seed, pose, mesh, joints)
        })
    })
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (Point::from(a) - Point::from(b)).norm()
}

/// Winding number of the surface around a point: 1 inside, 0 outside (van Oosterom and Strackee 1983).
fn winding(mesh: &Mesh, p: [f64; 3]) -> f64 {
    let solid_angle = |triangle: &[u32; 3]| {
        let [a, b, c] =
            triangle.map(|corner| Point::from(mesh.positions[corner as usize]) - Point::from(p));
        let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
        let below = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
        2.0 * a.dot(&b.cross(&c)).atan2(below)
    };
    mesh.triangles.iter().map(solid_angle).sum::<f64>() / (4.0 * std::f64::consts::PI)
}

#[test]
fn the_surface_is_closed_and_of_genus_0() {
    for (seed, pose, mesh, _) in each() {
        let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
        for &[a, b, c] in &mesh.triangles {
            for edge in [(a, b), (b, c), (c, a)] {
                assert_eq!(
                    edges.insert(edge, 1),
                    None,
                    "{seed} {pose:?}: an edge twice in one direction"
                );
            }
        }
        assert!(edges.keys().all(|&(a, b)| edges.contains_key(&(b, a))), "{seed} {pose:?}: a hole");
        let (v, e, f) = (mesh.positions.len(), edges.len() / 2, mesh.triangles.len());
        assert_eq!(v + f, e + 2, "{seed} {pose:?}: not a sphere");
        let mut reached = vec![false; v];
        let mut next = vec![0];
        let mut around = vec![Vec::new(); v];
        edges.keys().for_each(|&(a, b)| around[a as usize].push(b));
        while let Some(at) = next.pop() {
            if !std::mem::replace(&mut reached[at as usize], true) {
                next.extend(&around[at as usize]);
            }
        }
        assert!(reached.iter().all(|&r| r), "{seed} {pose:?}: several pieces");
        let expected = if seed % 2 == 0 { 5000.0 } else { 9000.0 };
        assert!((f as f64 / expected - 1.0).abs() < 0.1, "{seed} {pose:?}: {f} faces");
    }
}

#[test]
fn every_joint_is_inside_and_the_head_on_the_surface() {
    for (seed, pose, mesh, joints) in each() {
        assert_eq!(joints.estimates.len(), 15);
        for (joint, estimate) in &joints.estimates {
            let around = winding(&mesh, estimate.position);
            let nearest = mesh.positions.iter().map(|&p| distance(p, estimate.position));
            let nearest = nearest.fold(f64::INFINITY, f64::min);
            if *joint == Joint::Head {
                assert!(nearest < 0.03, "{seed} {pose:?}: {nearest} m from the head");
                continue;
            }
            assert!((around - 1.0).abs() < 1e-6, "{seed} {pose:?} {joint:?}: {around}");
            assert!(nearest > 0.01, "{seed} {pose:?} {joint:?}: {nearest}");
        }
    }
}

fn bones(joints: &Joints) -> Vec<f64> {
    let at = |joint: Joint| joints.estimates[&joint].position;
    [Side::Left, Side::Right]
        .into_iter()
        .flat_map(|s| {
            [
                (Joint::Shoulder(s), Joint::Elbow(s)),
                (Joint::Elbow(s), Joint::Wrist(s)),
                (Joint::Hip(s), Joint::Knee(s)),
                (Joint::Knee(s), Joint::Ankle(s)),
                (Joint::Throat, Joint::Shoulder(s)),
            ]
        })
        .map(|(a, b)| distance(at(a), at(b)))
        .collect()
}

#[test]
fn a_pose_moves_bones_and_does_not_stretch_them() {
    let of = |seed, pose| body(seed, pose, BodyOptions { n_faces: 2000, turned: true }).1;
    let standing = bones(&of(3, Pose::A));
    for pose in Pose::ALL {
        for (a, b) in standing.iter().zip(bones(&of(3, pose))) {
            assert!((a - b).abs() < 1e-12, "{pose:?}: {a} {b}");
        }
    }
    assert_ne!(standing, bones(&of(4, Pose::A)));
}

#[test]
fn left_is_left() {
    let (_, joints) = body(5, Pose::Walk, BodyOptions { n_faces: 2000, turned: true });
    let at = |joint: Joint| Point::from(joints.estimates[&joint].position);
    // Left x up is forward, where the left arm swings.
    let up = at(Joint::Throat) - at(Joint::Pelvis);
    let left = at(Joint::Hip(Side::Left)) - at(Joint::Hip(Side::Right));
    let arm = at(Joint::Wrist(Side::Left)) - at(Joint::Shoulder(Side::Left));
    assert!(left.cross(&up).dot(&arm) > 0.0);
}

#[test]
fn the_same_seed_gives_the_same_body() {
    let options = BodyOptions::default();
    assert_eq!(body(7, Pose::Sit, options), body(7, Pose::Sit, options));
    assert_ne!(body(7, Pose::Sit, options).0, body(8, Pose::Sit, options).0);
}

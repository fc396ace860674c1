//! A whole body made of capsules, sampled on voxels and smoothed.

use std::collections::BTreeMap;

use nalgebra::{Rotation3, Vector3};

use crate::{
    Joint, Joints, Mesh, Side,
    extremity::Extremities,
    geodesic::{Adjacency, Graph, Workspace, distances},
    locate::joints as joints_among,
    locate::{Landmarks, refine_ends},
};

type Point = Vector3<f64>;

/// Start, end and the radius at both, in metres.
pub(super) type Capsule = (Point, Point, f64, f64);

const CELL: f64 = 0.018;

/// The surface of the union of `capsules`.
fn surface(capsules: &[Capsule]) -> Mesh {
    let ends = || capsules.iter().flat_map(|(a, b, ..)| [*a, *b]);
    let low = ends().reduce(|a, b| a.inf(&b)).unwrap().add_scalar(-0.3);
    let high = ends().reduce(|a, b| a.sup(&b)).unwrap().add_scalar(0.3);
    let counts = ((high - low) / CELL).map(|count| count.ceil() as i32);
    let inside = |cell: [i32; 3]| {
        let at = low + Vector3::from(cell.map(|index| (f64::from(index) + 0.5) * CELL));
        capsules.iter().any(|capsule| within(capsule, at))
    };
    let filled: std::collections::BTreeSet<[i32; 3]> = (0..counts.x)
        .flat_map(|x| (0..counts.y).flat_map(move |y| (0..counts.z).map(move |z| [x, y, z])))
        .filter(|cell| inside(*cell))
        .collect();
    let (mut mesh, mut corners) = (Mesh::default(), BTreeMap::new());
    for cell in &filled {
        for axis in 0..3 {
            for step in [0, 1] {
                let mut beside = *cell;
                beside[axis] += 2 * step - 1;
                if filled.contains(&beside) {
                    continue;
                }
                let mut quad = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[a, b]| {
                    let mut corner = *cell;
                    corner[axis] += step;
                    corner[(axis + 1) % 3] += a;
                    corner[(axis + 2) % 3] += b;
                    *corners.entry(corner).or_insert_with(|| {
                        let at = low + Vector3::from(corner.map(f64::from)) * CELL;
                        mesh.positions.push(at.into());
                        mesh.positions.len() as u32 - 1
                    })
                });
                if step == 0 {
                    quad.reverse();
                }
                mesh.triangles.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
            }
        }
    }
    for _ in 0..6 {
        smooth(&mut mesh);
    }
    mesh
}

fn within((a, b, at_a, at_b): &Capsule, at: Point) -> bool {
    let part = ((at - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
    (at - a.lerp(b, part)).norm() < at_a + (at_b - at_a) * part
}

/// Moves every vertex half-way to the mean of its neighbours.
fn smooth(mesh: &mut Mesh) {
    let mut sums = vec![(Point::zeros(), 0.0); mesh.positions.len()];
    for triangle in &mesh.triangles {
        for corner in 0..3 {
            let (from, to) = (triangle[corner], triangle[(corner + 1) % 3]);
            sums[to as usize].0 += Point::from(mesh.positions[from as usize]);
            sums[to as usize].1 += 1.0;
        }
    }
    for (position, (sum, count)) in mesh.positions.iter_mut().zip(sums) {
        *position = ((Point::from(*position) + sum / count) / 2.0).into();
    }
}

const STATURE: f64 = 1.72;

/// A person who faces along z, head along y: the left is at positive x. The left elbow and the left knee are bent.
fn joints() -> Vec<(Joint, Point)> {
    let both = |joint: fn(Side) -> Joint, [x, y, z]: [f64; 3]| {
        [(joint(Side::Left), Point::new(x, y, z)), (joint(Side::Right), Point::new(-x, y, z))]
    };
    let mut joints = vec![
        (Joint::Elbow(Side::Left), Point::new(0.40, 1.26, 0.0)),
        (Joint::Wrist(Side::Left), Point::new(0.52, 1.30, 0.22)),
        (Joint::Elbow(Side::Right), Point::new(-0.40, 1.26, 0.0)),
        (Joint::Wrist(Side::Right), Point::new(-0.58, 1.14, 0.14)),
        (Joint::Knee(Side::Left), Point::new(0.12, 0.64, 0.32)),
        (Joint::Ankle(Side::Left), Point::new(0.13, 0.26, 0.12)),
        (Joint::Knee(Side::Right), Point::new(-0.14, 0.49, 0.02)),
        (Joint::Ankle(Side::Right), Point::new(-0.16, 0.08, 0.0)),
    ];
    joints.extend(both(Joint::Shoulder, [0.18, 1.40, 0.0]));
    joints.extend(both(Joint::Hip, [0.10, 0.90, 0.0]));
    joints
}

fn capsules() -> Vec<Capsule> {
    let joints = joints();
    let at = |joint: Joint| joints.iter().find(|(name, _)| *name == joint).unwrap().1;
    let mut body = vec![
        (Point::new(0.0, 1.62, 0.02), Point::new(0.0, 1.66, 0.02), 0.085, 0.085),
        (Point::new(0.0, 1.40, 0.0), Point::new(0.0, 1.62, 0.02), 0.055, 0.055),
        (Point::new(0.07, 1.30, 0.0), Point::new(0.05, 1.02, 0.0), 0.11, 0.10),
        (Point::new(-0.07, 1.30, 0.0), Point::new(-0.05, 1.02, 0.0), 0.11, 0.10),
        (Point::new(0.06, 0.97, 0.0), Point::new(-0.06, 0.97, 0.0), 0.11, 0.11),
    ];
    for side in Side::BOTH {
        let [shoulder, elbow, wrist] =
            [Joint::Shoulder(side), Joint::Elbow(side), Joint::Wrist(side)].map(at);
        let [hip, knee, ankle] = [Joint::Hip(side), Joint::Knee(side), Joint::Ankle(side)].map(at);
        let hand = wrist + (wrist - elbow).normalize() * 0.09;
        let toes = ankle + Point::new(0.0, -0.04, 0.17);
        body.extend([
            (Point::new(0.0, 1.38, 0.0), shoulder, 0.07, 0.06),
            (shoulder, elbow, 0.055, 0.042),
            (elbow, wrist, 0.042, 0.028),
            (hand, wrist + (hand - wrist) * 0.6, 0.042, 0.045),
            (wrist, hand, 0.028, 0.04),
            (hip, knee, 0.085, 0.055),
            (knee, ankle, 0.055, 0.038),
            (ankle - Point::new(0.0, 0.02, 0.02), toes, 0.042, 0.03),
        ]);
    }
    body
}

/// The outermost vertices in the directions of the extremities.
fn ends(mesh: &Mesh) -> Extremities {
    let joints = joints();
    let at = |joint: Joint| joints.iter().find(|(name, _)| *name == joint).unwrap().1;
    let farthest = |from: Point, to: Point| {
        let reach = |vertex: &[f64; 3]| {
            let at = Point::from(*vertex) - to;
            at.dot(&(to - from).normalize()) - 2.0 * (at.norm() - 0.15).max(0.0)
        };
        let all = (0..).zip(&mesh.positions);
        all.max_by(|one, other| reach(one.1).total_cmp(&reach(other.1))).unwrap().0
    };
    let hand = |side| farthest(at(Joint::Elbow(side)), at(Joint::Wrist(side)));
    let foot = |side| {
        let ankle = at(Joint::Ankle(side));
        farthest(ankle, ankle + Point::z() * 0.1)
    };
    Extremities {
        head: farthest(Point::zeros(), Point::new(0.0, 1.7, 0.0)),
        hands: [hand(Side::Left), hand(Side::Right)],
        feet: [foot(Side::Left), foot(Side::Right)],
    }
}

fn found(mesh: &Mesh, ends: &Extremities) -> Option<Joints> {
    let graph = Graph::with_short_cuts(mesh, &Adjacency::new(mesh).ok()?);
    let mut workspace = Workspace::default();
    let fields = ends.all().map(|end| distances(&graph, end, &mut workspace));
    let refined = refine_ends(&graph, ends, fields, &[], &mut workspace);
    Some(joints_among(&Landmarks::new(mesh, &refined.fields())?))
}

#[test]
fn joints_of_a_body_of_capsules_are_found_on_their_sides() {
    let mesh = surface(&capsules());
    let found = found(&mesh, &ends(&mesh)).unwrap();
    assert!(found.sides_told);
    assert_eq!(found.estimates.len(), 15);
    let mut errors: Vec<(f64, Joint)> = joints()
        .into_iter()
        .map(|(joint, at)| {
            let position = Point::from(found.estimates[&joint].position);
            ((position - at).norm() / STATURE, joint)
        })
        .collect();
    errors.sort_by(|one, other| other.0.total_cmp(&one.0));
    let mean = errors.iter().map(|error| error.0).sum::<f64>() / errors.len() as f64;
    // A body of capsules is not anatomical: no muscles, no heels, hips in the middle of the thighs.
    assert!(mean < 0.025 && errors[0].0 < 0.06, "{mean} {errors:?}");
    assert!(found.estimates.values().all(|one| (0.002..0.1).contains(&one.sigma)));
}

#[test]
fn joints_rotate_and_scale_with_the_body() {
    let mesh = surface(&capsules());
    let ends = ends(&mesh);
    let turn = Rotation3::from_euler_angles(0.4, 2.0, -1.1);
    let place = |at: [f64; 3]| (turn * Point::from(at)) * 1000.0 + Point::new(5e3, -2e4, 7.0);
    let positions = mesh.positions.iter().map(|at| place(*at).into()).collect();
    let turned = Mesh { positions, triangles: mesh.triangles.clone() };
    let (before, after) = (found(&mesh, &ends).unwrap(), found(&turned, &ends).unwrap());
    assert_eq!(before.sides_told, after.sides_told);
    for (joint, estimate) in &before.estimates {
        let apart = Point::from(after.estimates[joint].position) - place(estimate.position);
        assert!(apart.norm() / 1000.0 < 1e-6 * STATURE, "{joint:?} {apart}");
        assert!((after.estimates[joint].sigma / 1000.0 - estimate.sigma).abs() < 1e-9);
    }
}

#[test]
fn the_first_hand_may_be_either() {
    let mesh = surface(&capsules());
    let Extremities { head, hands: [a, b], feet: [c, d] } = ends(&mesh);
    let one = found(&mesh, &Extremities { head, hands: [a, b], feet: [c, d] }).unwrap();
    let other = found(&mesh, &Extremities { head, hands: [b, a], feet: [d, c] }).unwrap();
    for (joint, estimate) in &one.estimates {
        let apart = Point::from(other.estimates[joint].position) - Point::from(estimate.position);
        assert!(apart.norm() < 1e-9, "{joint:?}");
    }
}

#[test]
fn unconnected_ends_give_no_joints() {
    let mut mesh = surface(&capsules());
    let ends = ends(&mesh);
    let head = Extremities { head: u32::MAX, ..ends };
    assert!(found(&mesh, &head).is_none());
    mesh.positions.push([9.0; 3]);
    let apart = Extremities { head: mesh.positions.len() as u32 - 1, ..ends };
    assert!(found(&mesh, &apart).is_none());
    let same = Extremities { feet: [ends.feet[0]; 2], ..ends };
    assert!(found(&mesh, &same).is_none());
}

//! A body made of capsules, sampled on voxels and smoothed.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use crate::Mesh;

type Point = Vector3<f64>;

/// Start, end and the radius at both, in metres.
pub(super) type Capsule = (Point, Point, f64, f64);

const CELL: f64 = 0.018;

/// The surface of the union of `capsules`.
pub(super) fn surface(capsules: &[Capsule]) -> Mesh {
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

//! Simple surfaces for tests.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use super::Mesh;

/// A sphere of radius 1, in rows of latitude.
pub(crate) fn sphere(rows: u32) -> Mesh {
    let around = 2 * rows;
    let ring = |row: u32| PI * f64::from(row) / f64::from(rows);
    let mut positions = vec![[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
    for row in 1..rows {
        for column in 0..around {
            let turn = PI * f64::from(column) / f64::from(rows);
            let (down, level) = (ring(row).cos(), ring(row).sin());
            positions.push([level * turn.cos(), level * turn.sin(), down]);
        }
    }
    let at = |row: u32, column: u32| 2 + (row - 1) * around + column % around;
    let mut triangles = Vec::new();
    for column in 0..around {
        triangles.push([0, at(1, column), at(1, column + 1)]);
        triangles.push([1, at(rows - 1, column + 1), at(rows - 1, column)]);
        for row in 1..rows - 1 {
            let [a, b] = [at(row, column), at(row, column + 1)];
            let [c, d] = [at(row + 1, column), at(row + 1, column + 1)];
            triangles.extend([[a, c, d], [a, d, b]]);
        }
    }
    Mesh { positions, triangles }
}

/// The surface of unit cubes at these grid positions.
pub(crate) fn cubes(places: &[[i32; 3]]) -> Mesh {
    let mut mesh = Mesh::default();
    let mut known = BTreeMap::new();
    let full = |at: [i32; 3]| places.contains(&at);
    for place in places {
        for axis in 0..3 {
            for side in [0, 1] {
                let mut beside = *place;
                beside[axis] += 2 * side - 1;
                if full(beside) {
                    continue;
                }
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let mut corner = |a: i32, b: i32| {
                    let mut at = *place;
                    at[axis] += side;
                    at[u] += a;
                    at[v] += b;
                    *known.entry(at).or_insert_with(|| {
                        mesh.positions.push(at.map(f64::from));
                        mesh.positions.len() as u32 - 1
                    })
                };
                let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                let two = [[a, b, c], [a, c, d]];
                let turned = two.map(|[a, b, c]| if side == 1 { [a, b, c] } else { [a, c, b] });
                mesh.triangles.extend(turned);
            }
        }
    }
    mesh
}

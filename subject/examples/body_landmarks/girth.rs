//! The same body, leaner and stouter: bones stay, and with them the joints.

use mocapd_subject::body::extremity;
use mocapd_subject::body::geodesic::{Adjacency, Graph, Workspace};
use mocapd_subject::body::{Mesh, Refusal};
use nalgebra::Vector3;

/// How much a build adds.
pub(crate) struct Build {
    pub(crate) name: &'static str,
    /// Where the most is added, as a part of the way between the feet, which is about the stature.
    thickness: f64,
}

/// As it is; 2 cm less all round the waist; 4 cm more.
pub(crate) const BUILDS: [Build; 3] = [
    Build { name: "as-is", thickness: 0.0 },
    Build { name: "lean", thickness: -0.010 },
    Build { name: "stout", thickness: 0.022 },
];

/// Nothing is added up to here from hands, feet and crown, as a part of the way between the feet.
const BARE: f64 = 0.07;
/// The most is added from here on.
const FULL: f64 = 0.44;

/// Moves the surface outwards, the more the farther it is from the ends of the body.
pub(crate) fn changed(mesh: &Mesh, build: &Build) -> Result<Mesh, Refusal> {
    let graph = Graph::with_short_cuts(mesh, &Adjacency::new(mesh)?);
    let mut workspace = Workspace::default();
    let ends = extremity::find(mesh, &graph, &mut workspace)?;
    let feet = ends.fields[3][ends.extremities.feet[1] as usize];
    let normals = smoothed(mesh, &normals(mesh));
    let mut changed = mesh.clone();
    for (vertex, position) in changed.positions.iter_mut().enumerate() {
        let nearest = ends.fields.iter().map(|field| field[vertex]).fold(f64::INFINITY, f64::min);
        let part = ((nearest / feet - BARE) / (FULL - BARE)).clamp(0.0, 1.0);
        let moved = Vector3::from(*position) + normals[vertex] * (build.thickness * feet * part);
        *position = moved.into();
    }
    Ok(changed)
}

fn normals(mesh: &Mesh) -> Vec<Vector3<f64>> {
    let mut sums = vec![Vector3::zeros(); mesh.positions.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|corner| Vector3::from(mesh.positions[corner as usize]));
        let area = (b - a).cross(&(c - a));
        triangle.iter().for_each(|corner| sums[*corner as usize] += area);
    }
    sums.iter().map(|sum| sum.try_normalize(0.0).unwrap_or_default()).collect()
}

/// Means over the neighbours, or folds would cut through each other.
fn smoothed(mesh: &Mesh, normals: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let mut sums = normals.to_vec();
    for [a, b, c] in &mesh.triangles {
        for (to, from) in [(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)] {
            sums[*to as usize] += normals[*from as usize];
        }
    }
    sums.iter().map(|sum| sum.try_normalize(0.0).unwrap_or_default()).collect()
}

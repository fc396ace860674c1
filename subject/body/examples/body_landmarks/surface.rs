//! Fat and lean bodies: the surface is moved outwards or inwards, by different amounts on every part of the body.

use mocapd_body::Mesh;
use nalgebra::Vector3;

/// Thickness added to a body, in body scales, at positions along it; interpolated in between.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Girth {
    pub(crate) wrist: f64,
    pub(crate) forearm: f64,
    pub(crate) upper_arm: f64,
    pub(crate) ankle: f64,
    pub(crate) calf: f64,
    pub(crate) knee: f64,
    pub(crate) thigh: f64,
    pub(crate) trunk: f64,
}

impl Girth {
    /// Increases in proportion to the distance from the nearest extremity.
    pub(crate) fn evenly(trunk: f64) -> Self {
        let at = |distance: f64| trunk * ((distance - 0.076) / 0.404);
        let [wrist, forearm, upper_arm] = [0.14, 0.20, 0.33].map(at);
        let [ankle, calf, knee, thigh] = [0.16, 0.25, 0.345, 0.46].map(at);
        Self { wrist, forearm, upper_arm, ankle, calf, knee, thigh, trunk }
    }

    /// Thickness added at a vertex, by its distances from head, hands and feet in body scales.
    fn at(&self, distances: [f64; 5]) -> f64 {
        let [head, one, other, foot, other_foot] = distances;
        let (hand, foot) = (one.min(other), foot.min(other_foot));
        if head < hand && head < foot {
            return between(&[(0.16, 0.0), (0.36, self.trunk)], head);
        }
        if hand < foot {
            let (wrist, forearm) = ((0.14, self.wrist), (0.20, self.forearm));
            let (upper_arm, trunk) = ((0.33, self.upper_arm), (0.44, self.trunk));
            return between(&[(0.08, 0.0), wrist, forearm, upper_arm, trunk], hand);
        }
        let (ankle, calf) = ((0.16, self.ankle), (0.25, self.calf));
        let (knee, thigh, trunk) = ((0.345, self.knee), (0.46, self.thigh), (0.60, self.trunk));
        between(&[(0.08, 0.0), ankle, calf, knee, thigh, trunk], foot)
    }
}

/// Moves the surface along its normals; `fields` has a distance per vertex from each extremity, in units of `scale`.
pub(crate) fn moved(mesh: &Mesh, fields: &[Vec<f64>; 5], scale: f64, girth: &Girth) -> Mesh {
    let normals: Vec<Vector3<f64>> = means(mesh, &normals(mesh))
        .iter()
        .map(|sum| sum.try_normalize(0.0).unwrap_or_default())
        .collect();
    let mut added: Vec<f64> = (0..mesh.positions.len())
        .map(|vertex| girth.at(fields.each_ref().map(|field| field[vertex] / scale)))
        .collect();
    // Smoothed, because the thickness jumps where another extremity becomes the nearest.
    for _ in 0..12 {
        added = means(mesh, &added);
    }
    let mut changed = mesh.clone();
    for ((position, normal), added) in changed.positions.iter_mut().zip(&normals).zip(&added) {
        *position = (Vector3::from(*position) + normal * (added * scale)).into();
    }
    changed
}

fn between(places: &[(f64, f64)], at: f64) -> f64 {
    let first = places.first().map_or(0.0, |place| place.1);
    places.windows(2).fold(first, |value, pair| {
        let part = ((at - pair[0].0) / (pair[1].0 - pair[0].0)).clamp(0.0, 1.0);
        value + (pair[1].1 - pair[0].1) * part
    })
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

/// Means over a vertex and its neighbours.
fn means<T>(mesh: &Mesh, values: &[T]) -> Vec<T>
where
    T: Copy + std::ops::AddAssign + std::ops::Div<f64, Output = T>,
{
    let mut sums = values.to_vec();
    let mut counts = vec![1.0; values.len()];
    for [a, b, c] in &mesh.triangles {
        for (to, from) in [(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)] {
            sums[*to as usize] += values[*from as usize];
            counts[*to as usize] += 1.0;
        }
    }
    sums.iter().zip(&counts).map(|(sum, count)| *sum / *count).collect()
}

//! A frame that turns with the body.

use nalgebra::{Matrix3, Vector3};

use crate::Mesh;
use crate::extremity::spread::area_centroid;

/// Positions in the frame of the surface's principal axes about its centroid, so that a grid along them does not depend on
/// how the body was turned.
pub(super) fn in_principal_frame(mesh: &Mesh) -> Vec<[f64; 3]> {
    let centre = Vector3::from(area_centroid(mesh));
    let arms: Vec<Vector3<f64>> =
        mesh.positions.iter().map(|at| Vector3::from(*at) - centre).collect();
    let mut spread = Matrix3::zeros();
    let mut third = Vec::new();
    for corners in &mesh.triangles {
        let [a, b, c] = corners.map(|vertex| arms[vertex as usize]);
        let area = (b - a).cross(&(c - a)).norm() / 2.0;
        let middle = (a + b + c) / 3.0;
        spread += middle * middle.transpose() * area;
        third.push((middle, area));
    }
    let eigen = spread.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let axes = order.map(|at| {
        let axis: Vector3<f64> = eigen.eigenvectors.column(at).into_owned();
        // Of an axis' two directions, the one to which the surface reaches farther.
        let skew: f64 = third.iter().map(|(middle, area)| area * middle.dot(&axis).powi(3)).sum();
        if skew < 0.0 { -axis } else { axis }
    });
    arms.iter().map(|arm| axes.map(|axis| axis.dot(arm))).collect()
}

/// The area of the surface.
pub(super) fn area(mesh: &Mesh) -> f64 {
    let area = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|vertex| Vector3::from(mesh.positions[vertex as usize]));
        (b - a).cross(&(c - a)).norm() / 2.0
    };
    mesh.triangles.iter().map(area).sum()
}

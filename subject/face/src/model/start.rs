//! Where a fit begins.

use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};

use super::shape::Model;
use super::solve::{Observed, State};

/// Points on one line have a scatter of rank 1; a determinant of less than this share of its trace's square is that.
const FLAT: f64 = 1e-6;

/// The similarity that carries the average face, turned by `yaw_deg`, onto the points (weighted least squares).
pub(super) fn similarity(model: &Model, observed: &[Observed], yaw_deg: f64) -> Option<State> {
    let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), yaw_deg.to_radians()).into_inner();
    let places = model.feature_points(&model.vertices, &turn);
    let pairs: Vec<_> = observed
        .iter()
        .map(|o| {
            let seen = turn * Vector3::from(places[o.id.index()]);
            let weight = o.weight / (o.noise_io * o.noise_io);
            (weight, Vector2::new(seen.x, seen.y), Vector2::new(o.at[0], -o.at[1]))
        })
        .collect();
    let total: f64 = pairs.iter().map(|(weight, ..)| weight).sum();
    let from = pairs.iter().map(|(weight, a, _)| a * *weight).sum::<Vector2<f64>>() / total;
    let to = pairs.iter().map(|(weight, _, b)| b * *weight).sum::<Vector2<f64>>() / total;
    let (mut along, mut across, mut spread) = (0.0, 0.0, 0.0);
    let mut scatter = [0.0; 3];
    for (weight, a, b) in &pairs {
        let (a, b) = (a - from, b - to);
        along += weight * (a[0] * b[0] + a[1] * b[1]);
        across += weight * (a[0] * b[1] - a[1] * b[0]);
        spread += weight * (a[0] * a[0] + a[1] * a[1]);
        scatter[0] += weight * b[0] * b[0];
        scatter[1] += weight * b[0] * b[1];
        scatter[2] += weight * b[1] * b[1];
    }
    let flat = scatter[0] * scatter[2] - scatter[1] * scatter[1];
    let size = scatter[0] + scatter[2];
    let scale = along.hypot(across) / spread;
    if !(flat > FLAT * size * size && scale > 0.0 && scale.is_finite()) {
        return None;
    }
    let (sin, cos) = across.atan2(along).sin_cos();
    let roll = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
    let x = to[0] - scale * (cos * from[0] - sin * from[1]);
    let y = to[1] - scale * (sin * from[0] + cos * from[1]);
    let coefficients = vec![0.0; model.modes.len()];
    Some(State { rotation: roll * turn, scale, origin: [x, -y], coefficients })
}

//! Depth out of symmetry: in a turned head, what lies deeper is seen further to one side.

use crate::model::{Camera, FeatureId};

/// Below this yaw a pair's middle hardly moves with its depth, and noise would be divided by next to nothing.
const LEAST_YAW_DEG: f64 = 15.0;

/// For each of `points` its depth in pixels before the model's origin: from its partner on the other side of the face
/// where it has one and the head is turned enough, else the one that `expected_px` has for it.
///
/// The middle of a pair lies in the plane of symmetry. The origin of `camera` lies in that plane; with pitch and yaw known,
/// where the middle is seen tells how far before the origin it is. The pair's own distance does the rest.
pub fn symmetric_depths(
    camera: &Camera,
    points: &[(FeatureId, [f64; 2])],
    expected_px: &[f64],
) -> Vec<f64> {
    let upright = upright(camera, points);
    let (sin, cos) = camera.yaw_deg.to_radians().sin_cos();
    let (sin_pitch, cos_pitch) = camera.pitch_deg.to_radians().sin_cos();
    let enough = camera.yaw_deg.abs() >= LEAST_YAW_DEG && cos > 0.1;
    points
        .iter()
        .zip(expected_px)
        .enumerate()
        .map(|(i, ((id, _), &expected))| {
            let partner =
                mirrored(*id).and_then(|other| points.iter().position(|(id, _)| *id == other));
            let Some(j) = partner.filter(|_| enough && !id.is_contour()) else {
                return expected;
            };
            // In the face: half the pair's distance to the side, and how far to the front the middle is.
            let front = (upright[i][0] + upright[j][0]) / 2.0 / sin;
            let side = (upright[i][0] - upright[j][0]) / 2.0 / cos;
            // Turned by yaw, the depth before pitch; and pitch mixes it with the height, which is seen.
            let depth = front * cos - side * sin;
            let height = (upright[i][1] + depth * sin_pitch) / cos_pitch;
            height * sin_pitch + depth * cos_pitch
        })
        .collect()
}

/// The points from the camera's origin, y up, with roll taken out.
fn upright(camera: &Camera, points: &[(FeatureId, [f64; 2])]) -> Vec<[f64; 2]> {
    let (sin, cos) = camera.roll_deg.to_radians().sin_cos();
    let from_origin =
        points.iter().map(|(_, at)| [at[0] - camera.origin_px[0], camera.origin_px[1] - at[1]]);
    from_origin.map(|[x, y]| [cos * x + sin * y, cos * y - sin * x]).collect()
}

/// The point on the other side of the face.
fn mirrored(id: FeatureId) -> Option<FeatureId> {
    let name = id.name();
    let other = if name.contains("right") {
        name.replacen("right", "left", 1)
    } else if name.contains("left") {
        name.replacen("left", "right", 1)
    } else {
        return None;
    };
    FeatureId::from_name(&other)
}

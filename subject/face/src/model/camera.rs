//! A head in front of a camera: weak perspective.

use nalgebra::{Matrix3, Rotation3, Vector3};

/// How a model stands in a picture: turned, scaled and moved, without perspective.
///
/// Pixels count from 0 at the middle of the first pixel, x to the right, y down. Angles are right-handed in the model's
/// frame as the camera sees it (x right, y up, z to the camera): positive yaw turns the nose to the right of the picture,
/// positive pitch turns it down, and positive roll turns the head counter-clockwise. Yaw is applied first, then pitch,
/// then roll.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Pixels a millimetre of the model.
    pub scale_px_per_mm: f64,
    /// About the vertical axis.
    pub yaw_deg: f64,
    /// About the axis through the ears.
    pub pitch_deg: f64,
    /// About the camera's own axis.
    pub roll_deg: f64,
    /// Where the model's origin is seen.
    pub origin_px: [f64; 2],
}

impl Camera {
    /// The rotation from the model to the camera's axes (x right, y up, z to the camera).
    pub fn rotation(&self) -> Matrix3<f64> {
        let about = |axis, degrees: f64| {
            Rotation3::from_axis_angle(&axis, degrees.to_radians()).into_inner()
        };
        about(Vector3::z_axis(), self.roll_deg)
            * about(Vector3::x_axis(), self.pitch_deg)
            * about(Vector3::y_axis(), self.yaw_deg)
    }

    /// Where points of the model are seen: x and y, and how far before the model's origin, all in pixels.
    pub fn project(&self, points_mm: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let rotation = self.rotation() * self.scale_px_per_mm;
        let [x, y] = self.origin_px;
        points_mm
            .iter()
            .map(|&point| {
                let turned = rotation * Vector3::from(point);
                [x + turned.x, y - turned.y, turned.z]
            })
            .collect()
    }

    /// The inverse of [`project`](Self::project): from pixels, and depth in pixels, to the model's frame.
    ///
    /// A scale of zero has no inverse, and gives what is not finite.
    pub fn unproject(&self, points_px: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let back = self.rotation().transpose() / self.scale_px_per_mm;
        let [x, y] = self.origin_px;
        points_px
            .iter()
            .map(|&[u, v, depth]| (back * Vector3::new(u - x, y - v, depth)).into())
            .collect()
    }

    /// The angles of a rotation in the order that [`rotation`](Self::rotation) applies them: yaw, pitch, roll.
    pub(super) fn angles_deg(rotation: &Matrix3<f64>) -> [f64; 3] {
        let pitch = rotation[(2, 1)].clamp(-1.0, 1.0).asin();
        let yaw = (-rotation[(2, 0)]).atan2(rotation[(2, 2)]);
        let roll = (-rotation[(0, 1)]).atan2(rotation[(1, 1)]);
        [yaw, pitch, roll].map(f64::to_degrees)
    }
}

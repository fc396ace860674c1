//! The face cut out of the photograph: upright, and always of the same size, so that every length in this module's
//! neighbours is in the crop's own pixels whatever the photograph's were.

use super::Rough;
use super::reduced::Reduced;
use crate::{Photo, Plane};

/// Width of the crop (pixels): 1.3 distances of the outer eye corners to either side.
pub(crate) const WIDTH: usize = 224;
/// Height of the crop (pixels): from above the brows to below the chin of a long face.
pub(crate) const HEIGHT: usize = 256;
/// The middle of the eyes in the crop (pixels).
pub(crate) const EYES: [f64; 2] = [112.0, 92.0];
/// Distance of the eye centres of a frontal face in the crop (pixels).
pub(crate) const EYE_DISTANCE: f64 = 60.0;
/// Distance of the outer eye corners of a frontal face in the crop (pixels): `io` is 1.366 eye distances.
pub(crate) const IO: f64 = EYE_DISTANCE * 1.366;
/// From the middle of the eyes to the middle of the mouth, in distances of the eye centres of a frontal face.
const EYES_TO_MOUTH: f64 = 1.13;

/// An upright face of known size, and how to get back to the photograph.
#[derive(Debug, Clone)]
pub(crate) struct Crop {
    /// Photograph pixels per crop pixel.
    pub(crate) scale: f64,
    origin: [f64; 2],
    axis: [f64; 2],
    /// Red, green and blue, 0 to 255.
    pub(crate) rgb: [Plane; 3],
}

impl Crop {
    /// Cuts out the face that `rough` points at. Pixels beyond the photograph repeat its border.
    pub(crate) fn cut(photo: &Photo, rough: &Rough) -> Crop {
        let (l, r, m) = (rough.left_eye, rough.right_eye, rough.mouth);
        let mid = [(l[0] + r[0]) / 2.0, (l[1] + r[1]) / 2.0];
        let eyes = (r[0] - l[0]).hypot(r[1] - l[1]);
        let down = (m[0] - mid[0]).hypot(m[1] - mid[1]);
        // A turned head narrows the eyes' distance, a nodding one that of eyes and mouth: the larger one is nearer
        // to the truth.
        let scale = (eyes / EYE_DISTANCE).max(down / (EYE_DISTANCE * EYES_TO_MOUTH)).max(1e-3);
        let axis =
            if eyes > 1e-9 { [(r[0] - l[0]) / eyes, (r[1] - l[1]) / eyes] } else { [1.0, 0.0] };
        let blank = || Plane::filled(1, 1, 0.0);
        let mut crop = Crop { scale, origin: mid, axis, rgb: [blank(), blank(), blank()] };
        let corner = |x: usize, y: usize| crop.to_photo([x as f64, y as f64]);
        let corners = [corner(0, 0), corner(WIDTH, 0), corner(0, HEIGHT), corner(WIDTH, HEIGHT)];
        let source = Reduced::of(photo, corners, scale);
        let mut channels: [Vec<f32>; 3] =
            std::array::from_fn(|_| Vec::with_capacity(WIDTH * HEIGHT));
        for (y, x) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (y, x))) {
            let value = source.at(crop.to_photo([x as f64, y as f64]));
            for (channel, v) in channels.iter_mut().zip(value) {
                channel.push(v);
            }
        }
        crop.rgb = channels.map(|values| Plane::from_values(WIDTH, HEIGHT, values));
        crop
    }

    /// A point of the crop in the photograph (pixels).
    pub(crate) fn to_photo(&self, p: [f64; 2]) -> [f64; 2] {
        let (u, v) = ((p[0] - EYES[0]) * self.scale, (p[1] - EYES[1]) * self.scale);
        let [c, s] = self.axis;
        [self.origin[0] + c * u - s * v, self.origin[1] + s * u + c * v]
    }

    /// A point of the photograph in the crop (pixels).
    pub(crate) fn in_crop(&self, p: [f64; 2]) -> [f64; 2] {
        let (x, y) = ((p[0] - self.origin[0]) / self.scale, (p[1] - self.origin[1]) / self.scale);
        let [c, s] = self.axis;
        [EYES[0] + c * x + s * y, EYES[1] - s * x + c * y]
    }

    /// A channel made of the three, a pixel at a time.
    pub(crate) fn plane(&self, value: impl Fn([f32; 3]) -> f32) -> Plane {
        let [r, g, b] = &self.rgb;
        let values = r
            .values()
            .iter()
            .zip(g.values())
            .zip(b.values())
            .map(|((r, g), b)| value([*r, *g, *b]));
        Plane::from_values(WIDTH, HEIGHT, values.collect())
    }
}

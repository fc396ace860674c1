//! The generic face: a wireframe with named features, and the ways in which faces differ from it.
//!
//! Lengths are millimetres, nominal: the outer eye corners of the average face are [`OUTER_EYES_MM`] apart, and a
//! photograph says nothing about the true scale. x points to the face's own left, y up, z to the front; the origin lies
//! midway between the outer eye corners. `docs/subject-face-model.md` says how it was made.

mod feature;
mod fit;
mod parse;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::OnceLock;

use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

pub use feature::FeatureId;
pub use fit::{FitError, FitOptions, ShapeFit};
pub use parse::ModelError;

/// Distance of the outer eye corners of the average face. Adults measure 85 to 95 mm.
pub const OUTER_EYES_MM: f64 = 90.0;

/// What a mode tells apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ModeKind {
    /// One person from another.
    Identity,
    /// What one face does from what it does next.
    Expression,
}

/// One way in which a face differs from the average.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mode {
    /// Between people, or in one face.
    pub kind: ModeKind,
    /// Displacement of each vertex at one standard deviation, in millimetres.
    pub displacements: Vec<[f64; 3]>,
}

/// A place on an edge: a fraction of the way from one vertex to another.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
struct Anchor {
    from: usize,
    to: usize,
    fraction: f64,
}

/// A wireframe of the average face, and the modes in which faces differ from it. See the [module](self) for frame and unit.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Model {
    /// One position a vertex, in millimetres.
    pub vertices: Vec<[f64; 3]>,
    /// Three vertices a triangle, counter-clockwise from in front.
    pub triangles: Vec<[usize; 3]>,
    /// Named vertices: those of the 53 points that lie on the skin, and others (`nasion`, `nose_tip`, `chin`,
    /// `right_jaw_1` … `left_jaw_8`, `right_pupil`, `left_pupil`).
    pub features: BTreeMap<String, usize>,
    /// The modes, identity first. Two modes' displacements are orthogonal, but for rounding.
    pub modes: Vec<Mode>,
    /// For each point of the outline the places that become it as the head turns, from the middle of the face outward.
    contours: Vec<Vec<Anchor>>,
    /// For each of the other points, its vertex.
    #[serde(skip)]
    fixed: Vec<usize>,
}

const GENERIC: &str = include_str!("../../data/face-model.json");

impl Model {
    /// The model that comes with mocapd.
    ///
    /// # Errors
    /// None, unless the program was built with a damaged file.
    pub fn generic() -> Result<&'static Self, ModelError> {
        static MODEL: OnceLock<Result<Model, ModelError>> = OnceLock::new();
        MODEL.get_or_init(|| Self::parse(GENERIC)).as_ref().map_err(Clone::clone)
    }

    /// Reads a model in the format of `subject/face/data/face-model.json` (docs/subject-face-model.md).
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(text: &str) -> Result<Self, ModelError> {
        parse::model(text)
    }

    /// The vertices of a face: the average and so many standard deviations of each mode. Missing coefficients are 0.
    pub fn shape(&self, coefficients: &[f64]) -> Vec<[f64; 3]> {
        let mut vertices = self.vertices.clone();
        for (mode, amount) in self.modes.iter().zip(coefficients) {
            for (vertex, by) in vertices.iter_mut().zip(&mode.displacements) {
                for axis in 0..3 {
                    vertex[axis] += amount * by[axis];
                }
            }
        }
        vertices
    }

    /// Where the 53 points lie on a face, in the model's frame. The outline is that of a head turned by `rotation`.
    pub fn feature_points(&self, vertices: &[[f64; 3]], rotation: &Matrix3<f64>) -> Vec<[f64; 3]> {
        FeatureId::all().map(|id| self.anchor(id, vertices, rotation).on(vertices)).collect()
    }

    /// The place that is `id` as the camera sees it.
    fn anchor(&self, id: FeatureId, vertices: &[[f64; 3]], rotation: &Matrix3<f64>) -> Anchor {
        if let Some(fixed) = id.index().checked_sub(FeatureId::CONTOUR) {
            let vertex = self.fixed[fixed];
            return Anchor { from: vertex, to: vertex, fraction: 0.0 };
        }
        // Outward is across the face as the camera sees it: along its right, with roll taken out.
        let sign = if id.is_right() { -1.0 } else { 1.0 };
        let across = rotation.row(0) * rotation[(1, 1)] - rotation.row(1) * rotation[(0, 1)];
        let outward = |anchor: &Anchor| {
            let [x, y, z] = anchor.on(vertices);
            sign * (across[0] * x + across[1] * y + across[2] * z)
        };
        let mut best = self.contours[id.index()][0];
        let mut furthest = outward(&best);
        for anchor in &self.contours[id.index()][1..] {
            let reach = outward(anchor);
            if reach > furthest {
                (best, furthest) = (*anchor, reach);
            }
        }
        best
    }
}

impl Anchor {
    /// The place itself.
    fn on(&self, vertices: &[[f64; 3]]) -> [f64; 3] {
        let (from, to) = (vertices[self.from], vertices[self.to]);
        std::array::from_fn(|axis| from[axis] + self.fraction * (to[axis] - from[axis]))
    }
}

/// One of the 53 points of a photograph.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Landmark {
    /// Which.
    #[serde(rename = "name")]
    pub id: FeatureId,
    /// In the photograph: x to the right, y down, 0 at the middle of the first pixel.
    pub xy_px: [f64; 2],
    /// From 0 (guessed by the model) to 1 (seen): the weight of a fit.
    pub confidence: f64,
}

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
    fn angles_deg(rotation: &Matrix3<f64>) -> [f64; 3] {
        let pitch = rotation[(2, 1)].clamp(-1.0, 1.0).asin();
        let yaw = (-rotation[(2, 0)]).atan2(rotation[(2, 2)]);
        let roll = (-rotation[(0, 1)]).atan2(rotation[(1, 1)]);
        [yaw, pitch, roll].map(f64::to_degrees)
    }
}

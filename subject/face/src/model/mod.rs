//! The generic face: a wireframe with named features, the names of the 53 points of (Yang et al. 2004), and a linear
//! shape model of identity and expression.
//!
//! Lengths are nominal millimetres: the outer eye corners of the average face are [`OUTER_EYES_MM`] apart, and a
//! photograph says nothing about the true scale. x points to the face's own left, y up, z to the front; the origin is
//! midway between the outer eye corners. `docs/subject-face-model.md` describes how the model was made.

mod fit;
#[cfg(test)]
mod tests;

use std::{collections::BTreeMap, sync::OnceLock};

use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::shortened;
pub use fit::{FitError, FitOptions, ShapeFit};

/// Outer interocular distance of the average face. Adults measure 85 to 95 mm.
pub const OUTER_EYES_MM: f64 = 90.0;

/// What a mode describes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ModeKind {
    /// Differences between people.
    Identity,
    /// Expressions of one face.
    Expression,
}

/// A mode of variation.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mode {
    /// Identity or expression.
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

/// A wireframe of the average face with its modes of variation. See the [module](self) for frame and unit.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Model {
    /// One position per vertex, in millimetres.
    pub vertices: Vec<[f64; 3]>,
    /// Three vertices per triangle, counter-clockwise from the front.
    pub triangles: Vec<[usize; 3]>,
    /// Named vertices: those of the 53 points that lie on the skin, and others (`nasion`, `nose_tip`, `chin`,
    /// `right_jaw_1` … `left_jaw_8`, `right_pupil`, `left_pupil`).
    pub features: BTreeMap<String, usize>,
    /// The modes, identity first. Displacements of two modes are orthogonal, except for rounding.
    pub modes: Vec<Mode>,
    /// For each outline point, the places that it takes as the head turns, from the middle of the face outward.
    contours: Vec<Vec<Anchor>>,
    /// For each of the other points, its vertex.
    #[serde(skip)]
    fixed: Vec<usize>,
}

const GENERIC: &str = include_str!("../../data/face-model.json");

impl Model {
    /// The built-in model.
    ///
    /// # Errors
    /// None, unless the built-in file is damaged.
    pub fn generic() -> Result<&'static Self, ModelError> {
        static MODEL: OnceLock<Result<Model, ModelError>> = OnceLock::new();
        MODEL.get_or_init(|| Self::parse(GENERIC)).as_ref().map_err(Clone::clone)
    }

    /// Reads a model in the format of `subject/face/data/face-model.json` (docs/subject-face-model.md).
    ///
    /// # Errors
    /// [`ModelError`] with the reason.
    pub fn parse(text: &str) -> Result<Self, ModelError> {
        read_model(text)
    }

    /// The vertices of a face: the average plus each mode times its coefficient, in standard deviations. Missing
    /// coefficients are 0.
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

    /// The 53 points of a face in the model's frame. The outline is that of a head rotated by `rotation`.
    pub fn feature_points(&self, vertices: &[[f64; 3]], rotation: &Matrix3<f64>) -> Vec<[f64; 3]> {
        FeatureId::all().map(|id| self.anchor(id, vertices, rotation).on(vertices)).collect()
    }

    /// The place of point `id` as the camera sees it.
    fn anchor(&self, id: FeatureId, vertices: &[[f64; 3]], rotation: &Matrix3<f64>) -> Anchor {
        if let Some(fixed) = id.index().checked_sub(FeatureId::CONTOUR) {
            let vertex = self.fixed[fixed];
            return Anchor { from: vertex, to: vertex, fraction: 0.0 };
        }
        // Outward is along the camera's horizontal with roll removed.
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
    /// Position of the place.
    fn on(&self, vertices: &[[f64; 3]]) -> [f64; 3] {
        let (from, to) = (vertices[self.from], vertices[self.to]);
        std::array::from_fn(|axis| from[axis] + self.fraction * (to[axis] - from[axis]))
    }
}

/// One of the 53 points on a photograph.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Landmark {
    /// The point.
    #[serde(rename = "name")]
    pub id: FeatureId,
    /// Position in the photograph: x to the right, y down, 0 at the centre of the first pixel.
    pub xy_px: [f64; 2],
    /// 0 (guessed by the model) to 1 (clearly visible): the weight in a fit.
    pub confidence: f64,
}

/// A weak-perspective camera: rotation, scale and translation.
///
/// Pixels count from 0 at the centre of the first pixel, x to the right, y down. Angles are right-handed in the model's
/// frame as the camera sees it (x right, y up, z to the camera): positive yaw turns the nose to the right of the
/// picture, positive pitch turns it down, and positive roll turns the head counter-clockwise. Yaw is applied first,
/// then pitch, then roll.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Pixels per millimetre of the model.
    pub scale_px_per_mm: f64,
    /// Rotation about the vertical axis.
    pub yaw_deg: f64,
    /// Rotation about the axis through the ears.
    pub pitch_deg: f64,
    /// Rotation about the camera's axis.
    pub roll_deg: f64,
    /// Image of the model's origin.
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

    /// Projects points of the model: x, y and depth before the model's origin, all in pixels.
    pub fn project(&self, points_mm: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let rotation = self.rotation() * self.scale_px_per_mm;
        let [x, y] = self.origin_px;
        let place = |&point: &[f64; 3]| {
            let turned = rotation * Vector3::from(point);
            [x + turned.x, y - turned.y, turned.z]
        };
        points_mm.iter().map(place).collect()
    }

    /// The inverse of [`project`](Self::project): from pixels and depth in pixels to the model's frame.
    ///
    /// A scale of zero has no inverse and gives non-finite values.
    pub fn unproject(&self, points_px: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let back = self.rotation().transpose() / self.scale_px_per_mm;
        let [x, y] = self.origin_px;
        let place = |&[u, v, depth]: &[f64; 3]| back * Vector3::new(u - x, y - v, depth);
        points_px.iter().map(|point| place(point).into()).collect()
    }

    /// Yaw, pitch and roll of a rotation, in the order that [`rotation`](Self::rotation) applies them.
    fn angles_deg(rotation: &Matrix3<f64>) -> [f64; 3] {
        let pitch = rotation[(2, 1)].clamp(-1.0, 1.0).asin();
        let yaw = (-rotation[(2, 0)]).atan2(rotation[(2, 2)]);
        let roll = (-rotation[(0, 1)]).atan2(rotation[(1, 1)]);
        [yaw, pitch, roll].map(f64::to_degrees)
    }
}

const FORMAT: &str = "mocapd-face-model";
const VERSION: u32 = 2;
/// More than any wireframe needs; the cost of a fit grows with it.
const MAX_VERTICES: usize = 20_000;
const MAX_MODES: usize = 200;
/// Beyond any head, and within what a fit can handle.
const MAX_COORDINATE_MM: f64 = 1e7;

/// Why a text is not a model.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("not a face model: {0}")]
pub struct ModelError(String);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ModelFile {
    format: String,
    version: u32,
    #[serde(rename = "about")]
    _about: Option<String>,
    model: Model,
}

/// Reads the output of `subject/face/data/build/face_model.py`.
fn read_model(text: &str) -> Result<Model, ModelError> {
    let wrong = |what: String| ModelError(shortened(&what));
    let file: ModelFile = serde_json::from_str(text).map_err(|error| wrong(error.to_string()))?;
    if file.format != FORMAT || file.version != VERSION {
        let found = format!("{:?}, version {}", file.format, file.version);
        return Err(wrong(format!("expected {FORMAT:?}, version {VERSION}; found {found}")));
    }
    let mut model = file.model;
    check(&model).map_err(wrong)?;
    for id in FeatureId::all().skip(FeatureId::CONTOUR) {
        let vertex = model.features.get(id.name());
        model.fixed.push(*vertex.ok_or_else(|| wrong(format!("{} is missing", id.name())))?);
    }
    Ok(model)
}

/// Checks counts, indices and coordinates.
fn check(model: &Model) -> Result<(), String> {
    let count = model.vertices.len();
    if count > MAX_VERTICES || model.triangles.len() > 2 * MAX_VERTICES {
        let triangles = model.triangles.len();
        return Err(format!(
            "{count} vertices, {triangles} triangles; the limits are {MAX_VERTICES} and twice that"
        ));
    }
    if model.modes.len() > MAX_MODES {
        return Err(format!("{} modes, the limit is {MAX_MODES}", model.modes.len()));
    }
    if let Some(mode) = model.modes.iter().find(|mode| mode.displacements.len() != count) {
        return Err(format!("a mode moves {} of {count} vertices", mode.displacements.len()));
    }
    if model.contours.len() != FeatureId::CONTOUR || model.contours.iter().any(Vec::is_empty) {
        return Err(format!("expected {} non-empty outline rows", FeatureId::CONTOUR));
    }
    let places = || model.contours.iter().flatten();
    if let Some(place) = places().find(|place| !(0.0..=1.0).contains(&place.fraction)) {
        return Err(format!("a fraction of {}, expected 0 to 1", place.fraction));
    }
    let corners = model.triangles.iter().flatten().copied();
    let ends = places().flat_map(|place| [place.from, place.to]);
    let mut indices = corners.chain(model.features.values().copied()).chain(ends);
    if let Some(index) = indices.find(|&index| index >= count) {
        return Err(format!("vertex index {index}, expected less than {count}"));
    }
    let modes = model.modes.iter().flat_map(|mode| &mode.displacements);
    let mut lengths = model.vertices.iter().chain(modes).flatten();
    match lengths.find(|length| length.abs() > MAX_COORDINATE_MM) {
        Some(length) => Err(format!("coordinate {length} mm, the limit is {MAX_COORDINATE_MM}")),
        None => Ok(()),
    }
}

/// One of the 53 points that are located on a photograph (Yang et al. 2004): 12 of the outline, 10 of the brows, 5 of
/// the nose, 12 of the eyelids, 14 of the lips.
///
/// All but the outline are points of the iBUG-68 scheme, in its order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "&'static str", try_from = "String")]
pub struct FeatureId(u8);

impl From<FeatureId> for &'static str {
    fn from(id: FeatureId) -> Self {
        id.name()
    }
}

impl TryFrom<String> for FeatureId {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        Self::from_name(&name).ok_or_else(|| format!("none of the 53 points is called {name:?}"))
    }
}

/// Name and iBUG-68 number of each point.
const TABLE: [(&str, Option<u8>); FeatureId::COUNT] = [
    ("right_contour_top", None),
    ("right_contour_brow", None),
    ("right_contour_eye", None),
    ("right_contour_nose", None),
    ("right_contour_mouth", None),
    ("right_contour_chin", None),
    ("left_contour_top", None),
    ("left_contour_brow", None),
    ("left_contour_eye", None),
    ("left_contour_nose", None),
    ("left_contour_mouth", None),
    ("left_contour_chin", None),
    ("right_brow_1", Some(17)),
    ("right_brow_2", Some(18)),
    ("right_brow_3", Some(19)),
    ("right_brow_4", Some(20)),
    ("right_brow_5", Some(21)),
    ("left_brow_5", Some(22)),
    ("left_brow_4", Some(23)),
    ("left_brow_3", Some(24)),
    ("left_brow_2", Some(25)),
    ("left_brow_1", Some(26)),
    ("nose_right", Some(31)),
    ("nose_bottom_right", Some(32)),
    ("nose_bottom", Some(33)),
    ("nose_bottom_left", Some(34)),
    ("nose_left", Some(35)),
    ("right_eye_outer", Some(36)),
    ("right_eye_top_outer", Some(37)),
    ("right_eye_top_inner", Some(38)),
    ("right_eye_inner", Some(39)),
    ("right_eye_bottom_inner", Some(40)),
    ("right_eye_bottom_outer", Some(41)),
    ("left_eye_inner", Some(42)),
    ("left_eye_top_inner", Some(43)),
    ("left_eye_top_outer", Some(44)),
    ("left_eye_outer", Some(45)),
    ("left_eye_bottom_outer", Some(46)),
    ("left_eye_bottom_inner", Some(47)),
    ("mouth_right", Some(48)),
    ("mouth_top_right_outer", Some(49)),
    ("mouth_top_right", Some(50)),
    ("mouth_top", Some(51)),
    ("mouth_top_left", Some(52)),
    ("mouth_top_left_outer", Some(53)),
    ("mouth_left", Some(54)),
    ("mouth_bottom_left_outer", Some(55)),
    ("mouth_bottom_left", Some(56)),
    ("mouth_bottom", Some(57)),
    ("mouth_bottom_right", Some(58)),
    ("mouth_bottom_right_outer", Some(59)),
    ("mouth_inner_top", Some(62)),
    ("mouth_inner_bottom", Some(66)),
];

impl FeatureId {
    /// Number of points.
    pub const COUNT: usize = 53;
    /// Number of outline points, which come first.
    pub const CONTOUR: usize = 12;
    /// The outer corner of the right eye (iBUG 36).
    pub const RIGHT_EYE_OUTER: Self = Self(27);
    /// The outer corner of the left eye (iBUG 45).
    pub const LEFT_EYE_OUTER: Self = Self(36);

    /// All points in the order of [`index`](Self::index): the outline from the hairline down, right then left; then in
    /// the order of iBUG-68.
    pub fn all() -> impl ExactSizeIterator<Item = Self> + Clone {
        (0..Self::COUNT as u8).map(Self)
    }

    /// The point at `index`, if there is one.
    pub fn from_index(index: usize) -> Option<Self> {
        (index < Self::COUNT).then_some(Self(index as u8))
    }

    /// The point with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::all().find(|id| id.name() == name)
    }

    /// The point with this iBUG-68 number, from 0.
    pub fn from_ibug(point: usize) -> Option<Self> {
        Self::all().find(|id| id.ibug() == Some(point))
    }

    /// Index from 0 to 52.
    pub fn index(self) -> usize {
        self.0.into()
    }

    /// Its name in files, such as `right_eye_outer`. Right and left are the subject's own. Brows count from the temple
    /// inward.
    pub fn name(self) -> &'static str {
        TABLE[self.index()].0
    }

    /// Its iBUG-68 number, from 0; none for outline points, which that scheme places elsewhere.
    pub fn ibug(self) -> Option<usize> {
        TABLE[self.index()].1.map(Into::into)
    }

    /// Whether it is one of the two outline points at the hairline.
    #[must_use]
    pub fn is_hairline(self) -> bool {
        TABLE.get(self.index()).is_some_and(|(name, _)| name.ends_with("_contour_top"))
    }

    /// Whether it is on the subject's right, which is left in the picture of a face that looks at the camera.
    fn is_right(self) -> bool {
        self.name().starts_with("right_")
    }

    /// Whether it lies on the outline, and so has no fixed place on the skin.
    pub fn is_contour(self) -> bool {
        self.index() < Self::CONTOUR
    }
}

//! A fitted face: its contents, its files `face.json` and `face.obj` (Wavefront OBJ), and how it is drawn.
//!
//! `docs/subject-face-format.md` describes `face.json`. It contains no picture of a person: positions, names and the
//! photograph's hash.

mod pictures;

use std::{collections::BTreeMap, ops::Range};

use serde::{Deserialize, Serialize};

use super::model::{Camera, Landmark, Model, OUTER_EYES_MM};
use crate::{
    document::{DocumentError, Format},
    model::FeatureId,
    shortened,
};
pub use pictures::Overlay;

/// The chain that located the points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// The method of (Yang et al. 2004) as printed.
    Paper,
    /// This crate's method.
    Default,
}

impl Method {
    /// Its name in documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Default => "default",
        }
    }
}

/// The photograph.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Source {
    /// File name without folders.
    pub name: String,
    /// SHA-256 of its bytes: 64 digits, lower case.
    pub sha256: String,
    /// Width of the upright image in pixels; may be missing in a document.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub width: Option<u32>,
    /// Height of the upright image in pixels; may be missing in a document.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height: Option<u32>,
}

/// Orientation of a head: the angles of a [`Camera`], in degrees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Rotation about the vertical axis.
    pub yaw: f64,
    /// Rotation about the axis through the ears.
    pub pitch: f64,
    /// Rotation about the camera's axis.
    pub roll: f64,
}

/// A face fitted to a photograph. Serialised as in `docs/subject-face-format.md`: the fields in order, after `format`
/// and `version`. What a document may omit has a default or is an `Option`; another program's wireframe needs vertices
/// and lines.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FittedFace {
    /// The chain: [`Method::name`], or another program's; empty if unknown.
    #[serde(default)]
    pub method: String,
    /// The photograph.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source: Option<Source>,
    /// Orientation of the head in the photograph.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose_deg: Option<Pose>,
    /// Pixels per millimetre of the face.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_px_per_mm: Option<f64>,
    /// Position of the face's origin in the photograph.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub origin_px: Option<[f64; 2]>,
    /// Probability, 0 to 1, that the mean error of the points is below a tenth of the outer interocular distance; none
    /// if the chain cannot estimate it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub confidence: Option<f64>,
    /// Contradictions to the points being a face's, as phrases for people: lower case, no final dot.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// The 53 points in order, or none.
    #[serde(default)]
    pub points: Vec<Landmark>,
    /// Vertices of the wireframe, facing forward, in the frame and nominal millimetres of [`Model`].
    #[serde(alias = "vertices")]
    pub vertices_mm: Vec<[f64; 3]>,
    /// Two vertices per edge: the edges of the triangles, each once, and any other lines.
    pub lines: Vec<[usize; 2]>,
    /// Three vertices per triangle, counter-clockwise from the front; may be missing in a document.
    #[serde(default)]
    pub triangles: Vec<[usize; 3]>,
    /// Named vertices.
    #[serde(default)]
    pub features: BTreeMap<String, usize>,
}

impl FittedFace {
    /// Confidence below which a person should inspect the points.
    pub const SURE: f64 = 0.5;

    /// A face on the model's wireframe, without confidence and notes.
    pub fn new(
        model: &Model,
        method: Method,
        source: Source,
        camera: Camera,
        points: Vec<Landmark>,
        vertices_mm: Vec<[f64; 3]>,
    ) -> Self {
        let mut face = Self {
            method: method.name().to_owned(),
            source: Some(source),
            pose_deg: None,
            scale_px_per_mm: None,
            origin_px: None,
            confidence: None,
            notes: Vec::new(),
            points,
            vertices_mm,
            lines: edges(model.triangles.iter().copied()),
            triangles: model.triangles.clone(),
            features: model.features.clone(),
        };
        face.set_camera(camera);
        face
    }

    /// The camera of the photograph; none if it is unknown.
    pub fn camera(&self) -> Option<Camera> {
        let Pose { yaw, pitch, roll } = self.pose_deg?;
        Some(Camera {
            scale_px_per_mm: self.scale_px_per_mm?,
            yaw_deg: yaw,
            pitch_deg: pitch,
            roll_deg: roll,
            origin_px: self.origin_px?,
        })
    }

    /// Sets the camera of the photograph.
    pub fn set_camera(&mut self, camera: Camera) {
        let Camera { yaw_deg: yaw, pitch_deg: pitch, roll_deg: roll, .. } = camera;
        self.pose_deg = Some(Pose { yaw, pitch, roll });
        self.scale_px_per_mm = Some(camera.scale_px_per_mm);
        self.origin_px = Some(camera.origin_px);
    }

    /// Whether the points may be wrong: the confidence is known and low, or there are notes.
    pub fn is_unsure(&self) -> bool {
        self.confidence.is_some_and(|confidence| confidence < Self::SURE) || !self.notes.is_empty()
    }

    /// Each vertex in the photograph: x, y and depth before the model's origin, in pixels; none without a camera.
    pub fn vertices_px(&self) -> Option<Vec<[f64; 3]>> {
        Some(self.camera()?.project(&self.vertices_mm))
    }

    /// Outer interocular distance in pixels; 0 if the scale is unknown.
    pub fn outer_eyes_px(&self) -> f64 {
        self.scale_px_per_mm.unwrap_or_default() * OUTER_EYES_MM
    }

    /// The triangles that face the camera, for projected vertices.
    fn facing(&self, seen: &[[f64; 3]]) -> impl Iterator<Item = [usize; 3]> {
        self.triangles.iter().copied().filter(|triangle| {
            let [a, b, c] = triangle.map(|v| seen[v]);
            // Counter-clockwise from the front, with y down.
            (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) < 0.0
        })
    }
}

/// The edges of triangles, each once, as ascending pairs of vertices.
fn edges(triangles: impl Iterator<Item = [usize; 3]>) -> Vec<[usize; 2]> {
    let mut edges: Vec<_> = triangles
        .flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]])
        .map(|[a, b]| [a.min(b), a.max(b)])
        .collect();
    edges.sort_unstable();
    edges.dedup();
    edges
}

/// A facial feature with its own colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Outline of the face.
    Contour,
    /// Brows.
    Brow,
    /// Eyelids.
    Eye,
    /// Wings and base of the nose.
    Nose,
    /// Lips.
    Mouth,
}

/// A line through points.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Curve {
    /// The feature.
    pub part: Part,
    /// The points in order.
    pub points: Vec<FeatureId>,
    /// Whether the last point connects to the first.
    pub closed: bool,
}

impl Part {
    /// Red, green and blue, distinct for all kinds of colour vision (Okabe and Ito 2008), on skin and on paper.
    pub fn colour(self) -> [u8; 3] {
        match self {
            Self::Contour => [0x00, 0x72, 0xb2],
            Self::Brow => [0x00, 0x9e, 0x73],
            Self::Eye => [0xf0, 0xe4, 0x42],
            Self::Nose => [0xe6, 0x9f, 0x00],
            Self::Mouth => [0xcc, 0x79, 0xa7],
        }
    }

    /// The feature of a point.
    pub fn of(id: FeatureId) -> Self {
        match id.index() {
            0..12 => Self::Contour,
            12..22 => Self::Brow,
            22..27 => Self::Nose,
            27..39 => Self::Eye,
            _ => Self::Mouth,
        }
    }
}

impl Curve {
    /// All lines of a face.
    pub fn all() -> Vec<Self> {
        let line = |part, points: Range<usize>, closed| Self {
            part,
            points: points.filter_map(FeatureId::from_index).collect(),
            closed,
        };
        // The line between the lips: from corner to corner, over and under the opening.
        let lips = [39, 51, 45, 52].into_iter().filter_map(FeatureId::from_index).collect();
        vec![
            line(Part::Contour, 0..6, false),
            line(Part::Contour, 6..12, false),
            line(Part::Brow, 12..17, false),
            line(Part::Brow, 17..22, false),
            line(Part::Nose, 22..27, false),
            line(Part::Eye, 27..33, true),
            line(Part::Eye, 33..39, true),
            line(Part::Mouth, 39..51, true),
            Self { part: Part::Mouth, points: lips, closed: true },
        ]
    }
}

const FACE: Format = Format {
    name: "mocapd-face",
    version: 1,
    made_by: "which `mocapd subject face -o` writes",
    // Six times the size of the generic model, and the most that a take holds.
    bytes_max: 1 << 20,
};
/// Maximum number of vertices, and of lines.
const PARTS_MAX: usize = 1 << 17;
const NOTES_MAX: usize = 50;
/// Larger than any pixel coordinate or millimetre of a head.
const COORDINATE_MAX: f64 = 1e6;

#[derive(Serialize)]
struct Document<'a> {
    format: &'static str,
    version: u64,
    #[serde(flatten)]
    face: &'a FittedFace,
}

impl FittedFace {
    /// Serialises `face.json`: one line, rounded to 0.001 mm and 0.01 px.
    ///
    /// # Errors
    /// [`DocumentError`] if a reader would reject the result: non-finite numbers, indices out of range.
    pub fn to_json(&self) -> Result<String, DocumentError> {
        let face = &self.clone().rounded();
        face.check()?;
        let document = Document { format: FACE.name, version: FACE.version, face };
        let text = serde_json::to_string(&document)
            .map_err(|error| DocumentError::Shape(error.to_string()))?;
        FACE.check_len(text.len())?;
        Ok(text)
    }

    /// Reads `face.json`. Unknown keys are ignored.
    ///
    /// # Errors
    /// [`DocumentError`] with the reason.
    pub fn from_json(bytes: &[u8]) -> Result<Self, DocumentError> {
        let face: Self = FACE.read(bytes)?;
        face.check()?;
        Ok(face)
    }

    fn rounded(mut self) -> Self {
        let to = |per_unit: f64| move |value: f64| (value * per_unit).round() / per_unit;
        if let Some(pose) = &mut self.pose_deg {
            [pose.yaw, pose.pitch, pose.roll] = [pose.yaw, pose.pitch, pose.roll].map(to(1000.0));
        }
        self.scale_px_per_mm = self.scale_px_per_mm.map(to(1e6));
        self.origin_px = self.origin_px.map(|at| at.map(to(100.0)));
        self.confidence = self.confidence.map(to(1000.0));
        for point in &mut self.points {
            point.xy_px = point.xy_px.map(to(100.0));
            point.confidence = to(1000.0)(point.confidence);
        }
        self.vertices_mm.iter_mut().for_each(|vertex| *vertex = vertex.map(to(1000.0)));
        self
    }

    fn check(&self) -> Result<(), DocumentError> {
        let whole = |key: &'static str| move |_| key.to_owned();
        let n = self.vertices_mm.len();
        let (count, some) = (format!("1 to {PARTS_MAX}"), 1..=PARTS_MAX);
        FACE.expect([n], whole("vertices_mm.length"), &count, |n| some.contains(n))?;
        let (count, n_lines) = (format!("0 to {PARTS_MAX}"), self.lines.len());
        FACE.expect([n_lines], whole("lines.length"), &count, |n| *n <= PARTS_MAX)?;
        let (count, n_notes) = (format!("0 to {NOTES_MAX}"), self.notes.len());
        FACE.expect([n_notes], whole("notes.length"), &count, |n| *n <= NOTES_MAX)?;

        let (printed, is_printed) =
            ("no control characters", |text: &&String| !text.contains(char::is_control));
        let name = self.source.iter().map(|source| &source.name);
        FACE.expect(name, whole("source.name"), printed, is_printed)?;
        FACE.expect(self.features.keys(), whole("a key of features"), printed, is_printed)?;
        FACE.expect(&self.notes, |i| format!("notes[{i}]"), printed, is_printed)?;

        let is_scale = |scale: &f64| *scale > 0.0 && *scale < COORDINATE_MAX;
        let scale = "more than 0 and less than 1e6";
        FACE.expect(self.scale_px_per_mm, whole("scale_px_per_mm"), scale, is_scale)?;
        let angles = self.pose_deg.iter().flat_map(|pose| [pose.yaw, pose.pitch, pose.roll]);
        let angle = |i: usize| format!("pose_deg.{}", ["yaw", "pitch", "roll"][i]);
        FACE.expect(angles, angle, "at most 180 degrees", |angle| angle.abs() <= 180.0)?;
        let (near, is_near) =
            ("coordinates within 1e6", |at: &&[f64]| at.iter().all(|x| x.abs() < COORDINATE_MAX));
        let origin = self.origin_px.iter().map(|at| &at[..]);
        FACE.expect(origin, whole("origin_px"), near, is_near)?;
        let points = self.points.iter().map(|point| &point.xy_px[..]);
        FACE.expect(points, |i| format!("points[{i}].xy_px"), near, is_near)?;
        let vertices = self.vertices_mm.iter().map(|at| &at[..]);
        FACE.expect(vertices, |i| format!("vertices_mm[{i}]"), near, is_near)?;
        self.check_points()?;

        let there = format!("vertices from 0 to {}", n - 1);
        let are_there = |vertices: &&[usize]| vertices.iter().all(|&vertex| vertex < n);
        let lines = self.lines.iter().map(|line| &line[..]);
        FACE.expect(lines, |i| format!("lines[{i}]"), &there, are_there)?;
        let triangles = self.triangles.iter().map(|triangle| &triangle[..]);
        FACE.expect(triangles, |i| format!("triangles[{i}]"), &there, are_there)?;
        let (names, vertices): (Vec<_>, Vec<_>) = self.features.iter().unzip();
        let feature = |i: usize| format!("features.{}", shortened(names[i]));
        FACE.expect(vertices, feature, &there, |&&vertex| vertex < n)
    }

    /// Checks that there are all 53 points in order, or none.
    fn check_points(&self) -> Result<(), DocumentError> {
        let is_part = |confidence: &f64| (0.0..=1.0).contains(confidence);
        let part = "a number from 0 to 1";
        FACE.expect(self.confidence, |_| "confidence".to_owned(), part, is_part)?;
        let confidences = self.points.iter().map(|point| point.confidence);
        FACE.expect(confidences, |i| format!("points[{i}].confidence"), part, is_part)?;
        let expected = "none, or all 53 in order";
        let count = |count: &usize| [0, FeatureId::COUNT].contains(count);
        FACE.expect([self.points.len()], |_| "points.length".to_owned(), expected, count)?;
        let mut all = FeatureId::all();
        let names = self.points.iter().map(|point| point.id.name());
        let is_next = |name: &&str| all.next().is_some_and(|id| id.name() == *name);
        FACE.expect(names, |i| format!("points[{i}].name"), expected, is_next)
    }

    /// The wireframe as OBJ: nominal millimetres, y up, z to the front, features in comments.
    pub fn to_obj(&self) -> String {
        let mut text = String::from("# A face fitted to a photograph by mocapd.\n");
        text += "# Millimetres, nominal; x to the face's left, y up, z to the front.\n";
        for (name, vertex) in &self.features {
            // Control characters would end the comment.
            let name: String = name.chars().filter(|c| !c.is_control()).collect();
            text.push_str(&format!("# feature {name} {}\n", vertex + 1));
        }
        for [x, y, z] in &self.vertices_mm {
            text.push_str(&format!("v {x:.3} {y:.3} {z:.3}\n"));
        }
        for [a, b, c] in &self.triangles {
            text.push_str(&format!("f {} {} {}\n", a + 1, b + 1, c + 1));
        }
        text
    }
}

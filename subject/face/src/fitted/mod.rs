//! A face that was fitted to a photograph: what is kept of it, and how it is shown.
//!
//! `face.json` is described in `docs/subject-face-format.md`. Nothing in it is a picture of anybody: positions, names and
//! the photograph's hash.

mod format;
mod overlay;
mod views;

use std::collections::BTreeMap;
use std::ops::Range;

use super::model::{Camera, FeatureId, Landmark, Model};

pub use format::FaceFileError;
pub use overlay::Overlay;

/// The chain that found the points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// As (Yang et al. 2004) has it.
    Paper,
    /// The improved chain.
    Default,
}

/// The photograph.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Source {
    /// Its file's name, without folders.
    pub name: String,
    /// Of its file's bytes: 64 digits, lower case.
    pub sha256: String,
    /// In pixels, as it is looked at.
    pub width: u32,
    /// In pixels, as it is looked at.
    pub height: u32,
}

/// A face that was fitted to a photograph.
#[derive(Debug, Clone, PartialEq)]
pub struct FittedFace {
    /// Which chain.
    pub method: Method,
    /// Which photograph.
    pub source: Source,
    /// How the head stands in it.
    pub camera: Camera,
    /// The probability, 0 to 1, that the points are off by less than a tenth of the outer eye corners' distance, on the
    /// mean; none where the chain cannot tell.
    pub confidence: Option<f64>,
    /// What contradicts that the points are a face's, as phrases for people: lower case, without a dot at the end.
    pub notes: Vec<String>,
    /// The 53 points, in their order.
    pub points: Vec<Landmark>,
    /// The wireframe, turned to look straight ahead, in the frame and nominal millimetres of [`Model`].
    pub vertices_mm: Vec<[f64; 3]>,
    /// Three vertices a triangle, counter-clockwise from in front.
    pub triangles: Vec<[usize; 3]>,
    /// Named vertices.
    pub features: BTreeMap<String, usize>,
}

impl FittedFace {
    /// Below this confidence somebody should look at the points.
    pub const SURE: f64 = 0.5;

    /// A face on the model's wireframe, without a confidence and notes.
    pub fn new(
        model: &Model,
        method: Method,
        source: Source,
        camera: Camera,
        points: Vec<Landmark>,
        vertices_mm: Vec<[f64; 3]>,
    ) -> Self {
        let (triangles, features) = (model.triangles.clone(), model.features.clone());
        Self {
            method,
            source,
            camera,
            confidence: None,
            notes: Vec::new(),
            points,
            vertices_mm,
            triangles,
            features,
        }
    }

    /// Whether the points may be off: the confidence is known, and low, or something contradicts them.
    pub fn is_unsure(&self) -> bool {
        self.confidence.is_some_and(|confidence| confidence < Self::SURE) || !self.notes.is_empty()
    }

    /// The edges of the triangles, each once.
    pub fn lines(&self) -> Vec<[usize; 2]> {
        edges(self.triangles.iter().copied())
    }

    /// Each vertex in the photograph: x, y and how far before the model's origin, in pixels.
    pub fn vertices_px(&self) -> Vec<[f64; 3]> {
        self.camera.project(&self.vertices_mm)
    }

    /// The triangles that face the camera, for vertices that are seen at these places.
    fn facing(&self, seen: &[[f64; 3]]) -> impl Iterator<Item = [usize; 3]> {
        self.triangles.iter().copied().filter(|triangle| {
            let [a, b, c] = triangle.map(|v| seen[v]);
            // Counter-clockwise from in front, with y down.
            (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) < 0.0
        })
    }
}

/// The edges of triangles, each once, as pairs of vertices in rising order.
fn edges(triangles: impl Iterator<Item = [usize; 3]>) -> Vec<[usize; 2]> {
    let mut edges: Vec<_> = triangles
        .flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]])
        .map(|[a, b]| [a.min(b), a.max(b)])
        .collect();
    edges.sort_unstable();
    edges.dedup();
    edges
}

/// A part of the face that is drawn in a colour of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Around the face.
    Contour,
    /// Both of them.
    Brow,
    /// Lids.
    Eye,
    /// Wings and base.
    Nose,
    /// Lips.
    Mouth,
}

/// A line through points.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Curve {
    /// Of what.
    pub part: Part,
    /// In their order.
    pub points: Vec<FeatureId>,
    /// Whether the last is joined to the first.
    pub closed: bool,
}

impl Part {
    /// Red, green and blue: apart for all kinds of colour vision (Okabe and Ito 2008), on skin and on paper.
    pub fn colour(self) -> [u8; 3] {
        match self {
            Self::Contour => [0x00, 0x72, 0xb2],
            Self::Brow => [0x00, 0x9e, 0x73],
            Self::Eye => [0xf0, 0xe4, 0x42],
            Self::Nose => [0xe6, 0x9f, 0x00],
            Self::Mouth => [0xcc, 0x79, 0xa7],
        }
    }

    /// The part that a point belongs to.
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

//! A face that was fitted to a photograph: what is kept of it, and how it is shown.
//!
//! `face.json` is described in `docs/subject-face-format.md`. Nothing in it is a picture of anybody: positions, names and
//! the photograph's hash.

mod curves;
mod draw;
mod format;
mod number;
mod obj;
mod overlay;
#[cfg(test)]
mod tests;
mod views;

use std::collections::BTreeMap;

use super::model::{Camera, FeatureId, Model};

pub use curves::{Curve, Part};
pub use format::FaceFileError;
pub(crate) use format::shortened;
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

/// One of the 53 points.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Which.
    pub id: FeatureId,
    /// In the photograph: x to the right, y down, 0 at the middle of the first pixel.
    pub xy_px: [f64; 2],
    /// From 0 (guessed by the model) to 1 (seen).
    pub confidence: f64,
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
    pub points: Vec<Point>,
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
        points: Vec<Point>,
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
        let mut lines: Vec<_> = self
            .triangles
            .iter()
            .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
            .map(|[a, b]| [a.min(b), a.max(b)])
            .collect();
        lines.sort_unstable();
        lines.dedup();
        lines
    }

    /// Each vertex in the photograph: x, y and how far before the model's origin, in pixels.
    pub fn vertices_px(&self) -> Vec<[f64; 3]> {
        self.camera.project(&self.vertices_mm)
    }
}

//! `face.json`, and `face.obj`: Wavefront's format, which every program for shapes reads.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{FittedFace, Method, Source};
use crate::model::{Camera, FeatureId, Landmark};
use crate::shortened;

const FORMAT: &str = "mocapd-face";
const VERSION: u32 = 1;
/// Six times what the generic model's file takes; a file beyond that is not one of a face.
const MAX_BYTES: usize = 1 << 20;
const MAX_VERTICES: usize = 5000;
const MAX_FEATURES: usize = 500;
const MAX_NAME: usize = 255;
const MAX_NOTES: usize = 50;
/// A picture's coordinates and a head's millimetres are far within it.
const MAX_COORDINATE: f64 = 1e6;

/// Why a text is no fitted face.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum FaceFileError {
    /// Of another kind, or of a version that is newer.
    #[error("not a face file of version {VERSION}: {0}")]
    Kind(String),
    /// JSON, but not this.
    #[error("not a face file: {0}")]
    Shape(String),
    /// A number, a name or an index that cannot be.
    #[error("a face file with {0}")]
    Value(String),
}

#[derive(Deserialize)]
struct Head {
    format: Option<String>,
    version: Option<u32>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    format: String,
    version: u32,
    method: Method,
    source: Source,
    pose_deg: Angles,
    scale_px_per_mm: f64,
    origin_px: [f64; 2],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    confidence: Option<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
    points: Vec<FilePoint>,
    vertices_mm: Vec<[f64; 3]>,
    lines: Vec<[usize; 2]>,
    triangles: Vec<[usize; 3]>,
    features: BTreeMap<String, usize>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Angles {
    yaw: f64,
    pitch: f64,
    roll: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FilePoint {
    name: String,
    xy_px: [f64; 2],
    confidence: f64,
}

impl FittedFace {
    /// `face.json`: one line, with 0.001 mm and 0.01 px.
    ///
    /// # Errors
    /// What cannot be written so that it is read again: numbers that are not finite, indices out of range.
    pub fn to_json(&self) -> Result<String, FaceFileError> {
        let points = self.points.iter().map(|point| FilePoint {
            name: point.id.name().to_owned(),
            xy_px: point.xy_px.map(|v| rounded(v, 100.0)),
            confidence: rounded(point.confidence, 1000.0),
        });
        let file = File {
            format: FORMAT.into(),
            version: VERSION,
            method: self.method,
            source: self.source.clone(),
            pose_deg: Angles {
                yaw: rounded(self.camera.yaw_deg, 1000.0),
                pitch: rounded(self.camera.pitch_deg, 1000.0),
                roll: rounded(self.camera.roll_deg, 1000.0),
            },
            scale_px_per_mm: rounded(self.camera.scale_px_per_mm, 1e6),
            origin_px: self.camera.origin_px.map(|v| rounded(v, 100.0)),
            confidence: self.confidence.map(|v| rounded(v, 1000.0)),
            notes: self.notes.clone(),
            points: points.collect(),
            vertices_mm: self.vertices_mm.iter().map(|v| v.map(|x| rounded(x, 1000.0))).collect(),
            lines: self.lines(),
            triangles: self.triangles.clone(),
            features: self.features.clone(),
        };
        file.check()?;
        serde_json::to_string(&file).map_err(|error| FaceFileError::Shape(error.to_string()))
    }

    /// Reads `face.json`.
    ///
    /// # Errors
    /// What is wrong with it. No room is made for more than the text has in it.
    pub fn from_json(text: &str) -> Result<Self, FaceFileError> {
        if text.len() > MAX_BYTES {
            let what = format!("{} bytes, where {MAX_BYTES} is the most", text.len());
            return Err(FaceFileError::Value(what));
        }
        let shape = |error: serde_json::Error| FaceFileError::Shape(shortened(&error.to_string()));
        let head: Head = serde_json::from_str(text).map_err(shape)?;
        match (head.format.as_deref(), head.version) {
            (Some(FORMAT), Some(VERSION)) => {}
            (Some(FORMAT), version) => {
                let found = version.map_or("no version".into(), |v| format!("version {v}"));
                return Err(FaceFileError::Kind(format!("{found}; use a later mocapd")));
            }
            (format, _) => {
                let found = format.unwrap_or("nothing").escape_debug().take(40).collect::<String>();
                return Err(FaceFileError::Kind(format!(
                    "its format is {found:?}, and {FORMAT:?} is expected"
                )));
            }
        }
        let file: File = serde_json::from_str(text).map_err(shape)?;
        file.check()?;
        let points = file.points.iter().filter_map(|point| {
            let id = FeatureId::from_name(&point.name)?;
            Some(Landmark { id, xy_px: point.xy_px, confidence: point.confidence })
        });
        let camera = Camera {
            scale_px_per_mm: file.scale_px_per_mm,
            yaw_deg: file.pose_deg.yaw,
            pitch_deg: file.pose_deg.pitch,
            roll_deg: file.pose_deg.roll,
            origin_px: file.origin_px,
        };
        Ok(Self {
            method: file.method,
            camera,
            confidence: file.confidence,
            notes: file.notes,
            points: points.collect(),
            source: file.source,
            vertices_mm: file.vertices_mm,
            triangles: file.triangles,
            features: file.features,
        })
    }
}

fn rounded(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit
}

impl File {
    fn check(&self) -> Result<(), FaceFileError> {
        let wrong = |what: String| Err(FaceFileError::Value(what));
        let count = self.vertices_mm.len();
        if count == 0 || count > MAX_VERTICES {
            return wrong(format!("{count} vertices, where 1 to {MAX_VERTICES} are allowed"));
        }
        let hex = |c: char| c.is_ascii_digit() || ('a'..='f').contains(&c);
        if self.source.sha256.len() != 64 || !self.source.sha256.chars().all(hex) {
            return wrong("a sha256 that is not 64 hexadecimal digits in lower case".into());
        }
        let names = self.features.keys().chain([&self.source.name]).chain(&self.notes);
        if names.into_iter().any(|name| name.len() > MAX_NAME || name.chars().any(char::is_control))
        {
            return wrong(format!(
                "a name of more than {MAX_NAME} bytes, or with control characters"
            ));
        }
        if self.notes.len() > MAX_NOTES {
            return wrong(format!("{} notes, where {MAX_NOTES} is the most", self.notes.len()));
        }
        if self.features.len() > MAX_FEATURES {
            return wrong(format!(
                "{} features, where {MAX_FEATURES} is the most",
                self.features.len()
            ));
        }
        let scale = self.scale_px_per_mm;
        if !(scale > 0.0 && scale < MAX_COORDINATE) {
            return wrong(format!("a scale of {scale} pixels a millimetre"));
        }
        let angles = [self.pose_deg.yaw, self.pose_deg.pitch, self.pose_deg.roll];
        if !angles.iter().all(|a| a.abs() <= 180.0) {
            return wrong("an angle beyond 180 degrees".into());
        }
        let places = self.vertices_mm.iter().flatten().chain(&self.origin_px);
        let within = |x: &f64| x.abs() < MAX_COORDINATE;
        if !places.chain(self.points.iter().flat_map(|p| &p.xy_px)).all(within) {
            return wrong(format!("a coordinate that is not within {MAX_COORDINATE}"));
        }
        self.check_points()?;
        // At most so many edges and triangles does a surface of that many vertices have (Euler), each edge once.
        if self.triangles.len() > 2 * count || self.lines.len() > 3 * count + self.triangles.len() {
            return wrong("more triangles or lines than its vertices can have".into());
        }
        let indices = self.lines.iter().flatten().chain(self.triangles.iter().flatten());
        if let Some(index) = indices.chain(self.features.values()).find(|&&i| i >= count) {
            return wrong(format!("vertex {index}, where there are {count}"));
        }
        Ok(())
    }

    /// All 53, in their order.
    fn check_points(&self) -> Result<(), FaceFileError> {
        if self.points.len() != FeatureId::COUNT {
            let what =
                format!("{} points, where there are {}", self.points.len(), FeatureId::COUNT);
            return Err(FaceFileError::Value(what));
        }
        let mut all = self.points.iter().map(|point| point.confidence).chain(self.confidence);
        if let Some(wrong) = all.find(|c| !(0.0..=1.0).contains(c)) {
            return Err(FaceFileError::Value(format!("a confidence of {wrong}")));
        }
        for (point, id) in self.points.iter().zip(FeatureId::all()) {
            if point.name != id.name() {
                let found = point.name.escape_debug().take(40).collect::<String>();
                return Err(FaceFileError::Value(format!(
                    "point {found:?} where {} belongs",
                    id.name()
                )));
            }
        }
        Ok(())
    }
}

impl FittedFace {
    /// The wireframe as an OBJ: nominal millimetres, y up, z to the front. Features stand in comments.
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

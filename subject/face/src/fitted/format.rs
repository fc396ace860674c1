//! `face.json` and `face.obj` (Wavefront OBJ).

use serde::Serialize;

use super::FittedFace;
use crate::document::{DocumentError, Format};
use crate::model::FeatureId;
use crate::shortened;

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

//! `face.json`, as far as the house needs it: the wireframe, and where it is under markers.

use std::collections::{BTreeMap, HashMap};

use anyhow::{Context, anyhow, ensure};
use mocapd_face::mapping::{Mapping, MappingError, Marker, Place, Scaling};
use mocapd_report::labels;
use mocapd_take::{motion::Position, record::Subject};
use serde::{Deserialize, Serialize};

use super::check_kind;
use crate::live::{FacePose, LiveFace};

/// Vertices and lines: more than a document of 1 MiB can spell out.
const PARTS_MAX: usize = 1 << 17;

/// A photograph that a face was fitted to.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
pub struct SourcePhoto {
    /// Its file's name.
    pub name: String,
    /// The file's SHA-256, in hexadecimal digits.
    pub sha256: String,
}

/// A wireframe that was fitted to a photograph.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Face {
    /// How it was fitted.
    #[serde(default)]
    pub method: String,
    /// The photograph.
    pub source: Option<SourcePhoto>,
    /// Where each vertex is, in the face's own nominal millimetres.
    #[serde(alias = "vertices")]
    pub vertices_mm: Vec<[f64; 3]>,
    /// Pairs of vertices that are joined.
    pub lines: Vec<[usize; 2]>,
    /// Vertices by name.
    #[serde(default)]
    pub features: BTreeMap<String, usize>,
}

/// Which marker sits where on the face, from the bytes of a document.
///
/// # Errors
/// What is wrong with it.
pub fn mapping(data: &[u8]) -> anyhow::Result<Mapping> {
    const WHERE: &str = "docs/subject-face-format.md has the format, subject/face/data/singing-face-mapping.json is one";
    let text = std::str::from_utf8(data)
        .with_context(|| format!("not a mapping of markers to a face ({WHERE}): no text"))?;
    Mapping::from_json(text).map_err(|error| match error {
        MappingError::Kind(_) | MappingError::Shape(_) => anyhow!("{error}; {WHERE}"),
        MappingError::Value(_) => error.into(),
    })
}

/// A subject's own; `None` where it has none.
///
/// # Errors
/// What is wrong with it.
pub fn mapping_of(subject: &Subject) -> anyhow::Result<Option<Mapping>> {
    subject.document(Subject::FACE_MARKERS).map(mapping).transpose()
}

impl Face {
    /// From the bytes of a document.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(data: &[u8]) -> anyhow::Result<Self> {
        const FORMAT: &str = "mocapd-face";
        check_kind(data, FORMAT, "face")?;
        let face: Self =
            serde_json::from_slice(data).with_context(|| format!("a damaged {FORMAT}"))?;
        let n = face.vertices_mm.len();
        ensure!(
            n <= PARTS_MAX && face.lines.len() <= PARTS_MAX,
            "a damaged {FORMAT}: {n} vertices and {} lines are more than a face has ({PARTS_MAX})",
            face.lines.len()
        );
        ensure!(
            face.vertices_mm.iter().flatten().all(|value| value.is_finite())
                && face.lines.iter().flatten().all(|&vertex| vertex < n),
            "a damaged {FORMAT}: a line goes to a vertex that is not there"
        );
        Ok(face)
    }

    /// That the wireframe has every place where a marker sits: one that is nowhere would hold nothing, and nobody would know.
    ///
    /// # Errors
    /// Which places it does not have, and which it has.
    pub fn check_places(&self, mapping: &Mapping) -> anyhow::Result<()> {
        const TOLD: usize = 5;
        let n = self.vertices_mm.len();
        let is_nowhere = |marker: &&Marker| marker.place.vertex(&self.features, n).is_none();
        let nowhere: Vec<String> = mapping
            .markers
            .iter()
            .filter(is_nowhere)
            .map(|marker| match &marker.place {
                Place::Feature(name) => format!("{} at {name:?}", marker.label),
                Place::Vertex(index) => format!("{} at {index}", marker.label),
            })
            .collect();
        let others = match nowhere.len().saturating_sub(TOLD) {
            0 => String::new(),
            more => format!(", and {more} more"),
        };
        let told: Vec<_> = nowhere.iter().take(TOLD).map(String::as_str).collect();
        ensure!(
            nowhere.is_empty(),
            "places that the face does not have: {}{others}; it has vertices from 0 to {}, and the names under \"features\" in its file",
            told.join(", "),
            n.saturating_sub(1)
        );
        Ok(())
    }

    /// A take's own; `None` where it has none.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn of_take(subject: Option<&Subject>) -> anyhow::Result<Option<Self>> {
        let document = subject.and_then(|subject| subject.document(Subject::FACE));
        document.map(Self::parse).transpose().context("the take's face")
    }
}

/// A face, and the markers that it is laid under.
#[derive(Debug)]
pub struct FaceUnderMarkers {
    face: Face,
    mapping: Mapping,
    /// Slots by label, with and without what stands before its `:`.
    slots: HashMap<String, usize>,
}

impl FaceUnderMarkers {
    /// Of a subject that was checked when it was read; `None` where it has no face, or nothing says which marker sits where.
    #[must_use]
    pub fn new(subject: Option<&Subject>, labels: &[String]) -> Option<Self> {
        let face = Face::of_take(subject).ok()??;
        let mapping = mapping_of(subject?).ok()??;
        let mut slots = HashMap::new();
        for (slot, label) in labels.iter().enumerate() {
            slots.entry(label.clone()).or_insert(slot);
            slots.entry(labels::split(label).1.to_owned()).or_insert(slot);
        }
        Some(Self { face, mapping, slots })
    }

    /// The wireframe, for who draws it.
    #[must_use]
    pub fn wireframe(&self) -> LiveFace {
        let vertices_mm = self.face.vertices_mm.iter().map(|at| at.map(|v| v as f32)).collect();
        LiveFace { vertices_mm, lines: self.face.lines.clone() }
    }

    /// Where it is in a frame; `None` where too few of its markers are seen.
    #[must_use]
    pub fn pose(&self, positions_mm: &[Position]) -> Option<FacePose> {
        let marker = |label: &str| {
            let at = positions_mm.get(*self.slots.get(label)?)?;
            at.iter().all(|value| value.is_finite()).then(|| at.map(f64::from))
        };
        let Face { vertices_mm, features, .. } = &self.face;
        let found = self.mapping.align(vertices_mm, features, marker, Scaling::Free).ok()?;
        let row = |axis: usize| {
            let [x, y, z] = found.rotation[axis].map(|value| (found.scale * value) as f32);
            [x, y, z, found.translation_mm[axis] as f32]
        };
        let pose = [row(0), row(1), row(2)];
        pose.iter().flatten().all(|value| value.is_finite()).then_some(pose)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FACE: &str = r#"{"format":"mocapd-face","version":1,"vertices_mm":[[0,0,0],[10,0,0],[0,20,0],[0,0,30],[5,5,5]],
    "lines":[[0,1],[0,2]],"features":{"nose":0,"chin":2}}"#;
    const MARKERS: &str = r#"{"format":"mocapd-face-mapping","version":1,"markers":[{"label":"a","at":"nose"},{"label":"b","at":1},
    {"label":"c","at":"chin"},{"label":"d","at":3}]}"#;

    fn subject() -> Subject {
        let mut subject = Subject::default();
        subject.set(Subject::FACE, FACE.as_bytes().to_vec());
        subject.set(Subject::FACE_MARKERS, MARKERS.as_bytes().to_vec());
        subject
    }

    #[test]
    fn it_is_laid_under_its_markers() {
        let labels = ["x", "S1:d", "S1:c", "b", "a"].map(str::to_owned);
        let face = FaceUnderMarkers::new(Some(&subject()), &labels).unwrap();
        assert_eq!(face.wireframe().vertices_mm.len(), 5);
        // Twice as large, turned by a right angle about z, and moved.
        let placed = |[x, y, z]: [f32; 3]| [100.0 - 2.0 * y, 7.0 + 2.0 * x, 2.0 * z - 50.0];
        let vertices = face.wireframe().vertices_mm;
        let mut positions = [[9.0; 3], vertices[3], vertices[2], vertices[1], vertices[0]];
        positions[1..].iter_mut().for_each(|at| *at = placed(*at));
        let pose = face.pose(&positions).unwrap();
        for vertex in vertices {
            let found =
                pose.map(|[x, y, z, add]| x * vertex[0] + y * vertex[1] + z * vertex[2] + add);
            let wanted = placed(vertex);
            for (found, wanted) in found.into_iter().zip(wanted) {
                assert!((found - wanted).abs() < 1e-3, "{found:?} {wanted:?}");
            }
        }
        positions[4] = [f32::NAN; 3];
        assert_eq!(face.pose(&positions), None, "three markers do not hold it");
        assert_eq!(face.pose(&[]), None);
    }

    #[test]
    fn without_a_face_or_a_mapping_there_is_nothing_to_draw() {
        let labels = ["a".to_owned()];
        assert!(FaceUnderMarkers::new(None, &labels).is_none());
        let mut alone = Subject::default();
        alone.set(Subject::FACE, FACE.as_bytes().to_vec());
        assert!(FaceUnderMarkers::new(Some(&alone), &labels).is_none());
        alone.set(Subject::FACE_MARKERS, b"{}".to_vec());
        assert!(FaceUnderMarkers::new(Some(&alone), &labels).is_none());
    }
}

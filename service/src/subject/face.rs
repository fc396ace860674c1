//! `face.json`, as far as the house needs it: the wireframe.

use std::collections::BTreeMap;

use anyhow::{Context, anyhow, ensure};
use mocapd_face::mapping::{Mapping, MappingError, Marker, Place};
use mocapd_take::record::Subject;
use serde::{Deserialize, Serialize};

use super::check_kind;

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

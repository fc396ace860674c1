//! Places the subject's face under its markers in each frame.

use std::collections::HashMap;

use anyhow::ensure;
use mocapd_face::{
    fitted::FittedFace,
    mapping::{Mapping, Marker, Place, Scaling},
};
use mocapd_report::labels;
use mocapd_take::{motion::Position, record::Subject};

use crate::live::{FacePose, LiveFace};

/// Checks that the wireframe has every vertex where a marker sits: a missing one would silently hold nothing.
///
/// # Errors
/// The missing places, and the available ones.
pub(super) fn check_places(face: &FittedFace, mapping: &Mapping) -> anyhow::Result<()> {
    const LISTED_MAX: usize = 5;
    let n = face.vertices_mm.len();
    let is_nowhere = |marker: &&Marker| marker.place.vertex(&face.features, n).is_none();
    let nowhere: Vec<String> = mapping
        .markers
        .iter()
        .filter(is_nowhere)
        .map(|marker| match &marker.place {
            Place::Feature(name) => format!("{} at {name:?}", marker.label),
            Place::Vertex(index) => format!("{} at {index}", marker.label),
        })
        .collect();
    let others = match nowhere.len().saturating_sub(LISTED_MAX) {
        0 => String::new(),
        more => format!(", and {more} more"),
    };
    let listed: Vec<_> = nowhere.iter().take(LISTED_MAX).map(String::as_str).collect();
    ensure!(
        nowhere.is_empty(),
        "the face does not have these points: {}{others}; it has vertices 0 to {}, and the names under \"features\" in its file",
        listed.join(", "),
        n.saturating_sub(1)
    );
    Ok(())
}

/// Slots by label, each with and without the prefix before `:`.
pub(super) fn slots(labels: &[String]) -> HashMap<String, usize> {
    let mut slots = HashMap::new();
    for (slot, label) in labels.iter().enumerate() {
        slots.entry(label.clone()).or_insert(slot);
        slots.entry(labels::split(label).1.to_owned()).or_insert(slot);
    }
    slots
}

/// A face, and the markers that hold it.
#[derive(Debug)]
pub struct FaceOverlay {
    face: FittedFace,
    mapping: Mapping,
    slots: HashMap<String, usize>,
}

impl FaceOverlay {
    /// For a subject that was checked when it was read; `None` if it has no face, or no mapping of markers.
    #[must_use]
    pub fn new(subject: Option<&Subject>, labels: &[String]) -> Option<Self> {
        let face = super::face(subject).ok()??;
        let mapping = super::mapping(subject).ok()??;
        Some(Self { face, mapping, slots: slots(labels) })
    }

    /// The wireframe for drawing.
    #[must_use]
    pub fn wireframe(&self) -> LiveFace {
        let vertices_mm = self.face.vertices_mm.iter().map(|at| at.map(|v| v as f32)).collect();
        LiveFace { vertices_mm, lines: self.face.lines.clone() }
    }

    /// The placement of the face in a frame; `None` if too few of its markers are seen.
    #[must_use]
    pub fn pose(&self, positions_mm: &[Position]) -> Option<FacePose> {
        let marker = |label: &str| {
            let at = positions_mm.get(*self.slots.get(label)?)?;
            at.iter().all(|value| value.is_finite()).then(|| at.map(f64::from))
        };
        let FittedFace { vertices_mm, features, .. } = &self.face;
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
        let face = FaceOverlay::new(Some(&subject()), &labels).unwrap();
        assert_eq!(face.wireframe().vertices_mm.len(), 5);
        // Scaled by two, rotated by a right angle about z, and translated.
        let placed = |[x, y, z]: [f32; 3]| [100.0 - 2.0 * y, 7.0 + 2.0 * x, 2.0 * z - 50.0];
        let vertices = face.wireframe().vertices_mm;
        let mut positions = [[9.0; 3], vertices[3], vertices[2], vertices[1], vertices[0]];
        positions[1..].iter_mut().for_each(|at| *at = placed(*at));
        let pose = face.pose(&positions).unwrap();
        for vertex in vertices {
            let found =
                pose.map(|[x, y, z, add]| x * vertex[0] + y * vertex[1] + z * vertex[2] + add);
            let expected = placed(vertex);
            for (found, expected) in found.into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-3, "{found:?} {expected:?}");
            }
        }
        positions[4] = [f32::NAN; 3];
        assert_eq!(face.pose(&positions), None, "three markers do not hold it");
        assert_eq!(face.pose(&[]), None);
    }

    #[test]
    fn without_a_face_or_a_mapping_there_is_nothing_to_draw() {
        let labels = ["a".to_owned()];
        assert!(FaceOverlay::new(None, &labels).is_none());
        let mut alone = Subject::default();
        alone.set(Subject::FACE, FACE.as_bytes().to_vec());
        assert!(FaceOverlay::new(Some(&alone), &labels).is_none());
        alone.set(Subject::FACE_MARKERS, b"{}".to_vec());
        assert!(FaceOverlay::new(Some(&alone), &labels).is_none());
    }
}

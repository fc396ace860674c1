//! The subject: reads its skeleton and face from files for a take, and finds its limbs among the markers.
//!
//! A take stores both as documents (SUBJECT in docs/take-format.md). Invalid documents are refused before they get into
//! a take.

use std::{
    collections::HashMap,
    error::Error,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail, ensure};
use mocapd_acquire::files;
use mocapd_body::skeleton::Skeleton;
use mocapd_face::{
    fitted::FittedFace,
    mapping::{MARKERS_MIN, Mapping, Marker, Place, Scaling},
};
use mocapd_report::{
    labels,
    limbs::{Limb, limbs},
};
use mocapd_take::{
    motion::Position,
    record::{DOCUMENT_BYTES_MAX, Subject},
};

use crate::live::{FacePose, LiveFace, LiveLimb};

/// Longest name of a subject in bytes: a line on a screen.
pub const NAME_BYTES_MAX: usize = 128;

/// The files of a subject: `[subject]`, and the options of `record` and `import`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SubjectFiles {
    /// Name of the subject.
    pub name: Option<String>,
    /// A `skeleton.json`.
    pub skeleton: Option<PathBuf>,
    /// A `face.json`.
    pub face: Option<PathBuf>,
    /// The markers on the face, and where they sit.
    pub face_markers: Option<PathBuf>,
}

impl SubjectFiles {
    /// Reads and checks all files; `None` if nothing is configured.
    ///
    /// # Errors
    /// A file is missing, too large or invalid.
    pub fn load(&self) -> anyhow::Result<Option<Subject>> {
        let name = self.name.clone().unwrap_or_default();
        let mut subject = Subject { name, documents: Vec::new() };
        if let Some(path) = &self.skeleton {
            let (data, _) = read(path, Skeleton::from_json)?;
            subject.set(Subject::SKELETON, data);
        }
        let mut wireframe = None;
        if let Some(path) = &self.face {
            let (data, face) = read(path, FittedFace::from_json)?;
            subject.set(Subject::FACE, data);
            wireframe = Some(face);
        }
        if let Some(path) = &self.face_markers {
            let shown = path.display();
            let Some(wireframe) = wireframe else {
                bail!("{shown} maps markers to a face, but no face is given: give both");
            };
            let (data, mapping) = read(path, Mapping::from_json)?;
            check_places(&wireframe, &mapping).with_context(|| format!("{shown}"))?;
            subject.set(Subject::FACE_MARKERS, data);
        }
        Ok((!subject.is_empty()).then_some(subject))
    }

    /// What is wrong with each file, by its key in the configuration.
    pub(crate) fn problems(&self) -> Vec<(&'static str, String)> {
        let mut found = Vec::new();
        let mut check = |key: &'static str, files: &Self| match files.load() {
            Ok(_) => true,
            Err(error) => {
                found.push((key, format!("{key}: {error:#}")));
                false
            }
        };
        let Self { skeleton, face, face_markers, .. } = self.clone();
        check("subject.skeleton", &Self { skeleton, ..Self::default() });
        let has_face = check("subject.face", &Self { face: face.clone(), ..Self::default() });
        // The mapping is checked against the face, whose own problem has been reported.
        if has_face {
            check("subject.face_markers", &Self { face, face_markers, ..Self::default() });
        } else if let Some(path) = face_markers
            && let Err(error) = read(&path, Mapping::from_json)
        {
            found.push(("subject.face_markers", format!("subject.face_markers: {error:#}")));
        }
        found
    }
}

/// Parses a document.
type Reader<T, E> = fn(&[u8]) -> Result<T, E>;

/// Reads a document of a subject: its bytes, and its parsed content.
///
/// # Errors
/// The file is missing, too large for a take, or invalid.
pub fn read<T, E>(path: &Path, from_json: Reader<T, E>) -> anyhow::Result<(Vec<u8>, T)>
where
    E: Error + Send + Sync + 'static,
{
    let data = files::read_bounded(path, DOCUMENT_BYTES_MAX)?;
    let document = from_json(&data).with_context(|| format!("{}", path.display()))?;
    Ok((data, document))
}

/// The skeleton in a take; `None` if there is none.
///
/// # Errors
/// The document is invalid.
pub fn skeleton(subject: Option<&Subject>) -> anyhow::Result<Option<Skeleton>> {
    document(subject, Subject::SKELETON, Skeleton::from_json)
}

/// The face in a take; `None` if there is none.
///
/// # Errors
/// The document is invalid.
pub fn face(subject: Option<&Subject>) -> anyhow::Result<Option<FittedFace>> {
    document(subject, Subject::FACE, FittedFace::from_json)
}

/// The mapping of markers to the face in a take; `None` if there is none.
///
/// # Errors
/// The document is invalid.
pub fn mapping(subject: Option<&Subject>) -> anyhow::Result<Option<Mapping>> {
    document(subject, Subject::FACE_MARKERS, Mapping::from_json)
}

fn document<T, E>(
    subject: Option<&Subject>,
    kind: &str,
    from_json: Reader<T, E>,
) -> anyhow::Result<Option<T>>
where
    E: Error + Send + Sync + 'static,
{
    let data = subject.and_then(|subject| subject.document(kind));
    data.map(from_json).transpose().with_context(|| format!("the take's {kind}"))
}

/// The limbs of the subject's skeleton between markers with these labels. The skeleton was checked when it was read:
/// errors are ignored here.
fn limbs_between(subject: Option<&Subject>, labels: &[String]) -> Option<Vec<Limb>> {
    let bones = skeleton(subject).ok()??.bones;
    Some(limbs(&bones, labels, subject.map_or("", |subject| subject.name.as_str())).0)
}

/// The limbs of the subject's skeleton by slots, for viewers.
#[must_use]
pub fn live_limbs(subject: Option<&Subject>, labels: &[String]) -> Vec<LiveLimb> {
    let named = &labels[..labels.len().min(usize::from(u16::MAX) + 1)];
    let slot = |column: usize| u16::try_from(column).unwrap_or_default();
    let limb = |limb: &Limb| LiveLimb {
        ends: limb.ends.map(slot),
        length_mm: limb.bone.length_mm,
        off_mm: limb.off_mm(),
    };
    limbs_between(subject, named).iter().flatten().map(limb).collect()
}

/// Adds the lines of limbs to those found by labels, without duplicates.
#[must_use]
pub fn with_limbs(mut bones: Vec<[u16; 2]>, limbs: &[LiveLimb]) -> Vec<[u16; 2]> {
    for LiveLimb { ends: [a, b], .. } in limbs {
        if !bones.contains(&[*a, *b]) && !bones.contains(&[*b, *a]) {
            bones.push([*a, *b]);
        }
    }
    bones
}

/// Messages about parts of the subject that match no markers with these labels. The documents were checked when they
/// were read: errors are ignored here.
#[must_use]
pub fn unused_part_notes(subject: Option<&Subject>, labels: &[String]) -> Vec<String> {
    let mut notes = Vec::new();
    if limbs_between(subject, labels).is_some_and(|limbs| limbs.is_empty()) {
        notes.push(
            "no bone of the skeleton has markers labelled as both of its ends: the skeleton is stored in the take but has no effect".to_owned(),
        );
    }
    if let Ok(Some(Mapping { markers })) = mapping(subject) {
        let slots = slots(labels);
        let n_here = markers.iter().filter(|marker| slots.contains_key(&marker.label)).count();
        let n = markers.len();
        if n_here < MARKERS_MIN {
            notes.push(format!(
                "only {n_here} of the {n} markers of the face are in the take, {MARKERS_MIN} are needed: the face is not shown"
            ));
        } else if n_here < n {
            notes.push(format!(
                "only {n_here} of the {n} markers of the face are in the take: the face is placed by these"
            ));
        }
    }
    notes
}

#[cfg(test)]
mod tests;

/// Checks that the wireframe has every vertex where a marker sits: a marker at a missing one would silently be ignored.
///
/// # Errors
/// The missing places, and the available ones.
fn check_places(face: &FittedFace, mapping: &Mapping) -> anyhow::Result<()> {
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
fn slots(labels: &[String]) -> HashMap<String, usize> {
    let mut slots = HashMap::new();
    for (slot, label) in labels.iter().enumerate() {
        slots.entry(label.clone()).or_insert(slot);
        slots.entry(labels::split(label).1.to_owned()).or_insert(slot);
    }
    slots
}

/// A face, and the markers that define its pose.
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
        let face = face(subject).ok()??;
        let mapping = mapping(subject).ok()??;
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
mod tests_of_face_overlay {
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
    fn the_face_is_placed_under_its_markers() {
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

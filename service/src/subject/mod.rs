//! The subject: reads its skeleton and face from files for a take, and finds its limbs among the markers.
//!
//! A take stores both as documents (SUBJECT in docs/take-format.md). Invalid documents are refused before they get into
//! a take.

mod face;

use std::{
    error::Error,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use mocapd_acquire::files;
use mocapd_body::skeleton::Skeleton;
use mocapd_face::{
    fitted::FittedFace,
    mapping::{MARKERS_MIN, Mapping},
};
use mocapd_report::limbs::{Limb, limbs};
use mocapd_take::record::{DOCUMENT_BYTES_MAX, Subject};

pub use self::face::FaceOverlay;
use crate::live::LiveLimb;

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
            face::check_places(&wireframe, &mapping).with_context(|| format!("{shown}"))?;
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
            "no bone of the skeleton has markers at both ends according to the labels: it is stored in the take but has no effect".to_owned(),
        );
    }
    if let Ok(Some(Mapping { markers })) = mapping(subject) {
        let slots = face::slots(labels);
        let n_here = markers.iter().filter(|marker| slots.contains_key(&marker.label)).count();
        let n = markers.len();
        if n_here < MARKERS_MIN {
            notes.push(format!(
                "only {n_here} of the {n} markers of the face are in the take, {MARKERS_MIN} are needed: the face is not shown"
            ));
        } else if n_here < n {
            notes.push(format!(
                "only {n_here} of the {n} markers of the face are in the take: they alone place it"
            ));
        }
    }
    notes
}

#[cfg(test)]
mod tests;

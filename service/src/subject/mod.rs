//! Who is captured: the skeleton and the face that a take carries, out of files, and between its markers.
//!
//! A take stores them as plain data (SUBJECT in docs/take-format.md). What is none is refused before it gets into a take.

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

pub use self::face::FaceUnderMarkers;
use crate::live::LiveLimb;

/// Bytes of a subject's name: a line on a screen.
pub const NAME_BYTES_MAX: usize = 128;

/// What is known of the subject, and where it lies: `[subject]`, and the options of `record` and `import`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SubjectFiles {
    /// What they are called.
    pub name: Option<String>,
    /// A `skeleton.json`.
    pub skeleton: Option<PathBuf>,
    /// A `face.json`.
    pub face: Option<PathBuf>,
    /// Which marker sits where on the face.
    pub face_markers: Option<PathBuf>,
}

impl SubjectFiles {
    /// Reads and checks them all; `None` where nothing is said of a subject.
    ///
    /// # Errors
    /// Which file is missing, too large, or is not what it should be.
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
                bail!("{shown} says where markers sit on a face, and no face is given: give both");
            };
            let (data, mapping) = read(path, Mapping::from_json)?;
            face::check_places(&wireframe, &mapping).with_context(|| format!("{shown}"))?;
            subject.set(Subject::FACE_MARKERS, data);
        }
        Ok((!subject.is_empty()).then_some(subject))
    }
}

/// What makes a document of bytes.
type Reader<T, E> = fn(&[u8]) -> Result<T, E>;

/// A document of a subject: its bytes, whole, and what they say.
///
/// # Errors
/// That it is not there, larger than a take can hold, or not what it should be.
pub fn read<T, E>(path: &Path, from_json: Reader<T, E>) -> anyhow::Result<(Vec<u8>, T)>
where
    E: Error + Send + Sync + 'static,
{
    let data = files::read_bounded(path, DOCUMENT_BYTES_MAX)?;
    let document = from_json(&data).with_context(|| format!("{}", path.display()))?;
    Ok((data, document))
}

/// The skeleton that a take carries; `None` where it has none.
///
/// # Errors
/// What is wrong with it.
pub fn skeleton(subject: Option<&Subject>) -> anyhow::Result<Option<Skeleton>> {
    document(subject, Subject::SKELETON, Skeleton::from_json)
}

/// The face that a take carries; `None` where it has none.
///
/// # Errors
/// What is wrong with it.
pub fn face(subject: Option<&Subject>) -> anyhow::Result<Option<FittedFace>> {
    document(subject, Subject::FACE, FittedFace::from_json)
}

/// Which marker sits where on it; `None` where nothing says so.
///
/// # Errors
/// What is wrong with it.
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

/// The limbs of the subject's skeleton between these labels. It was checked when it was read: here nothing is said of it.
fn limbs_between(subject: Option<&Subject>, labels: &[String]) -> Option<Vec<Limb>> {
    let bones = skeleton(subject).ok()??.bones;
    Some(limbs(&bones, labels, subject.map_or("", |subject| subject.name.as_str())).0)
}

/// The limbs of the subject's skeleton between these slots, for viewers.
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

/// Lines by label, and those of limbs that are not among them.
#[must_use]
pub fn with_limbs(mut bones: Vec<[u16; 2]>, limbs: &[LiveLimb]) -> Vec<[u16; 2]> {
    for LiveLimb { ends: [a, b], .. } in limbs {
        if !bones.contains(&[*a, *b]) && !bones.contains(&[*b, *a]) {
            bones.push([*a, *b]);
        }
    }
    bones
}

/// What of the subject will show nothing with these labels, in words. Documents were checked when they were read: here nothing is
/// said of them.
#[must_use]
pub fn strangers(subject: Option<&Subject>, labels: &[String]) -> Vec<String> {
    let mut notes = Vec::new();
    if limbs_between(subject, labels).is_some_and(|limbs| limbs.is_empty()) {
        notes.push(
            "no bone of the skeleton has a marker at both its ends, by the labels: it is in the take and shows nothing".to_owned(),
        );
    }
    if let Ok(Some(Mapping { markers })) = mapping(subject) {
        let slots = face::slots(labels);
        let n_here = markers.iter().filter(|marker| slots.contains_key(&marker.label)).count();
        let n = markers.len();
        if n_here < MARKERS_MIN {
            notes.push(format!(
                "{n_here} of the {n} markers of the face are in the take, {MARKERS_MIN} are needed: it shows no face"
            ));
        } else if n_here < n {
            notes.push(format!(
                "{n_here} of the {n} markers of the face are in the take: they alone hold it"
            ));
        }
    }
    notes
}

#[cfg(test)]
mod tests;

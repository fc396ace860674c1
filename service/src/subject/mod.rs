//! Who is captured: the skeleton and the face that a take carries, out of files.
//!
//! A take stores them as plain data (SUBJECT in docs/take-format.md). Here they are understood, and what is none is
//! refused before it gets into a take.

pub mod face;
pub mod skeleton;

use std::{
    io::Read,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail, ensure};
use mocapd_acquire::files;
use mocapd_report::{labels::split, limbs::limbs};
use mocapd_take::record::{DOCUMENT_BYTES_MAX, Subject};
use serde_json::error::Category;

pub use self::{
    face::{Face, FaceUnderMarkers},
    skeleton::{Skeleton, live_limbs, with_limbs},
};

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
            let data = read(path)?;
            Skeleton::parse(&data).with_context(|| format!("{}", path.display()))?;
            subject.set(Subject::SKELETON, data);
        }
        let mut wireframe = None;
        if let Some(path) = &self.face {
            let data = read(path)?;
            wireframe = Some(Face::parse(&data).with_context(|| format!("{}", path.display()))?);
            subject.set(Subject::FACE, data);
        }
        if let Some(path) = &self.face_markers {
            let shown = path.display();
            let Some(wireframe) = wireframe else {
                bail!("{shown} says where markers sit on a face, and no face is given: give both");
            };
            let data = read(path)?;
            let mapping = face::mapping(&data).with_context(|| format!("{shown}"))?;
            wireframe.check_places(&mapping).with_context(|| format!("{shown}"))?;
            subject.set(Subject::FACE_MARKERS, data);
        }
        Ok((!subject.is_empty()).then_some(subject))
    }
}

/// A document of a subject, whole.
///
/// # Errors
/// That it is not there, or larger than a take can hold.
pub fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    let mut data = Vec::new();
    files::open(path)?
        .take(DOCUMENT_BYTES_MAX as u64 + 1)
        .read_to_end(&mut data)
        .with_context(|| format!("cannot read {}", path.display()))?;
    ensure!(
        data.len() <= DOCUMENT_BYTES_MAX,
        "{} has more than 1 MiB, which is the most that a take holds of it: is it another file?",
        path.display()
    );
    Ok(data)
}

/// Markers that a face is laid under, at least (Umeyama 1991 needs three, and one more tells a mirror image).
const FACE_MARKERS_MIN: usize = 4;

/// What of the subject will show nothing with these labels, in words. Documents were checked when they were read: here nothing is
/// said of them.
#[must_use]
pub fn strangers(subject: Option<&Subject>, labels: &[String]) -> Vec<String> {
    let mut words = Vec::new();
    if let Ok(Some(skeleton)) = Skeleton::of_take(subject) {
        let name = subject.map_or("", |subject| subject.name.as_str());
        if limbs(&skeleton.to_bones(), labels, name).0.is_empty() {
            words.push(
                "no bone of the skeleton has a marker at both its ends, by the labels: it is in the take and shows nothing".to_owned(),
            );
        }
    }
    if let Some(Ok(Some(mapping))) = subject.map(face::mapping_of) {
        let is_here =
            |wanted: &str| labels.iter().any(|label| label == wanted || split(label).1 == wanted);
        let n_here = mapping.markers.iter().filter(|marker| is_here(&marker.label)).count();
        if n_here < FACE_MARKERS_MIN {
            words.push(format!(
                "{n_here} of the {} markers of the face are in the take, {FACE_MARKERS_MIN} are needed: it shows no face",
                mapping.markers.len()
            ));
        } else if n_here < mapping.markers.len() {
            words.push(format!(
                "{n_here} of the {} markers of the face are in the take: they alone hold it",
                mapping.markers.len()
            ));
        }
    }
    words
}

/// Says which document it is, before anything else is asked of it.
#[derive(Debug, serde::Deserialize)]
struct Kind {
    #[serde(default)]
    format: String,
    #[serde(default)]
    version: u64,
}

/// Refuses what is no JSON, JSON that is another document, and one of a later version.
fn check_kind(data: &[u8], format: &str, made_by: &str) -> anyhow::Result<()> {
    let found: Kind = serde_json::from_slice(data).map_err(|error| {
        let is = match error.classify() {
            Category::Data => "it is no",
            Category::Eof => "it is cut off, or no",
            Category::Syntax | Category::Io => "it is no JSON, and so no",
        };
        let what = format!("{is} {format}, which `mocapd subject {made_by} -o` writes");
        anyhow::Error::new(error).context(what)
    })?;
    if found.format != format {
        let other = if found.format.is_empty() { "no format".to_owned() } else { found.format };
        bail!(
            "it says {other} where {format} is expected, which `mocapd subject {made_by} -o` writes"
        );
    }
    ensure!(
        found.version == 1,
        "it is version {} of {format}, this build reads 1: use a newer mocapd",
        found.version
    );
    Ok(())
}

#[cfg(test)]
mod tests;

//! The subject of a take, as `info` reports it.

use mocapd_body::skeleton::Bone;
use mocapd_service::subject::{face, skeleton};
use mocapd_take::record::Subject;
use serde::Serialize;

use crate::cli::values::{LABEL_COLUMNS_MAX, bytes, count, count_of};

#[derive(Debug, Serialize)]
pub(super) struct SubjectReport {
    name: Option<String>,
    skeleton: Option<SkeletonReport>,
    face: Option<FaceReport>,
    documents: Vec<DocumentReport>,
    problems: Vec<String>,
}

#[derive(Debug, Serialize)]
struct SkeletonReport {
    method: String,
    stature_mm: Option<f64>,
    sides_told: bool,
    joints: usize,
    sources: Vec<SubjectSourceReport>,
    bones: Vec<Bone>,
}

#[derive(Debug, Serialize)]
struct FaceReport {
    method: String,
    source: Option<SubjectSourceReport>,
    vertices: usize,
    lines: usize,
}

/// The scan or photograph that a document was made from.
#[derive(Debug, Serialize)]
struct SubjectSourceReport {
    name: String,
    sha256: String,
}

#[derive(Debug, Serialize)]
struct DocumentReport {
    kind: String,
    bytes: usize,
}

impl SubjectReport {
    pub(super) fn new(subject: &Subject) -> Self {
        let mut problems = Vec::new();
        let mut add = |error: anyhow::Error| problems.push(format!("{error:#}"));
        let skeleton = skeleton(Some(subject)).map_err(&mut add).ok().flatten();
        let face = face(Some(subject)).map_err(&mut add).ok().flatten();
        let documents = subject.documents.iter().map(|document| DocumentReport {
            kind: document.kind.clone(),
            bytes: document.data.len(),
        });
        Self {
            name: Some(subject.name.clone()).filter(|name| !name.is_empty()),
            skeleton: skeleton.map(|found| SkeletonReport {
                method: found.method,
                stature_mm: found.stature_mm,
                sides_told: found.sides_told,
                joints: found.joints.len(),
                sources: found
                    .sources
                    .into_iter()
                    .map(|source| SubjectSourceReport { name: source.name, sha256: source.sha256 })
                    .collect(),
                bones: found.bones,
            }),
            face: face.map(|found| FaceReport {
                method: found.method,
                source: found
                    .source
                    .map(|source| SubjectSourceReport { name: source.name, sha256: source.sha256 }),
                vertices: found.vertices_mm.len(),
                lines: found.lines.len(),
            }),
            documents: documents.collect(),
            problems,
        }
    }

    /// Passes the lines of the report to `line`, as a heading and a value.
    pub(super) fn lines(&self, line: &mut impl FnMut(&str, &str)) {
        if let Some(name) = &self.name {
            line("subject", name);
        }
        if let Some(skeleton) = &self.skeleton {
            skeleton.lines(line);
        }
        if let Some(FaceReport { method, source, vertices, lines }) = &self.face {
            let vertices = count_of(*vertices as u64, ["vertex", "vertices"]);
            let lines = count(*lines as u64, "line");
            line("face", &format!("{vertices}, {lines}{}", by(method)));
            if let Some(SubjectSourceReport { name, sha256 }) = source {
                line("", &format!("from {name}, SHA-256 {sha256}"));
            }
        }
        let ours = [Subject::SKELETON, Subject::FACE];
        for other in self.documents.iter().filter(|document| !ours.contains(&&*document.kind)) {
            line("subject", &format!("{}, {}", other.kind, bytes(other.bytes as u64)));
        }
        for problem in &self.problems {
            line("subject", &format!("UNREADABLE: {problem}"));
        }
    }
}

impl SkeletonReport {
    fn lines(&self, line: &mut impl FnMut(&str, &str)) {
        let stature = self.stature_mm.map(|mm| format!("stature {mm:.0} mm, ")).unwrap_or_default();
        let sides = if self.sides_told { "" } else { "; left and right may be swapped" };
        let (joints, bones) =
            (count(self.joints as u64, "joint"), count(self.bones.len() as u64, "bone"));
        line("skeleton", &format!("{stature}{joints}, {bones}{}{sides}", by(&self.method)));
        for source in &self.sources {
            line("", &format!("from {}, SHA-256 {}", source.name, source.sha256));
        }
        let names = self.bones.iter().map(|bone| bone.name.chars().count());
        let width = names.max().unwrap_or(0).min(LABEL_COLUMNS_MAX);
        for bone in &self.bones {
            let sigma = bone.uncertainty_mm.map_or_else(String::new, |mm| format!(" +- {mm:.0}"));
            let spread = match bone.spread_mm {
                Some(mm) => format!(", spread {mm:.1} mm over {} scans", bone.scans),
                None => String::new(),
            };
            let length = format!("{:>6.0}{sigma} mm{spread}", bone.length_mm);
            line("", &format!("{:<width$} {length}", bone.name));
        }
    }
}

fn by(method: &str) -> String {
    if method.is_empty() { String::new() } else { format!(", method {method}") }
}

//! What a take holds besides its markers, in the report of `info`: sampled channels, poses of rigid bodies, and its
//! subject.

use std::{
    fmt::Write,
    io::{Read, Seek},
};

use mocapd_body::skeleton::Bone;
use mocapd_service::subject::{face, skeleton};
use mocapd_take::{
    TakeError, TakeMap,
    foreign::ForeignPart,
    record::{SampledChannel, Subject},
    sampled::{GroupSamples, LostSamples, SampledPart},
};
use serde::Serialize;

use crate::cli::{
    output::plain,
    values::{LABEL_COLUMNS_MAX, bytes, count, count_of, rate, thousands},
};

/// A group of channels that are sampled and stored together.
#[derive(Debug, Serialize)]
pub(super) struct SampledGroupReport {
    pub(super) kind: String,
    /// Whether its channels are the residuals of markers.
    #[serde(skip)]
    pub(super) has_residuals: bool,
    number: u32,
    form: &'static str,
    rate_hz: f64,
    samples_per_frame: u32,
    first_frame: u64,
    /// Samples of each channel, lost ones included.
    samples: u64,
    samples_lost: u64,
    /// The share of samples that are not lost, 0 to 1; `None` for a group without samples.
    recorded_share: Option<f64>,
    pub(super) stored_bytes: u64,
    channels: Vec<SampledChannelReport>,
}

#[derive(Debug, Serialize)]
struct SampledChannelReport {
    name: String,
    unit: String,
    scale: f64,
    offset: f64,
    /// In the channel's unit; 0 for exact samples.
    max_error: f64,
}

impl SampledGroupReport {
    /// The groups of all parts, except those of poses.
    pub(super) fn all(parts: &[ForeignPart]) -> Vec<Self> {
        let sampled = parts.iter().filter_map(ForeignPart::sampled);
        let groups = sampled.flat_map(SampledPart::groups);
        groups.filter(|group| !group.group.has_poses()).map(Self::new).collect()
    }

    fn new(found: &GroupSamples) -> Self {
        let lost = found.lost();
        let samples_lost =
            lost.iter().fold(0, |sum: u64, LostSamples { n, .. }| sum.saturating_add(*n));
        let samples = found.n_samples();
        let group = &found.group;
        let channel = |(i, channel): (usize, &SampledChannel)| SampledChannelReport {
            name: channel.name.clone(),
            unit: channel.unit.clone(),
            scale: channel.scale,
            offset: channel.offset,
            max_error: group.bound(i) * channel.scale.abs(),
        };
        Self {
            kind: group.kind.clone(),
            has_residuals: group.has_residuals(),
            number: group.number,
            form: group.form.name(),
            rate_hz: group.rate_hz,
            samples_per_frame: group.samples_per_frame,
            first_frame: group.first_frame,
            samples,
            samples_lost,
            recorded_share: share(samples.saturating_sub(samples_lost), samples),
            stored_bytes: found.stored_bytes,
            channels: group.channels.iter().enumerate().map(channel).collect(),
        }
    }
}

/// The text after the size of a part: its number of channels and their rate, and its size in the take; empty for a part
/// without channels.
pub(super) fn channels_text(groups: &[&SampledGroupReport]) -> String {
    let Some(first) = groups.first() else { return String::new() };
    let n_channels = groups.iter().map(|group| group.channels.len() as u64).sum();
    let stored = groups.iter().map(|group| group.stored_bytes).sum();
    let lost = groups.iter().max_by_key(|group| group.samples_lost);
    let lost = match lost.filter(|group| group.samples_lost > 0) {
        None => String::new(),
        Some(group) => format!(
            ", {} of each lost ({} recorded)",
            count(group.samples_lost, "sample"),
            percent(group.recorded_share)
        ),
    };
    let channels = || groups.iter().flat_map(|group| &group.channels);
    let inexact = match channels().filter(|channel| channel.max_error > 0.0).count() {
        0 => String::new(),
        n => format!(", {n} of them within a tolerance (--markers lists the errors)"),
    };
    format!(
        ": {} at {}{inexact}, {} of each{lost}, {} in the take",
        count(n_channels, "channel"),
        rate(first.rate_hz),
        count(first.samples, "sample"),
        bytes(stored),
    )
}

/// Appends a table of all sampled channels.
pub(super) fn channel_table(groups: &[SampledGroupReport], out: &mut String) {
    let all = || groups.iter().flat_map(|group| group.channels.iter().map(move |of| (group, of)));
    if all().next().is_none() {
        return;
    }
    let names: Vec<String> = all().map(|(_, channel)| plain(&channel.name).to_string()).collect();
    let widths = names.iter().map(|name| name.chars().count());
    let width = widths.max().unwrap_or(0).clamp(15, LABEL_COLUMNS_MAX);
    let (rate_hz, samples) = ("rate Hz", "samples");
    writeln!(
        out,
        "{:<width$} {rate_hz:>10} {samples:>10} {:>13} {:>11}  unit",
        "sampled channel", "scale", "max error"
    )
    .ok();
    for (name, (group, channel)) in names.iter().zip(all()) {
        let (samples, unit) = (thousands(group.samples), plain(&channel.unit));
        let (rate_hz, scale) = (group.rate_hz, channel.scale);
        let error = match channel.max_error {
            0.0 => "exact".to_owned(),
            error => format!("{error:.3e}"),
        };
        writeln!(
            out,
            "{name:<width$} {rate_hz:>10} {samples:>10} {scale:>13.6e} {error:>11}  {unit}"
        )
        .ok();
    }
}

/// The rigid bodies of a take, and their poses.
#[derive(Debug, Serialize)]
pub(super) struct PosesReport {
    bodies: Vec<BodyReport>,
    rate_hz: f64,
    /// Frames with poses, lost ones included.
    frames: u64,
    frames_lost: u64,
    /// The largest errors allowed; `None` if the poses are as the device sent them.
    tolerance_mm: Option<f64>,
    tolerance_degrees: Option<f64>,
    /// The largest errors that were measured; the tolerances where that is not known.
    max_error_mm: f64,
    max_error_degrees: f64,
    stored_bytes: u64,
}

/// Most poses that are counted without being asked for: statistics do not tell how many bodies were tracked, so all must be
/// decoded, at some ten million a minute of processor time: these take 50 ms.
const POSES_COUNTED: u64 = 1 << 13;

/// A rigid body. Names may be empty, and may repeat.
#[derive(Debug, Serialize)]
struct BodyReport {
    name: String,
    number: u32,
    /// Frames in which it has a pose; `None` if they were not counted.
    frames_tracked: Option<u64>,
    /// Their share of the frames with poses, lost ones included, 0 to 1; `None` also if there are none.
    tracked_share: Option<f64>,
}

/// A part of a whole, 0 to 1; `None` of nothing.
fn share(part: u64, whole: u64) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

/// A share as text. What lacks anything is not 100 %.
fn percent(share: Option<f64>) -> String {
    let percent = 100.0 * share.unwrap_or(0.0);
    let shown = if percent < 100.0 { percent.min(99.9) } else { percent };
    format!("{shown:.1} %")
}

impl PosesReport {
    /// `None` for a take without bodies.
    pub(super) fn new(take: &TakeMap) -> Option<Self> {
        let groups = || take.pose_groups();
        let first = groups().next()?;
        let tolerance = first.group.pose_bounds();
        let errors = groups().map(|group| group.pose_errors(take.sample_ledger.as_ref()));
        let errors = errors.map(|errors| errors.unwrap_or_default().errors());
        let lost = first.lost().iter().fold(0_u64, |sum, lost| sum.saturating_add(lost.n));
        let (mm, degrees) = errors.fold((0.0_f64, 0.0_f64), |(mm, degrees), of_group| {
            (mm.max(of_group.position_mm), degrees.max(of_group.angle_degrees))
        });
        Some(Self {
            bodies: groups()
                .flat_map(|group| group.group.numbered_bodies())
                .map(|(number, name)| BodyReport {
                    name: name.to_owned(),
                    number,
                    frames_tracked: None,
                    tracked_share: None,
                })
                .collect(),
            rate_hz: first.group.rate_hz,
            frames: first.n_samples(),
            frames_lost: lost,
            tolerance_mm: tolerance.map(|[mm, _]| mm),
            tolerance_degrees: tolerance.map(|[_, degrees]| degrees),
            max_error_mm: mm,
            max_error_degrees: degrees,
            stored_bytes: groups().map(|group| group.stored_bytes).sum(),
        })
    }

    /// Whether the poses are so few that counting them takes at most about half a second.
    pub(super) fn are_few(&self) -> bool {
        self.frames.saturating_mul(self.bodies.len() as u64) <= POSES_COUNTED
    }

    /// Counts the frames in which each body of the take was tracked.
    ///
    /// # Errors
    /// If the take cannot be read.
    pub(super) fn count_tracked(
        &mut self,
        take: &TakeMap,
        input: &mut (impl Read + Seek),
    ) -> Result<(), TakeError> {
        let mut bodies = self.bodies.iter_mut();
        for group in take.pose_groups() {
            let mut of_group: Vec<&mut BodyReport> =
                bodies.by_ref().take(group.group.bodies().count()).collect();
            let mut counts = vec![0; of_group.len()];
            group.read_poses(input, |_, _, poses| {
                for of_frame in poses.unwrap_or_default().chunks_exact(counts.len().max(1)) {
                    for (count, pose) in counts.iter_mut().zip(of_frame) {
                        *count += u64::from(pose.is_tracked());
                    }
                }
                Ok(())
            })?;
            for (body, count) in of_group.iter_mut().zip(counts) {
                body.frames_tracked = Some(count);
                body.tracked_share = share(count, self.frames);
            }
        }
        Ok(())
    }

    /// How many bodies were tracked, and which one the least.
    pub(super) fn tracked_text(&self) -> String {
        if self.bodies.iter().any(|body| body.frames_tracked.is_none()) {
            return "--markers counts the frames in which each body was tracked".to_owned();
        }
        let tracked = || self.bodies.iter().filter(|body| body.frames_tracked > Some(0));
        let all = count_of(self.bodies.len() as u64, ["body", "bodies"]);
        let mut out = format!("{} of {all} tracked", thousands(tracked().count() as u64));
        // The first of equals, unless all are equal.
        let most = tracked().map(|body| body.frames_tracked).max().unwrap_or_default();
        let fewer = tracked().filter(|body| body.frames_tracked < most);
        if let Some(least) = fewer.min_by_key(|body| body.frames_tracked) {
            let (name, share) = (plain(&least.name), percent(least.tracked_share));
            out += &format!("; least {name}, in {share} of the frames");
        }
        out
    }

    /// Appends a table of the bodies.
    pub(super) fn body_table(&self, out: &mut String) {
        let names: Vec<String> =
            self.bodies.iter().map(|body| plain(&body.name).to_string()).collect();
        let widths = names.iter().map(|name| name.chars().count());
        let width = widths.max().unwrap_or(0).clamp(10, LABEL_COLUMNS_MAX);
        writeln!(out, "{:<width$} {:>10} {:>9}", "rigid body", "frames", "tracked").ok();
        for (name, body) in names.iter().zip(&self.bodies) {
            let frames = thousands(body.frames_tracked.unwrap_or_default());
            let share = percent(body.tracked_share);
            writeln!(out, "{name:<width$} {frames:>10} {share:>9}").ok();
        }
    }

    /// A line of text.
    pub(super) fn text(&self) -> String {
        let names: Vec<String> =
            self.bodies.iter().map(|body| plain(&body.name).to_string()).collect();
        let lost = match self.frames_lost {
            0 => String::new(),
            n => format!(", {n} lost"),
        };
        let within = match (self.tolerance_mm, self.tolerance_degrees) {
            (Some(mm), Some(degrees)) => format!(
                "within {mm} mm and {degrees:.4} degrees (largest errors {:.4} mm and {:.4} degrees)",
                self.max_error_mm, self.max_error_degrees
            ),
            _ => "exact".to_owned(),
        };
        format!(
            "{} at {}, {}{lost}, {within}, {} in the take: {}",
            count_of(self.bodies.len() as u64, ["body", "bodies"]),
            rate(self.rate_hz),
            count(self.frames, "frame"),
            bytes(self.stored_bytes),
            names.join(", ")
        )
    }
}

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

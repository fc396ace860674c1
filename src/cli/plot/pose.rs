//! `plot pose`: stick figures at several times, with the subject's face.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use anyhow::{Context, bail};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::files;
use mocapd_report::{
    labels,
    plot::{MOMENTS_MAX, PosePlot, pose},
    up::Up,
};
use mocapd_service::{live::FacePose, subject::FaceOverlay, units};
use mocapd_take::{
    motion::{Motion, frame_at},
    record::Subject,
};

use super::{Picture, PictureArgs, TimeSpan};
use crate::cli::motion_files::limbs_of_take;

/// Number of stick figures without `--at`.
const MOMENTS: usize = 8;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    picture: PictureArgs,
    /// Times of the stick figures, up to 12 [default: eight, evenly spread]
    #[arg(long, value_name = "TIME,...", value_delimiter = ',', value_parser = units::duration)]
    at: Vec<Duration>,
    /// Bones to draw between markers: a skeleton.json, or a text file with one bone per line, two labels separated by a
    /// comma [default: the take's skeleton, else the lines of the known marker set that matches the labels best]
    ///
    /// A face in the take is drawn where its markers are.
    #[arg(long, value_name = "FILE")]
    skeleton: Option<PathBuf>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    if args.at.len() > MOMENTS_MAX {
        bail!(UsageError(format!("--at has {} times: give 1 to {MOMENTS_MAX}", args.at.len())));
    }
    args.picture.run(TimeSpan::All, |picture| draw(args, picture))
}

fn draw(args: &Args, picture: &Picture<'_>) -> anyhow::Result<String> {
    let decoded = &picture.take;
    let motion = &decoded.motion;
    let n_frames = motion.n_frames();
    let mut rows = Vec::with_capacity(args.at.len());
    for &at in &args.at {
        let row = usize::try_from(frame_at(at, motion.info.rate_hz)).unwrap_or(usize::MAX);
        if row >= n_frames {
            bail!(UsageError(format!(
                "the take is {:.3} s long, but --at is {:.3} s: choose an earlier time",
                n_frames as f64 / motion.info.rate_hz,
                at.as_secs_f64()
            )));
        }
        rows.push(row);
    }
    if rows.is_empty() {
        rows.extend(evenly_spread(n_frames));
    }
    let labels = motion.info.labels();
    let mut bones = labels::marker_lines(&labels);
    let skeleton = args.skeleton.as_deref();
    let mut limbs = None;
    match skeleton.map(|path| read_bones(path, &labels)).transpose()?.flatten() {
        Some(read) => bones = read,
        None => limbs = limbs_of_take(motion, skeleton)?,
    }
    let limbs = limbs.map(|found| found.limbs).unwrap_or_default();
    if limbs.is_empty() && skeleton.is_some() && bones.is_empty() {
        picture.job.notify("no bone of the skeleton has a marker at both ends: no lines are drawn");
    }
    let faces = Faces::of(motion, &labels, &rows);
    let up = up(motion);
    if let Some(why) = faces.missing(motion) {
        picture.job.notify(why);
    }
    Ok(pose(&PosePlot {
        name: &picture.name,
        take: decoded,
        original: picture.original.as_ref().map(|(motion, _)| motion),
        rows: &rows,
        bones: &bones,
        limbs: &limbs,
        faces: &faces.lines,
        front: faces.front,
        up,
    })?)
}

/// The rows of the default stick figures.
fn evenly_spread(n_frames: usize) -> impl Iterator<Item = usize> {
    let n = MOMENTS.min(n_frames);
    (0..n).map(move |i| i * n_frames.saturating_sub(1) / n.saturating_sub(1).max(1))
}

/// The up direction of a take, the same in each of its plots, for any part that is drawn.
pub(super) fn up(motion: &Motion) -> Up {
    let rows: Vec<usize> = evenly_spread(motion.n_frames()).collect();
    let front = Faces::of(motion, &motion.info.labels(), &rows).front;
    Up::of(motion, front.map(|[_, top]| top))
}

/// The wireframe of the take's face at the poses of its markers.
#[derive(Default)]
struct Faces {
    /// The lines at each time, mm; empty where too few markers of the face are visible.
    lines: Vec<Vec<[[f64; 3]; 2]>>,
    /// Unit vectors to the face's left and top, at the first time with a face.
    front: Option<[[f64; 3]; 2]>,
}

impl Faces {
    /// Why the face in the take is not drawn; `None` if it is drawn or the take has none.
    fn missing(&self, motion: &Motion) -> Option<&'static str> {
        let subject = motion.info.subject.as_ref()?;
        subject.document(Subject::FACE)?;
        if subject.document(Subject::FACE_MARKERS).is_none() {
            return Some(
                "the face is not drawn: the take has no mapping of markers to the face; give one to `import` or `record` \
                 with --face-markers (docs/subject-face-format.md; example: \
                 subject/face/data/singing-face-mapping.json, for a public recording of a singing face)",
            );
        }
        self.front.is_none().then_some(
            "the face is not drawn: too few of its markers are visible at these times (they are those of the mapping \
             given with --face-markers)",
        )
    }

    fn of(motion: &Motion, labels: &[String], rows: &[usize]) -> Self {
        let subject = motion.info.subject.as_ref();
        let Some(face) = FaceOverlay::new(subject, labels) else { return Self::default() };
        let wireframe = face.wireframe();
        let poses: Vec<_> = rows.iter().map(|&row| face.pose(motion.frame(row))).collect();
        let of_moment = |pose: &Option<FacePose>| {
            let Some(pose) = pose else { return Vec::new() };
            let at = |vertex: usize| {
                let from = wireframe.vertices_mm[vertex].map(f64::from);
                pose.map(|[x, y, z, add]| {
                    let [x, y, z, add] = [x, y, z, add].map(f64::from);
                    x * from[0] + y * from[1] + z * from[2] + add
                })
            };
            wireframe.lines.iter().map(|line| line.map(at)).collect()
        };
        let lines = poses.iter().map(of_moment).collect();
        let front = poses.iter().flatten().next();
        let front = front.map(|pose| [0, 1].map(|own| pose.map(|row| f64::from(row[own]))));
        Self { lines, front }
    }
}

/// Largest `--skeleton` file, bytes: room for tens of thousands of bones.
const BYTES_MAX: usize = 1 << 20;

/// Reads the bones of a text file, one `label,label` per line; empty lines and lines that begin with `#` are ignored.
/// `None` for a skeleton.json.
///
/// # Errors
/// A usage error with the line that is malformed or names an unknown marker.
fn read_bones(path: &Path, labels: &[String]) -> anyhow::Result<Option<Vec<[u16; 2]>>> {
    let bytes = files::read_bounded(path, BYTES_MAX)?;
    if bytes.trim_ascii_start().first() == Some(&b'{') {
        return Ok(None);
    }
    let text = String::from_utf8(bytes).with_context(|| {
        format!(
            "{}: not a text file: give the output of `mocapd subject body -o`, or one line `label,label` per bone",
            path.display()
        )
    })?;
    bones(&text, labels).map(Some).map_err(|why| {
        let message = format!(
            "{}, {why}: write label,label for each bone, or give the output of `mocapd subject body -o`",
            path.display()
        );
        UsageError(message).into()
    })
}

fn bones(text: &str, labels: &[String]) -> Result<Vec<[u16; 2]>, String> {
    let mut bones = Vec::new();
    for (line, number) in text.lines().zip(1..) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let (a, b) = line
            .split_once(',')
            .ok_or_else(|| format!("line {number}: '{}' is not a bone", shortened(line)))?;
        let column = |label: &str| {
            let found = labels.iter().position(|there| there == label.trim());
            found.and_then(|column| u16::try_from(column).ok()).ok_or_else(|| {
                format!("line {number}: no marker is called '{}'", shortened(label.trim()))
            })
        };
        bones.push([column(a)?, column(b)?]);
    }
    Ok(bones)
}

/// A line of a file, shortened to fit into a message.
fn shortened(line: &str) -> String {
    const CHARACTERS: usize = 60;
    let rest = if line.chars().nth(CHARACTERS).is_some() { "…" } else { "" };
    line.chars().take(CHARACTERS).collect::<String>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bones_by_label() {
        let labels = ["hip", "knee", "ankle"].map(str::to_owned);
        assert_eq!(bones("# leg\nhip, knee\n\nknee,ankle\n", &labels), Ok(vec![[0, 1], [1, 2]]));
        assert!(bones("hip knee\n", &labels).unwrap_err().contains("line 1"));
        assert!(
            bones("hip,knee\nhip,toe\n", &labels)
                .unwrap_err()
                .contains("line 2: no marker is called 'toe'")
        );
    }
}

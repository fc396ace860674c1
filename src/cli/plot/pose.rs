//! `plot pose`.

use std::{path::PathBuf, time::Duration};

use mocapd::outcome::{Outcome, UsageError};
use mocapd_report::{
    plot::{Pose, pose},
    up::Up,
};
use mocapd_service::{
    bones,
    face::{FacePose, FaceUnderMarkers},
    units,
};
use mocapd_take::{
    motion::{Motion, frame_at},
    record::Subject,
};

use super::{picture, skeleton};
use crate::cli::{
    limbs,
    output::say,
    whole::{name, read_coded},
};

/// Moments when none are asked for.
const MOMENTS: usize = 8;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The take
    take: PathBuf,
    /// The picture to write, .svg or .png; it must not exist
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// The original: a .c3d, .trc, .tsv or .csv file, or another .take
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
    /// The moments, up to 12 [default: eight, evenly spread]
    #[arg(long, value_name = "TIME,...", value_delimiter = ',', value_parser = units::duration)]
    at: Vec<Duration>,
    /// What is drawn between markers [default: the take's skeleton, or what labels tell]: a skeleton.json, or a text with
    /// a line a bone, two labels and a comma between. A take's face is drawn wherever its markers are
    #[arg(long, value_name = "FILE")]
    skeleton: Option<PathBuf>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    picture::check_output(&args.output)?;
    let coded = read_coded(&args.take)?;
    let original = args.against.as_ref().map(|path| picture::original(&args.take, &coded, path));
    let original = original.transpose()?.map(|(motion, _)| motion);
    let motion = &coded.motion;
    let n_frames = motion.n_frames();
    let mut rows = Vec::with_capacity(args.at.len());
    for &at in &args.at {
        let row = usize::try_from(frame_at(at, motion.info.rate_hz)).unwrap_or(usize::MAX);
        if row >= n_frames {
            return Err(UsageError(format!(
                "the take has {:.3} s, and {:.3} s were asked for: choose an earlier moment",
                n_frames as f64 / motion.info.rate_hz,
                at.as_secs_f64()
            ))
            .into());
        }
        rows.push(row);
    }
    if rows.is_empty() {
        rows.extend(evenly_spread(n_frames));
    }
    let labels: Vec<String> =
        motion.info.markers.iter().map(|marker| marker.label.clone()).collect();
    let mut bones = bones::bones(&labels);
    let mut limbs = None;
    match &args.skeleton {
        Some(path) if !skeleton::is_json(path)? => bones = skeleton::read(path, &labels)?,
        path => limbs = limbs::of(motion, path.as_deref())?,
    }
    let limbs = limbs.map(|found| found.limbs).unwrap_or_default();
    if limbs.is_empty() && args.skeleton.as_ref().is_some_and(|_| bones.is_empty()) {
        say("no bone of the skeleton has a marker at both ends: nothing is drawn between markers");
    }
    let faces = Faces::of(motion, &labels, &rows);
    let up = up(motion);
    if let Some(why) = faces.missing(motion) {
        say(why);
    }
    let wanted = Pose {
        name: &name(&args.take),
        coded: &coded,
        original: original.as_ref(),
        rows: &rows,
        bones: &bones,
        limbs: &limbs,
        faces: &faces.lines,
        front: faces.front,
        up,
    };
    picture::write(&args.output, &pose(&wanted)?)?;
    Ok(picture::outcome(&coded))
}

/// The rows of the usual moments.
fn evenly_spread(n_frames: usize) -> impl Iterator<Item = usize> {
    let n = MOMENTS.min(n_frames);
    (0..n).map(move |i| i * n_frames.saturating_sub(1) / n.saturating_sub(1).max(1))
}

/// Which way is up in every picture of a take, whatever part of it is drawn.
pub(super) fn up(motion: &Motion) -> Up {
    let labels: Vec<String> =
        motion.info.markers.iter().map(|marker| marker.label.clone()).collect();
    let rows: Vec<usize> = evenly_spread(motion.n_frames()).collect();
    let front = Faces::of(motion, &labels, &rows).front;
    Up::of(motion, front.map(|[_, top]| top))
}

/// The take's face under its markers.
#[derive(Default)]
struct Faces {
    /// The lines of each moment; none of one where too few markers are seen.
    lines: Vec<Vec<[[f64; 3]; 2]>>,
    /// Its own left and top at the first moment that has it.
    front: Option<[[f64; 3]; 2]>,
}

impl Faces {
    /// Why a face that the take carries is not drawn; nothing where it is, or where there is none.
    fn missing(&self, motion: &Motion) -> Option<&'static str> {
        let subject = motion.info.subject.as_ref()?;
        subject.document(Subject::FACE)?;
        if subject.document(Subject::FACE_MARKERS).is_none() {
            return Some(
                "the take has a face, and nothing says which marker sits where on it, so it is not drawn: `import` and \
                 `record` take such a mapping with --face-markers (docs/subject-face-format.md; \
                 subject/face/data/singing-face-mapping.json is that of a public recording of a singing face)",
            );
        }
        self.front.is_none().then_some(
            "fewer markers of the face are seen at these moments than hold it: it is not drawn; its mapping is the file \
             that --face-markers of `import` and `record` named",
        )
    }

    fn of(motion: &Motion, labels: &[String], rows: &[usize]) -> Self {
        let subject = motion.info.subject.as_ref();
        let Some(face) = FaceUnderMarkers::new(subject, labels) else { return Self::default() };
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

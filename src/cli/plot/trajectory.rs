//! `plot trajectory`: one marker, in space and against time.

use std::time::Duration;

use mocapd::outcome::{Outcome, UsageError};
use mocapd_report::{
    column::{Column, distance},
    decoded::DecodedTake,
    plot::{TrajectoryPlot, trajectory},
};
use mocapd_service::units;
use mocapd_take::{interchange::column_labels, motion::frame_at};

use super::{Picture, PictureArgs, TimeSpan, pose::up};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    picture: PictureArgs,
    /// Label of the marker [default: the marker with the longest path]
    #[arg(long, value_name = "LABEL")]
    marker: Option<String>,
    /// Plot frames from this time on: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    from: Option<Duration>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    args.picture.run(TimeSpan::Range, |picture| draw(args, picture))
}

fn draw(args: &Args, picture: &Picture<'_>) -> anyhow::Result<String> {
    let decoded = &picture.take;
    let motion = &decoded.motion;
    let (n_frames, rate_hz) = (motion.n_frames(), motion.info.rate_hz);
    let row = |time: Duration| usize::try_from(frame_at(time, rate_hz)).unwrap_or(usize::MAX);
    let rows = (args.from.map_or(0, row), picture.end.map_or(n_frames, row));
    if rows.0 >= rows.1.min(n_frames) {
        let length_s = n_frames as f64 / rate_hz;
        anyhow::bail!(UsageError(format!(
            "no frames between --from and --to: the take has {n_frames} frames, {length_s:.3} s"
        )));
    }
    Ok(trajectory(&TrajectoryPlot {
        name: &picture.name,
        take: decoded,
        original: picture.original.as_ref().map(|(motion, _)| motion),
        marker: marker(decoded, args.marker.as_deref())?,
        rows,
        up: up(motion),
    })?)
}

/// The column of the marker with this label, or of the one with the longest path.
pub(super) fn marker(decoded: &DecodedTake, label: Option<&str>) -> anyhow::Result<usize> {
    let markers = &decoded.motion.info.markers;
    if let Some(label) = label {
        // As in exports: if several markers share a label, the second is `LABEL#2`.
        let names = column_labels(&decoded.motion.info);
        let named = names.iter().position(|name| name == label);
        let labelled = || markers.iter().position(|marker| marker.label == label);
        return named.or_else(labelled).ok_or_else(|| {
            let wanted = label.to_lowercase();
            let likeness = |name: &str| strsim::jaro_winkler(&name.to_lowercase(), &wanted);
            let nearest = names.iter().max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
            let hint = nearest.map_or_else(String::new, |name| format!("; did you mean '{name}'?"));
            UsageError(format!("no marker has the label '{label}'{hint}")).into()
        });
    }
    let path_mm = |marker: usize| {
        let samples: Vec<_> = Column::of(&decoded.motion, marker).0.into_iter().flatten().collect();
        samples.windows(2).map(|pair| distance(pair[0], pair[1])).sum::<f64>()
    };
    Ok((0..markers.len()).max_by(|&a, &b| path_mm(a).total_cmp(&path_mm(b))).unwrap_or(0))
}

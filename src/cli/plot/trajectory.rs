//! `plot trajectory`.

use std::time::Duration;

use mocapd::outcome::{Outcome, UsageError};
use mocapd_report::{
    coded::Coded,
    column::{Column, distance},
    plot::{Trajectory, trajectory},
};
use mocapd_service::units;
use mocapd_take::{interchange::column_labels, motion::frame_at};

use super::{Pictured, pose::up};
use crate::cli::plot;
use crate::cli::whole::name;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    pictured: Pictured,
    /// The marker, by its label [default: the one that goes the longest way]
    #[arg(long, value_name = "LABEL")]
    marker: Option<String>,
    /// Leave out what is before this time: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    from: Option<Duration>,
    /// Leave out what is at or after this time
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    to: Option<Duration>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let (coded, original) = args.pictured.read()?;
    let original = original.map(|(motion, _)| motion);
    let motion = &coded.motion;
    let row =
        |time: Duration| usize::try_from(frame_at(time, motion.info.rate_hz)).unwrap_or(usize::MAX);
    let rows = (args.from.map_or(0, row), args.to.map_or(motion.n_frames(), row));
    if rows.0 >= rows.1.min(motion.n_frames()) {
        return Err(UsageError(format!(
            "nothing lies between --from and --to: the take has {} frames, {:.3} s",
            motion.n_frames(),
            motion.n_frames() as f64 / motion.info.rate_hz
        ))
        .into());
    }
    let marker = marker(&coded, args.marker.as_deref())?;
    let wanted = Trajectory {
        name: &name(&args.pictured.take),
        coded: &coded,
        original: original.as_ref(),
        marker,
        rows,
        up: up(motion),
    };
    plot::write(&args.pictured.output, &trajectory(&wanted)?)?;
    Ok(plot::outcome(&coded))
}

/// The column of a label, or of the marker that goes the longest way.
fn marker(coded: &Coded, label: Option<&str>) -> anyhow::Result<usize> {
    let markers = &coded.motion.info.markers;
    if let Some(label) = label {
        // As exports call them: of several with one label the second is `LABEL#2`.
        let names = column_labels(&coded.motion.info);
        let named = names.iter().position(|name| name == label);
        let labelled = || markers.iter().position(|marker| marker.label == label);
        return named.or_else(labelled).ok_or_else(|| {
            let nearest = names.iter().max_by(|a, b| {
                strsim::jaro_winkler(a, label).total_cmp(&strsim::jaro_winkler(b, label))
            });
            let meant =
                nearest.map_or_else(String::new, |label| format!(": did you mean '{label}'?"));
            UsageError(format!("no marker is called '{label}'{meant}")).into()
        });
    }
    let way = |marker: usize| {
        let samples: Vec<_> = Column::of(&coded.motion, marker).0.into_iter().flatten().collect();
        samples.windows(2).map(|pair| distance(pair[0], pair[1])).sum::<f64>()
    };
    Ok((0..markers.len()).max_by(|&a, &b| way(a).total_cmp(&way(b))).unwrap_or(0))
}

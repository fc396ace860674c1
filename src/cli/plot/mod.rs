//! `plot`: pictures of takes.

mod pose;
mod sizes;
mod trajectory;

use std::path::{Path, PathBuf};

use clap::Subcommand;
use mocapd::outcome::{Outcome, UsageError};
use mocapd_codec::Settings;
use mocapd_report::{
    coded::Coded,
    plot::{Quality, png, quality},
};
use mocapd_take::motion::Motion;

use crate::cli::{
    output::say,
    paths,
    whole::{name, read_coded, read_original, write_new},
};

#[derive(Debug, Subcommand)]
pub(crate) enum Plot {
    /// One marker: original samples, kept samples and the rebuilt curve, in space and against time
    Trajectory(trajectory::Args),
    /// Stick figures of several moments, the original above and the rebuilt body below
    Pose(pose::Args),
    /// Size of the take against the tolerance, by resampler; takes or files, a panel each
    Sizes(sizes::Args),
    /// Marker by marker: gaps, noise, and with --against the error
    Quality(QualityArgs),
}

pub(crate) fn run(plot: &Plot) -> anyhow::Result<Outcome> {
    match plot {
        Plot::Trajectory(args) => trajectory::run(args),
        Plot::Pose(args) => pose::run(args),
        Plot::Sizes(args) => sizes::run(args),
        Plot::Quality(args) => draw_quality(args),
    }
}

/// Says early what writing there would meet.
///
/// # Errors
/// A usage error for an ending that is no picture's.
pub(crate) fn check_output(path: &Path) -> anyhow::Result<()> {
    if !is(path, "svg") && !is(path, "png") {
        return Err(UsageError(format!(
            "{}: the ending tells the format: use .svg or .png",
            path.display()
        ))
        .into());
    }
    paths::check_output(path)
}

fn is(path: &Path, ending: &str) -> bool {
    path.extension().is_some_and(|found| found.eq_ignore_ascii_case(ending))
}

/// Writes the picture in the format of its ending.
///
/// # Errors
/// When it cannot be drawn or written.
pub(crate) fn write(path: &Path, svg: &str) -> anyhow::Result<()> {
    if is(path, "png") { write_new(path, &png(svg)?) } else { write_new(path, svg.as_bytes()) }
}

/// What the take was made of, and what that itself was coded with where it is a take.
///
/// # Errors
/// Why it cannot be read.
pub(super) fn original(
    take: &Path,
    coded: &Coded,
    path: &Path,
) -> anyhow::Result<(Motion, Option<Settings>)> {
    let (motion, settings) = read_original(take, path)?;
    let labels = |motion: &Motion| -> Vec<String> {
        motion.info.markers.iter().map(|marker| marker.label.clone()).collect()
    };
    if labels(&motion) != labels(&coded.motion) {
        say(&format!("{}: its labels are not those of {}", path.display(), take.display()));
    }
    if motion.n_frames() != coded.motion.n_frames() {
        say(&format!(
            "{} has {} frames, {} has {}: drawn from the first on",
            path.display(),
            motion.n_frames(),
            take.display(),
            coded.motion.n_frames()
        ));
    }
    Ok((motion, settings))
}

/// A picture of a damaged take shows what is left of it.
pub(super) fn outcome(coded: &Coded) -> Outcome {
    Outcome::of(!coded.problems.is_empty())
}

#[derive(Debug, clap::Args)]
pub(crate) struct QualityArgs {
    /// The take
    take: PathBuf,
    /// The picture to write, .svg or .png; it must not exist
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// The original: a .c3d, .trc, .tsv or .csv file, or another .take
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
}

fn draw_quality(args: &QualityArgs) -> anyhow::Result<Outcome> {
    check_output(&args.output)?;
    let coded = read_coded(&args.take)?;
    let original = args.against.as_ref().map(|path| original(&args.take, &coded, path));
    let original = original.transpose()?;
    let wanted = Quality {
        name: &name(&args.take),
        coded: &coded,
        original: original.as_ref().map(|(motion, _)| motion),
        original_settings: original.as_ref().and_then(|(_, settings)| *settings),
    };
    write(&args.output, &quality(&wanted)?)?;
    Ok(outcome(&coded))
}

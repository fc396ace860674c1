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
    paths::{self, ends_in},
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
    Quality(Pictured),
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
    if !ends_in(path, "svg") && !ends_in(path, "png") {
        return Err(UsageError(format!(
            "{}: the ending tells the format: use .svg or .png",
            path.display()
        ))
        .into());
    }
    paths::check_output(path)
}

/// Writes the picture in the format of its ending.
///
/// # Errors
/// When it cannot be drawn or written.
pub(crate) fn write(path: &Path, svg: &str) -> anyhow::Result<()> {
    if ends_in(path, "png") { write_new(path, &png(svg)?) } else { write_new(path, svg.as_bytes()) }
}

/// What the take was made of, and what that itself was coded with where it is a take.
///
/// # Errors
/// Why it cannot be read.
fn original(take: &Path, coded: &Coded, path: &Path) -> anyhow::Result<(Motion, Option<Settings>)> {
    let (motion, settings) = read_original(take, path)?;
    if motion.info.labels() != coded.motion.info.labels() {
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

/// A take, its original, and the picture of them.
#[derive(Debug, clap::Args)]
pub(crate) struct Pictured {
    /// The take
    take: PathBuf,
    /// The picture to write, .svg or .png; it must not exist
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// The original: a .c3d, .trc, .tsv or .csv file, or another .take
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
}

impl Pictured {
    /// The take, and its original with what that was coded with; that the picture can be written is looked at before.
    ///
    /// # Errors
    /// Why one of them cannot be.
    #[expect(clippy::type_complexity, reason = "what is read of two files")]
    fn read(&self) -> anyhow::Result<(Coded, Option<(Motion, Option<Settings>)>)> {
        check_output(&self.output)?;
        let coded = read_coded(&self.take)?;
        let original = self.against.as_ref().map(|path| original(&self.take, &coded, path));
        Ok((coded, original.transpose()?))
    }
}

fn draw_quality(args: &Pictured) -> anyhow::Result<Outcome> {
    let (coded, original) = args.read()?;
    let wanted = Quality {
        name: &name(&args.take),
        coded: &coded,
        original: original.as_ref().map(|(motion, _)| motion),
        original_settings: original.as_ref().and_then(|(_, settings)| *settings),
    };
    write(&args.output, &quality(&wanted)?)?;
    Ok(outcome(&coded))
}

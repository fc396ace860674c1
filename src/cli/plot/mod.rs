//! `plot`: plots of takes, as SVG or PNG.

mod pose;
mod sizes;
mod trajectory;

use std::path::{Path, PathBuf};

use clap::Subcommand;
use mocapd::outcome::Outcome;
use mocapd_report::{
    decoded::DecodedTake,
    plot::{QualityPlot, png, quality},
};

use crate::cli::{
    motion_files::{Original, file_name, read_original, read_take, write_new},
    output::notify,
    paths::{self, ends_in},
};

#[derive(Debug, Subcommand)]
pub(crate) enum Plot {
    /// Plot one marker: original samples, kept samples and the reconstruction, in space and against time
    Trajectory(trajectory::Args),
    /// Plot stick figures at several times, the original above and the reconstruction below
    Pose(pose::Args),
    /// Plot the size of the take against the tolerance, by resampler, one panel per take or file
    Sizes(sizes::Args),
    /// Plot each marker's gaps, noise and, with --against, error
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

/// Checks that a picture can be created at `path`.
///
/// # Errors
/// A usage error for an extension other than .svg and .png; the errors of [`paths::check_output`].
pub(crate) fn check_output(path: &Path) -> anyhow::Result<()> {
    if !ends_in(path, "svg") && !ends_in(path, "png") {
        return Err(paths::unknown_ending(path, ".svg or .png"));
    }
    paths::check_output(path)
}

/// Writes a picture in the format of its extension.
///
/// # Errors
/// If it cannot be drawn or written.
pub(crate) fn write(path: &Path, svg: &str) -> anyhow::Result<()> {
    if ends_in(path, "png") { write_new(path, &png(svg)?) } else { write_new(path, svg.as_bytes()) }
}

/// Reads the original of a take; warns if the two do not match.
///
/// # Errors
/// If it cannot be read.
fn original(take: &Path, decoded: &DecodedTake, path: &Path) -> anyhow::Result<Original> {
    let (motion, settings) = read_original(take, path)?;
    let (name, take) = (path.display(), take.display());
    if motion.info.labels() != decoded.motion.info.labels() {
        notify(&format!("{name}: its labels differ from those of {take}"));
    }
    let (n, n_decoded) = (motion.n_frames(), decoded.motion.n_frames());
    if n != n_decoded {
        notify(&format!(
            "{name} has {n} frames, {take} has {n_decoded}: plotted from the first frame of each"
        ));
    }
    Ok((motion, settings))
}

/// `DataLost` for the plot of a damaged take: it shows only what could be read.
pub(super) fn outcome(decoded: &DecodedTake) -> Outcome {
    Outcome::of(!decoded.problems.is_empty())
}

/// The arguments that every plot of one take has.
#[derive(Debug, clap::Args)]
pub(crate) struct Pictured {
    /// The take
    take: PathBuf,
    /// The plot to write, .svg or .png; it must not exist
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// The original: a .c3d, .trc, .tsv or .csv file, or another .take
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
}

impl Pictured {
    /// Checks the output path and reads the take and its original, with the settings of an original that is a take.
    ///
    /// # Errors
    /// If one of them cannot be read, or the plot cannot be created.
    fn read(&self) -> anyhow::Result<(DecodedTake, Option<Original>)> {
        check_output(&self.output)?;
        let decoded = read_take(&self.take)?;
        let original = self.against.as_ref().map(|path| original(&self.take, &decoded, path));
        Ok((decoded, original.transpose()?))
    }
}

fn draw_quality(args: &Pictured) -> anyhow::Result<Outcome> {
    let (decoded, original) = args.read()?;
    let spec = QualityPlot {
        name: &file_name(&args.take),
        take: &decoded,
        original: original.as_ref().map(|(motion, _)| motion),
        original_settings: original.as_ref().and_then(|(_, settings)| *settings),
    };
    write(&args.output, &quality(&spec)?)?;
    Ok(outcome(&decoded))
}

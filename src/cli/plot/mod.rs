//! `plot`: pictures of takes.

pub(crate) mod picture;
mod pose;
mod quality;
mod sizes;
mod skeleton;
mod trajectory;

use clap::Subcommand;
use mocapd::outcome::Outcome;

#[derive(Debug, Subcommand)]
pub(crate) enum Plot {
    /// One marker: original samples, kept samples and the rebuilt curve, in space and against time
    Trajectory(trajectory::Args),
    /// Stick figures of several moments, the original above and the rebuilt body below
    Pose(pose::Args),
    /// Size of the take against the tolerance, by resampler; takes or files, a panel each
    Sizes(sizes::Args),
    /// Marker by marker: gaps, noise, and with --against the error
    Quality(quality::Args),
}

pub(crate) fn run(plot: &Plot) -> anyhow::Result<Outcome> {
    match plot {
        Plot::Trajectory(args) => trajectory::run(args),
        Plot::Pose(args) => pose::run(args),
        Plot::Sizes(args) => sizes::run(args),
        Plot::Quality(args) => quality::run(args),
    }
}
